"""Landmarks out of raw 2-D laser scans: trunks, poles and reflectors, with covariances. Each is a plain function."""

from __future__ import annotations

from tomthumb.detectors.laser import Detections, cluster, reflectors
from tomthumb.detectors.trunks import poles, trunks

__all__ = ["Detections", "cluster", "poles", "reflectors", "trunks"]
