"""DLR Spatial Cognition: a robot with a camera among artificial circles on an office floor."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import Cartesian
from tomthumb.scenarios.reading import MAX_ROWS, Steps, floats, known, read_bytes, read_text, table, whole
from tomthumb.scenarios.timeline import stack
from tomthumb.types import Array, Control, Ids, Observations, Prior, Scenario, Step, Truth

NAMES = ("map.circles.gz", "map.circles")
AXIS = -math.pi / 2  # the log's frame: x to the right, -y ahead; it is kept as published
MAX_RANGE, FOV = 4.7, math.radians(150.0)  # circles are seen up to 3.1 m aside and 0.8 to 3.9 m ahead
CAMERA = np.array([-0.0043, 0.0670, 0.0271, 0.0230])  # c0 m, c1, c2 1/m, c3 1/m of `rectified`
MIDDLE = 2.0  # m ahead: the middle of the view
DETECT, CLUTTER = 0.35, 0.01  # 3 % of the observations have no id, over some 15 m2 of view


def dlr(path: Path, *, camera: Literal["published", "rectified"] = "published") -> Scenario:
    """The log map.circles (or .gz), or its folder; the folder `derived` beside it holds the batch solution as truth.

    One step for each STEP of the file, `t` the number of the step (it has no times). Poses and covariances of motions
    and observations are the log's own. An observation whose id is -1 is not scored (-2), since it may be a circle that
    was left unassigned; where several ids stand, the first counts.

    `camera`: "published" leaves the circles where the log has them; "rectified" takes out how the camera bends the plane
    (6 % forwards in the middle of its view, and more farther off), as it was measured from the log's own repeated
    sightings (benchmarks/dlr_camera.py).

    Raises BrokenFile naming the line that is not what the format says.
    """
    file = _file(Path(path))
    motions, covs, counts, z, R, raw_ids = _parse(read_text(file).splitlines(), file)
    if camera == "rectified":
        z, R = rectified(z, CAMERA), _rectified_cov(z, R, CAMERA)
    landmarks, ids = _landmarks(file.parent / "derived" / "reference_ls_landmarks.csv", raw_ids)
    poses = _poses(file.parent / "derived", len(motions))
    scans = stack(np.arange(1.0, len(motions) + 1), counts)

    def step(k: int) -> Step:
        if k == 0:
            return Step(0.0, None, None, Truth(known(poses[0]), None))
        rows = scans.rows(k - 1)
        scan = Observations(z[rows], R[rows])
        return Step(float(k), Control(motions[k - 1], 1.0, covs[k - 1]), scan, Truth(known(poses[k]), ids[rows]))

    return Scenario(
        name="dlr",
        motion=OdometryIncrement(),
        sensor=Cartesian(max_range=MAX_RANGE, fov=FOV, facing=AXIS, detect=DETECT, clutter=CLUTTER),
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        steps=Steps(len(motions) + 1, step),
        landmarks=landmarks,
        info={"file": str(file)},
    )


def rectified(z: Array, camera: Array) -> Array:
    """Circles (m, 2) m where they are: x (1 + c3 (f - 2)) aside, f + c0 + c1 (f - 2) + c2 (f - 2)^2 ahead, f = -y."""
    c0, c1, c2, c3 = camera
    far = -z[:, 1] - MIDDLE
    return np.column_stack([z[:, 0] * (1.0 + c3 * far), -(far + MIDDLE + c0 + c1 * far + c2 * far**2)])


def _rectified_cov(z: Array, R: Array, camera: Array) -> Array:
    _, c1, c2, c3 = camera
    far = -z[:, 1] - MIDDLE
    J = np.zeros((len(z), 2, 2))
    J[:, 0, 0], J[:, 0, 1], J[:, 1, 1] = 1.0 + c3 * far, -c3 * z[:, 0], 1.0 + c1 + 2.0 * c2 * far
    out: Array = J @ R @ J.transpose(0, 2, 1)
    return out


def _file(path: Path) -> Path:
    if not path.is_dir():
        return path
    found = next((path / name for name in NAMES if (path / name).exists()), None)
    if found is None:
        raise BrokenFile(path, "holds no map.circles")
    return found


def _parse(lines: list[str], file: Path) -> tuple[Array, Array, list[int], Array, Array, Ids]:
    motions: list[list[float]] = []
    counts: list[int] = []
    seen: list[list[float]] = []
    if len(lines) > MAX_ROWS:
        raise BrokenFile(file, f"more than {MAX_ROWS} lines")
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0] == "STEP" and len(words) == 11:
            motions.append(floats(words[2:], file, number))
            counts.append(0)
        elif words[0] in ("LANDMARK_C", "LANDMARK") and len(words) >= 8 and counts:
            seen.append(floats(words[1:8], file, number))
            counts[-1] += 1
        else:
            raise BrokenFile(file, "neither a STEP of 11 words nor a LANDMARK_C of 8 after a STEP", number)
    m, s = np.array(motions).reshape(-1, 9), np.array(seen).reshape(-1, 7)
    R = _symmetric(s[:, 3:6], ((0, 0), (0, 1), (1, 1)), 2, file)
    covs = _symmetric(m[:, 3:9], ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), 3, file)
    return m[:, :3], covs, counts, s[:, :2], R, whole(s[:, 6], file, "an id")


def _symmetric(values: Array, places: tuple[tuple[int, int], ...], k: int, file: Path) -> Array:
    out = np.zeros((len(values), k, k))
    for column, (i, j) in enumerate(places):
        out[:, i, j] = out[:, j, i] = values[:, column]
    if len(out) and np.linalg.eigvalsh(out).min() < 0:
        raise BrokenFile(file, "a covariance is not positive definite")
    return out


def _landmarks(file: Path, raw_ids: Ids) -> tuple[Array | None, Ids]:
    """The reference map, and the ids of the observations as its rows (-2 where the log has none)."""
    known_ids = np.unique(raw_ids[raw_ids >= 0])
    rows = np.searchsorted(known_ids, raw_ids).astype(np.int64)
    ids = np.where(raw_ids >= 0, rows, -2)
    if not file.exists():
        return None, ids
    listed = table(read_bytes(file), file, 3, sep=",", header=1)
    landmarks = np.full((len(known_ids), 2), np.nan)
    mine = np.isin(listed[:, 0], known_ids)
    landmarks[np.searchsorted(known_ids, listed[mine, 0])] = listed[mine, 1:]
    return landmarks, ids


def _poses(folder: Path, steps: int) -> Array:
    file = folder / "reference_ls_poses.csv.gz"
    if not file.exists():
        return np.full((steps + 1, 3), np.nan)
    rows = table(read_bytes(file), file, 4, sep=",", header=1)
    if len(rows) != steps + 1:
        raise BrokenFile(file, f"{len(rows)} poses for {steps} steps; one more than steps is expected")
    return rows[:, 1:]
