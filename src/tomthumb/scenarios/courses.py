"""Two small simulated logs with known association: I-SLSJF (UTS) and the Freiburg robot-mapping course."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.geometry import wrap
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.matfile import load_mat, matrix
from tomthumb.scenarios.reading import Steps, floats, read_bytes, read_text, table, whole
from tomthumb.scenarios.timeline import Scans, stack
from tomthumb.types import Array, Control, Ids, Observations, Prior, Scenario, Step, Truth

DT = 0.3  # s
# What parameters.txt calls variances are standard deviations (checked against the true values).
SPEED_STD, TURN_STD = 0.02, math.radians(4.0)
RANGE_STD, BEARING_STD = 0.1, math.radians(1.0)
# Residuals against dead reckoning, which is good: range 0.10 to 0.12 m, bearing 2.7 to 5 deg.
COURSE_STD = (0.12, math.radians(4.0))
COURSE_ODOMETRY = (0.01, 0.01, 0.01)  # rad, m, rad: residuals of the observations leave room for no more


def slsjf(path: Path) -> Scenario:
    """A simulated set of 2-D I-SLSJF: a folder with sensor_data.mat, store_speed.mat and so on.

    The robot first turns by w T, then drives v T straight (the authors' model), so each step is an increment with the
    covariance that the noise of speed and turn rate gives. Raises BrokenFile where a file is missing or wrong.
    """
    folder = _set(Path(path))
    speed, turn = (_one(folder, f"store_{name}.mat", (None,)) for name in ("speed", "turnrate"))
    truth = _one(folder, "store_robotTrue.mat", (3, None)).T
    beacons = _one(folder, "store_beaconsTrue.mat", (None, 3))
    rows = _one(folder, "sensor_data.mat", (None, 7))
    file = folder / "sensor_data.mat"
    steps = min(len(truth), len(speed) + 1, len(turn) + 1)
    index = whole(rows[:, 0], file, "a step") - 1
    if len(index) and (index.min() < 0 or index.max() >= steps or (np.diff(index) < 0).any()):
        raise BrokenFile(file, f"the steps are not increasing within 1 to {steps}")
    landmarks, ids = _by_number(beacons, whole(rows[:, 1], file, "a beacon"), file)
    z = np.column_stack([rows[:, 2], wrap(rows[:, 3])])
    scans = Scans(np.arange(steps, dtype=float), np.searchsorted(index, np.arange(steps + 1)))
    R = np.diag([RANGE_STD**2, BEARING_STD**2])

    def step(k: int) -> Step:
        part = scans.rows(k)
        scan = Observations(z[part], np.tile(R, (len(z[part]), 1, 1)))
        control = _turn_then_drive(speed[k - 1] * DT, turn[k - 1] * DT) if k else None
        return Step(k * DT, control, scan, Truth(truth[k], ids[part]))

    reach = float(rows[:, 2].max(initial=0.1))
    fov = min(2 * math.pi, 2.02 * float(np.abs(z[:, 1]).max(initial=0.1)))
    return Scenario(
        name=f"slsjf {folder.name}",
        motion=OdometryIncrement(),
        sensor=RangeBearing(max_range=reach * 1.02, fov=fov, std=(RANGE_STD, BEARING_STD), detect=0.95, clutter=1e-3),
        prior=Prior(truth[0], np.zeros((3, 3))),
        steps=Steps(steps, step),
        landmarks=landmarks,
        info={"file": str(folder)},
    )


def _set(path: Path) -> Path:
    """The folder of the set: `path`, the one that holds it, or its only subfolder that is one."""
    path = path if path.is_dir() else path.parent
    if (path / "sensor_data.mat").exists():
        return path
    inside = [p.parent for p in sorted(path.glob("*/sensor_data.mat"))]
    if len(inside) != 1:
        raise BrokenFile(path, f"holds {len(inside)} folders with a sensor_data.mat: name the one of the set")
    return inside[0]


def _one(folder: Path, name: str, shape: tuple[int | None, ...]) -> Array:
    """The only variable of a file, which has the name of the file."""
    return matrix(load_mat(folder / name, [Path(name).stem]), Path(name).stem, folder / name, shape)


def _by_number(listed: Array, numbers: Ids, file: Path) -> tuple[Array, Ids]:
    """Landmarks (n, 2) out of rows (number, x, y), and observed numbers as their rows."""
    order = np.argsort(listed[:, 0])
    have = listed[order, 0]
    rows = np.searchsorted(have, numbers)
    if len(numbers) and (not len(have) or (have[np.minimum(rows, len(have) - 1)] != numbers).any()):
        raise BrokenFile(file, "a landmark is observed that the map does not list")
    return listed[order, 1:3], rows.astype(np.int64)


def _turn_then_drive(way: float, turn: float) -> Control:
    c, s = math.cos(turn), math.sin(turn)
    J = np.array([[c, -way * s], [s, way * c], [0.0, 1.0]]) * DT
    return Control(np.array([way * c, way * s, turn]), DT, J @ np.diag([SPEED_STD**2, TURN_STD**2]) @ J.T)


def freiburg(path: Path) -> Scenario:
    """The landmark exercise of the Freiburg course: a folder with sensor_data.dat and world.dat (or the former file).

    A step is an ODOMETRY line (rotate, translate, rotate) with the SENSOR lines after it, `t` its number. There is no
    true trajectory. Raises BrokenFile naming the line that is wrong.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    file, world = folder / "sensor_data.dat", folder / "world.dat"
    motions, counts, seen = _course(read_text(file).splitlines(), file)
    landmarks, ids = _by_number(table(read_bytes(world), world, 3), whole(seen[:, 0], file, "a landmark"), file)
    scans = stack(np.arange(1.0, len(motions) + 1), counts)
    R = np.diag(np.square(COURSE_STD))

    def step(k: int) -> Step:
        if k == 0:
            return Step(0.0, None, None, None)
        rows = scans.rows(k - 1)
        scan = Observations(seen[rows, 1:], np.tile(R, (len(seen[rows]), 1, 1)))
        return Step(float(k), _rotate_drive_rotate(motions[k - 1]), scan, Truth(None, ids[rows]))

    return Scenario(
        name="freiburg",
        motion=OdometryIncrement(),
        sensor=RangeBearing(max_range=5.5, std=COURSE_STD, detect=0.9, clutter=1e-3),
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        steps=Steps(len(motions) + 1, step),
        landmarks=landmarks,
        info={"file": str(file)},
    )


def _course(lines: list[str], file: Path) -> tuple[Array, list[int], Array]:
    motions: list[list[float]] = []
    counts: list[int] = []
    seen: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if words[0] == "ODOMETRY" and len(words) == 4:
            motions.append(floats(words[1:], file, number))
            counts.append(0)
        elif words[0] == "SENSOR" and len(words) == 4 and counts:
            seen.append(floats(words[1:], file, number))
            counts[-1] += 1
        else:
            raise BrokenFile(file, "neither ODOMETRY r t r nor SENSOR id range bearing after one", number)
    return np.array(motions).reshape(-1, 3), counts, np.array(seen).reshape(-1, 3)


def _rotate_drive_rotate(motion: Array) -> Control:
    first, way, second = (float(v) for v in motion)
    c, s = math.cos(first), math.sin(first)
    J = np.array([[-way * s, c, 0.0], [way * c, s, 0.0], [1.0, 0.0, 1.0]])
    cov = J @ np.diag(np.square(COURSE_ODOMETRY)) @ J.T
    return Control(np.array([way * c, way * s, first + second]), 1.0, cov)
