"""ACFR Victoria Park: a car with a laser drives four kilometres among trees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.geometry import wrap
from tomthumb.models.motion import Ackermann
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.matfile import load_mat
from tomthumb.scenarios.reading import (
    MAX_VALUES,
    increasing,
    known,
    numbers,
    pose_at,
    read_bytes,
    read_member,
    table,
    whole,
)
from tomthumb.scenarios.timeline import Scans, group, stack, steps, timeline
from tomthumb.types import Array, Ids, Observations, Prior, Scenario, Truth

LASER = (3.78, 0.50, 0.0)  # m, m, rad: where the laser sits, seen from the rear axle's centre
# Measured against the batch solution: range 0.11 m, bearing 0.33 deg with the heavy tails (0.06 m, 0.19 deg without).
STD = (0.11, math.radians(0.33))
MEMORY = (1.1, 3.1)  # m of path over which those errors repeat themselves (benchmarks/repetition.py)
# Dead reckoning with DRS.txt is off by 2.2 m after 120 s; readings at 40 Hz err together, so a single one errs by more
# than a look at its noise would say.
CONTROL_STD, POSE_STD = (0.4, math.radians(2.5)), (0.03, 0.03, math.radians(0.25))
MAX_RANGE, FOV, DETECT = 75.0, math.radians(170.0), 0.2  # most trees within 75 m are hidden by others or too thin
CLUTTER = 1e-4  # 0.9 detections without a tree a scan, over some 8000 m2
AA3_START = 20967.0  # ms: the first GPS fix, which the text files count from, on the clock of aa3_dr.mat
BEAM, BEAMS = math.radians(0.5), 361
LONGEST_GAP = 0.5  # s between the batch solution's poses


@dataclass(frozen=True, slots=True)
class Seen:
    """All detections of the log: scans, z (n, 2), R (n, 2, 2), ids (n,) or None, diameters (n,) m."""

    scans: Scans
    z: Array
    R: Array
    ids: Ids | None
    diameter: Array


def victoria_park(
    path: Path,
    *,
    detections: Literal["published", "raw"] = "published",
    odometry: Literal["drs", "aa3"] = "drs",
) -> Scenario:
    """The whole log: a folder with raw_acfr/victoria_park_ascii.zip, features/ and derived/.

    `detections`: "published" are those of ACFR's own detector, with the trunk's diameter as signature; "raw" finds the
    trunks in LASER.txt with our detector. Ids are rows of the 299 trees of the reference association; a detection
    without one is not scored (-2), since it need not be clutter. The truth is the batch solution, at the rear axle.

    `odometry`: "drs" is DRS.txt, whose steering is better calibrated than that of the other record of the same drive,
    "aa3" (aa3_dr.mat), which reads some 5 % too little. ``info["gps"] (n, 3)`` holds the fixes (t s, east m, north m; of
    about the laser's point). Raises BrokenFile where a file is missing or wrong.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    archive = folder / "raw_acfr" / "victoria_park_ascii.zip"
    readings = _odometry(folder, archive, odometry)
    gps = table(read_member(archive, "GPS.txt"), f"{archive}/GPS.txt", 3)[:, [0, 2, 1]]
    increasing(gps[:, 0], f"{archive}/GPS.txt", first_line=1)
    landmarks, row = _landmarks(folder)
    seen = _published(folder, row) if detections == "published" or row else None
    if detections == "raw":
        seen = _raw(archive, seen)
    assert seen is not None
    if not len(readings) or not len(seen.scans.t):
        raise BrokenFile(folder, "holds no odometry or no scans")
    truth = _truth(folder, seen.scans.t)
    start = float(seen.scans.t[0])

    def scan(i: int) -> tuple[Observations, Truth]:
        rows = seen.scans.rows(i)
        ids = None if seen.ids is None else seen.ids[rows]
        return Observations(seen.z[rows], seen.R[rows], signature=seen.diameter[rows]), Truth(known(truth[i]), ids)

    first = truth[0] if np.isfinite(truth[0]).all() else np.zeros(3)
    return Scenario(
        name="victoria_park",
        motion=Ackermann(std=CONTROL_STD, pose_std=POSE_STD),
        sensor=RangeBearing(
            max_range=MAX_RANGE, fov=FOV, mount=LASER, std=STD, detect=DETECT, clutter=CLUTTER, memory=MEMORY
        ),
        prior=Prior(first, np.zeros((3, 3))),
        steps=steps(timeline(readings[:, 0], seen.scans.t, start), readings[:, 1:], scan),
        landmarks=landmarks,
        info={"file": str(folder), "detections": detections, "odometry": odometry, "gps": gps},
    )


def _odometry(folder: Path, archive: Path, record: str) -> Array:
    """Time s (from the first GPS fix), speed m/s and steering angle rad (n, 3) of one of the two records."""
    if record == "drs":
        rows = table(read_member(archive, "DRS.txt"), f"{archive}/DRS.txt", 3)
        increasing(rows[:, 0], f"{archive}/DRS.txt", first_line=1)
        return rows
    file = folder / "raw_acfr" / "aa3_dr.mat"
    names = ("time", "speed", "steering")
    raw = load_mat(file, names)
    ms, speed, steering = (np.asarray(raw[name], float).ravel() for name in names)
    if not len(ms) == len(speed) == len(steering):
        raise BrokenFile(file, f"time, speed and steering of {len(ms)}, {len(speed)} and {len(steering)} samples")
    increasing(ms, file)
    return np.column_stack([(ms - AA3_START) / 1e3, speed, steering])


def _landmarks(folder: Path) -> tuple[Array | None, dict[int, int]]:
    """The reference map (n, 2) and the row of each reference id."""
    file = folder / "derived" / "reference_ls_landmarks.csv"
    if not file.exists():
        return None, {}
    rows = table(read_bytes(file), file, 5, sep=",", header=1)
    return rows[:, 1:3], {int(k): row for row, k in enumerate(whole(rows[:, 0], file, "ref_id"))}


def _truth(folder: Path, t: Array) -> Array:
    file = folder / "derived" / "reference_ls_poses.csv.gz"
    if not file.exists():
        return np.full((len(t), 3), np.nan)
    rows = table(read_bytes(file), file, 4, sep=",", header=1)
    increasing(rows[:, 0], file, first_line=2)
    return pose_at(t, rows[:, 0], rows[:, 1:], LONGEST_GAP)


def _published(folder: Path, row: dict[int, int]) -> Seen:
    """The labelled detections, or those without labels where the former are not there."""
    file = folder / "derived" / "detections_labelled.csv.gz"
    if file.exists():
        rows = table(read_bytes(file), file, 6, sep=",", header=1)
        t, z, diameter = rows[:, 1], rows[:, 2:4].copy(), rows[:, 4]
        ids = np.array([row.get(int(k), -2) for k in whole(rows[:, 5], file, "ref_id")], np.int64)
    else:
        named = [folder / "features" / f"measurements.dat{suffix}" for suffix in (".gz", "")]
        file, ids = next((f for f in named if f.exists()), named[0]), None
        rows = table(read_bytes(file), file, 4)
        t, z, diameter = rows[:, 0], rows[:, 1:3].copy(), rows[:, 3]
    increasing(t, file)
    z[:, 1] = wrap(z[:, 1] - math.pi / 2)  # the laser's angles begin at the right
    R = np.tile(np.diag(np.square(STD)), (len(z), 1, 1))
    return Seen(group(t), z, R, ids, diameter)


def _raw(archive: Path, published: Seen | None) -> Seen:
    """Our own detections in LASER.txt, with the labels of the published ones at the same place and time."""
    from tomthumb.detectors import trunks

    laser = numbers(read_member(archive, "LASER.txt"), f"{archive}/LASER.txt")
    if len(laser) % (BEAMS + 1) or len(laser) > MAX_VALUES:
        raise BrokenFile(f"{archive}/LASER.txt", f"{len(laser)} numbers are not rows of {BEAMS + 1}")
    laser = laser.reshape(-1, BEAMS + 1)
    increasing(laser[:, 0], f"{archive}/LASER.txt")
    angles: Array = BEAM * np.arange(BEAMS, dtype=float) - math.pi / 2
    found = [trunks(scan, angles) for scan in laser[:, 1:]]
    z = np.concatenate([np.empty((0, 2)), *(d.z for d in found)])
    scans = stack(laser[:, 0], [len(d.z) for d in found])
    R = np.tile(np.diag(np.square(STD)), (len(z), 1, 1))
    ids = None
    if published is not None and published.ids is not None:
        ids = _labels(scans, z, published, published.ids)
    return Seen(scans, z, R, ids, np.concatenate([np.empty(0), *(d.diameter for d in found)]))


def _labels(scans: Scans, z: Array, published: Seen, ids: Ids) -> Ids:
    """The id of the published detection within 0.3 m at the same time (5 ms), else -2."""
    out = np.full(len(z), -2, np.int64)
    at = np.searchsorted(published.scans.t, scans.t - 0.005)
    for i, k in enumerate(at):
        if k >= len(published.scans.t) or abs(published.scans.t[k] - scans.t[i]) > 0.005:
            continue
        mine, theirs = scans.rows(i), published.scans.rows(int(k))
        if mine.start < mine.stop and theirs.start < theirs.stop:
            apart = np.linalg.norm(_points(z[mine])[:, None] - _points(published.z[theirs])[None], axis=2)
            nearest = apart.argmin(1)
            out[mine] = np.where(apart.min(1) < 0.3, ids[theirs][nearest], -2)
    return out


def _points(z: Array) -> Array:
    return np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])
