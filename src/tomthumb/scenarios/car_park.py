"""ACFR Car Park: a car with a laser among 15 reflective poles, kinematic GPS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.models.motion import Ackermann
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.matfile import load_mat, matrix
from tomthumb.scenarios.reading import increasing, known, pose_at, read_bytes, table, whole
from tomthumb.scenarios.timeline import Scans, name_by_place, stack, steps, timeline
from tomthumb.types import Array, Ids, Observations, Prior, Scenario, Truth

AHEAD, LEFT = 3.78, 0.5  # m, the laser and GPS point seen from the rear axle's centre
START_HEADING = math.radians(-128.0)
# Residuals against GPS: range 0.03 m, bearing 0.55 deg. GPS itself and the beams' spacing of 0.5 deg are part of that.
STD = (0.03, math.radians(0.55))
# A reading at 40 Hz is not independent of the next, and wheels slip: ACFR's tuning, which dead reckoning (0.9 m after a
# minute) shows to be generous, covers both.
CONTROL_STD = (0.7, math.radians(7.0))
POSE_STD = (0.02, 0.02, math.radians(0.2))  # per square root of second: what steering and speed cannot explain
MAX_RANGE = 16.5  # nothing is bright beyond 15.9 m
DETECT = 0.4  # a pole is narrower than the beams' spacing beyond 7 m, so many scans miss it
NAMED_WITHIN = 0.5  # m from a true beacon; they stand at least 2 m apart


def car_park(path: Path, *, detections: Literal["derived", "raw"] = "derived") -> Scenario:
    """The Car Park log: a folder with data_set.mat, beac_juan3.mat and (for the truth) the folder `derived`.

    The state is the point of laser and GPS. `detections`: "derived" are the beacons of derived/beacon_detections.csv,
    true ids and clutter included; "raw" finds the poles in the laser scans with our own detector, named by the nearest
    true beacon at the true pose. The truth is the GPS position with the heading of derived/heading_reference.csv.

    Raises BrokenFile where a file is missing or is not what it should be.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    file = folder / "data_set.mat"
    names = ["Time_VS", "Velocity", "Steering", "TimeGPS", "GPSLon", "GPSLat", "TimeLaser"]
    raw = load_mat(file, [*names, "Laser", "Intensity"])
    t_u, speed, steering, t_gps, east, north, t_scan = (matrix(raw, name, file, (None,)) for name in names)
    if not len(t_u) or not len(t_gps) or len(steering) != len(t_u) or len(speed) != len(t_u):
        raise BrokenFile(file, "has no odometry or no GPS, or their columns are of unequal length")
    for times in (t_u, t_gps, t_scan):
        increasing(times, file)
    landmarks = matrix(
        load_mat(folder / "beac_juan3.mat", ["estbeac"]), "estbeac", folder / "beac_juan3.mat", (None, 2)
    )
    gps = np.column_stack([t_gps, matrix(raw, "GPSLon", file, t_gps.shape), matrix(raw, "GPSLat", file, t_gps.shape)])
    truth = _truth(folder, gps, t_scan)
    if detections == "derived":
        scans, z, R, ids = _derived(folder, t_scan, len(landmarks))
    else:
        laser = matrix(raw, "Laser", file, (len(t_scan), None))
        scans, z, R, ids = _raw(laser, matrix(raw, "Intensity", file, laser.shape), t_scan, truth, landmarks)

    def scan(i: int) -> tuple[Observations, Truth]:
        rows = scans.rows(i)
        return Observations(z[rows], R[rows]), Truth(known(truth[i]), ids[rows])

    start = min(t_u[0], t_gps[0])
    line = timeline(t_u, t_scan, float(start))
    return Scenario(
        name="car_park",
        motion=Ackermann(ahead=AHEAD, left=LEFT, std=CONTROL_STD, pose_std=POSE_STD),
        sensor=RangeBearing(max_range=MAX_RANGE, fov=math.pi, std=STD, detect=DETECT, clutter=1e-4),
        prior=Prior(np.array([east[0], north[0], START_HEADING]), np.diag([0.05, 0.05, math.radians(2.0)]) ** 2),
        steps=steps(line, np.column_stack([speed, steering]), scan),
        landmarks=landmarks,
        info={"file": str(file), "detections": detections},
    )


def _truth(folder: Path, gps: Array, t: Array) -> Array:
    """The true pose (K, 3) of the laser at each scan; NaN where it is not known."""
    file = folder / "derived" / "heading_reference.csv"
    if not file.exists():
        return np.full((len(t), 3), np.nan)
    heading = table(read_bytes(file), file, 2, sep=",", header=1)
    increasing(heading[:, 0], file, first_line=2)
    places = pose_at(t, gps[:, 0], np.column_stack([gps[:, 1:], np.zeros(len(gps))]), 1.0)
    turned = pose_at(t, heading[:, 0], np.column_stack([np.zeros((len(heading), 2)), heading[:, 1]]), 1.0)
    return np.column_stack([places[:, :2], turned[:, 2]])


def _derived(folder: Path, t_scan: Array, beacons: int) -> tuple[Scans, Array, Array, Ids]:
    file = folder / "derived" / "beacon_detections.csv"
    if not file.exists():
        raise BrokenFile(file, "no such file; detections=raw does without it")
    rows = table(read_bytes(file), file, 6, sep=",", header=1)
    index = whole(rows[:, 0], file, "scan_index")
    if len(index) and (index.min() < 0 or index.max() >= len(t_scan) or (np.diff(index) < 0).any()):
        raise BrokenFile(file, f"scan_index is not increasing within 0 to {len(t_scan) - 1}")
    ids = whole(rows[:, 5], file, "beacon_id")
    if (ids > beacons).any() or (ids < -1).any():
        raise BrokenFile(file, f"a beacon_id is not -1 or 1 to {beacons}")
    cuts = np.searchsorted(index, np.arange(len(t_scan) + 1))
    return Scans(t_scan, cuts), rows[:, 2:4], _noise(len(rows)), np.where(ids > 0, ids - 1, -1)


def _raw(
    laser: Array, intensity: Array, t_scan: Array, truth: Array, landmarks: Array
) -> tuple[Scans, Array, Array, Ids]:
    """Our own detections in all scans, with the nearest true beacon within 0.5 m at the true pose as id."""
    from tomthumb.detectors import reflectors

    angles = np.radians(0.5) * np.arange(laser.shape[1]) - math.pi / 2
    found = [
        reflectors(r, bright, angles, max_range=MAX_RANGE, radius=0.0)  # the residuals show no offset to the centre
        for r, bright in zip(laser, intensity, strict=True)
    ]
    ids = [name_by_place(pose, d.z, landmarks, NAMED_WITHIN) for pose, d in zip(truth, found, strict=True)]
    z = np.concatenate([d.z for d in found]) if found else np.empty((0, 2))
    return stack(t_scan, [len(d.z) for d in found]), z, _noise(len(z)), np.concatenate([np.empty(0, np.int64), *ids])


def _noise(count: int) -> Array:
    return np.tile(np.diag(np.square(STD)), (count, 1, 1))
