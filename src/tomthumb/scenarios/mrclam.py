"""UTIAS MRCLAM: five robots with cameras among barcode tubes, nine published sets of the same layout."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.models.motion import Velocity
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.reading import increasing, known, pose_at, read_bytes, table, whole
from tomthumb.scenarios.timeline import group, steps, timeline
from tomthumb.types import Array, Ids, Observations, Prior, Scenario, Truth

SUFFIXES = ("", ".xz", ".gz", ".bz2")
ROBOTS = 5
# What the files call a range is the depth along the camera's axis, for it is told from how large a barcode looks: DEPTH times
# the true depth, 1.024 to 1.052 by robot. Ranges made of it are off by 0.04 to 0.07 m rms against Vicon, by robot, bearings by
# 0.6 to 0.9 deg, and robot 1's by 1.6 deg: STD is the worst robot's. The numbers as they stand are off by 0.12 to 0.19 m.
DEPTH = 1.036
WIDEST = math.radians(60.0)  # far outside the camera's view: no depth is divided by a cosine near zero
STD, STD_AS_RANGES = (0.07, math.radians(1.6)), (0.15, math.radians(1.2))
# The controls are commands, not measurements. What is left of their error with DELAY, TURN and SPEED, as noise of each
# command, is that of the worst robot over the longest span measured, 60 s (docs/logs.md has the figures for others).
CONTROL_STD = (0.14, 0.27)
DELAY = 0.25  # s from a command to the motion: 0.20 to 0.30 by robot of set 7, against Vicon; the camera's clock is right to 0.05 s
TURN = 0.95  # of the turn that is commanded is made: what makes heading over 1, 5 and 20 s fit Vicon best
SPEED = 0.91  # of the speed that is commanded is made: 0.88 to 0.92 by robot
MAX_DELAY, MAX_SHARE, LEAST_DEPTH = 10.0, 10.0, 0.1
LONGEST_GAP = 0.5  # s, over which the true pose may be interpolated
MAX_RANGE, FOV, DETECT = 9.0, math.radians(68.0), 0.3


def mrclam(
    path: Path,
    *,
    robot: int = 1,
    delay: float = DELAY,
    turn: float = TURN,
    speed: float = SPEED,
    depth: float = DEPTH,
) -> Scenario:
    """One robot of a set: the folder with Barcodes.dat, Landmark_Groundtruth.dat and RobotN_*.dat (plain, .xz or .gz).

    Sightings of other robots and of barcodes that belong to nobody are left out. The odometry holds commands, which
    act `delay` s later; of the turn and the speed that they say the robot makes the shares `turn` and `speed`. The ranges
    in the files are depths along the camera's axis, `depth` times the true ones; `depth=0` takes them for ranges. The log
    starts where both odometry and ground truth (if there is any) have begun. Without ground truth the robot starts at
    (0, 0, 0).

    Raises BrokenFile for missing or broken files, TomThumbError for a `robot` other than 1 to 5 or an impossible delay,
    turn, speed or depth.
    """
    _check(robot, delay, turn, speed, depth)
    folder = _folder(Path(path))
    landmarks, index = _landmarks(folder)
    odometry = _read(folder, f"Robot{robot}_Odometry", 3)
    if not len(odometry):
        raise BrokenFile(folder / f"Robot{robot}_Odometry.dat", "holds no odometry")
    odometry[:, 0] += delay
    odometry[:, 1] *= speed
    odometry[:, 2] *= turn
    sightings, ids = _sightings(folder, robot, index, depth)
    truth = _ground_truth(folder, robot)
    start = float(odometry[0, 0] if truth is None else max(odometry[0, 0], truth[0, 0]))
    seen = sightings[:, 0] >= start
    sightings, ids = sightings[seen], ids[seen]
    scans = group(sightings[:, 0])
    poses = np.full((len(scans.t), 3), np.nan)
    first = np.zeros(3)
    if truth is not None:
        poses = pose_at(scans.t, truth[:, 0], truth[:, 1:], LONGEST_GAP)
        first = pose_at(np.array([start]), truth[:, 0], truth[:, 1:], np.inf)[0]
    std = STD if depth else STD_AS_RANGES
    R = np.diag(np.square(std))

    def scan(i: int) -> tuple[Observations, Truth]:
        rows = scans.rows(i)
        z = sightings[rows, 2:4]
        return Observations(z, np.tile(R, (len(z), 1, 1))), Truth(known(poses[i]), ids[rows])

    return Scenario(
        name=f"mrclam robot {robot}",
        motion=Velocity(std=CONTROL_STD),
        sensor=RangeBearing(max_range=MAX_RANGE, fov=FOV, std=std, detect=DETECT, clutter=1e-3),
        prior=Prior(first, np.zeros((3, 3))),
        steps=steps(timeline(odometry[:, 0], scans.t, start), odometry[:, 1:], scan),
        landmarks=landmarks,
        info={"file": str(folder), "robot": robot},
    )


def _sightings(folder: Path, robot: int, index: dict[int, int], depth: float) -> tuple[Array, Ids]:
    """Sightings of landmarks (m, 4): time, barcode, range m, bearing rad, and which one each is (m,); no robots."""
    sightings = _read(folder, f"Robot{robot}_Measurement", 4)
    codes = whole(sightings[:, 1], folder / f"Robot{robot}_Measurement.dat", "a barcode")
    ids = np.array([index.get(int(code), -1) for code in codes], np.int64)
    sightings, ids = sightings[ids >= 0], ids[ids >= 0]
    sightings[:, 2] = _ranges(sightings[:, 2], sightings[:, 3], depth)
    return sightings, ids


def _check(robot: int, delay: float, turn: float, speed: float, depth: float) -> None:
    if not 1 <= robot <= ROBOTS:
        raise TomThumbError(f"mrclam: robot={robot}: 1 to {ROBOTS}")
    if not 0 <= delay <= MAX_DELAY:
        raise TomThumbError(f"mrclam: delay={delay:g}: 0 to {MAX_DELAY:g} s")
    for name, share in (("turn", turn), ("speed", speed)):
        if not 0 < share <= MAX_SHARE:
            raise TomThumbError(f"mrclam: {name}={share:g}: above 0, and at most {MAX_SHARE:g}")
    if not (depth == 0 or LEAST_DEPTH <= depth <= MAX_SHARE):
        raise TomThumbError(f"mrclam: depth={depth:g}: 0 (they are ranges), or {LEAST_DEPTH:g} to {MAX_SHARE:g}")


def _ranges(told: Array, bearing: Array, depth: float) -> Array:
    """Ranges (k,) m of what stands `told` (k,) m ahead, times `depth`, in the directions `bearing` (k,) rad."""
    return told / (depth * np.cos(np.clip(bearing, -WIDEST, WIDEST))) if depth else told


def _folder(path: Path) -> Path:
    """The folder of the set: `path`, or its only subfolder that is one."""
    path = path if path.is_dir() else path.parent
    if _find(path, "Barcodes") is not None:
        return path
    inside = [p.parent for p in sorted(path.glob("*/Barcodes.dat*"))]
    if len(inside) != 1:
        raise BrokenFile(path, f"holds {len(inside)} folders with a Barcodes.dat: name the one of the set")
    return inside[0]


def _find(folder: Path, name: str) -> Path | None:
    return next((file for s in SUFFIXES if (file := folder / f"{name}.dat{s}").exists()), None)


def _read(folder: Path, name: str, columns: int) -> Array:
    file = _find(folder, name)
    if file is None:
        raise BrokenFile(folder, f"holds no {name}.dat")
    rows = table(read_bytes(file), file, columns)
    if name.startswith("Robot"):
        increasing(rows[:, 0], file)
    return rows


def _landmarks(folder: Path) -> tuple[Array, dict[int, int]]:
    """The landmarks (n, 2) and, for each barcode of one, its row."""
    tubes = _read(folder, "Landmark_Groundtruth", 5)
    subjects = {int(s): row for row, s in enumerate(whole(tubes[:, 0], folder, "a subject in Landmark_Groundtruth"))}
    pairs = whole(_read(folder, "Barcodes", 2), folder, "a number in Barcodes")
    return tubes[:, 1:3], {int(code): subjects[int(s)] for s, code in pairs if int(s) in subjects}


def _ground_truth(folder: Path, robot: int) -> Array | None:
    if _find(folder, f"Robot{robot}_Groundtruth") is None:
        return None
    rows = _read(folder, f"Robot{robot}_Groundtruth", 4)
    return rows if len(rows) else None
