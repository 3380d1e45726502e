"""The report of a grid: a static site that works offline. Written from saved rows; runs are repeated only to be
drawn.
"""

from __future__ import annotations

from tomthumb.site.build import build

__all__ = ["build"]
