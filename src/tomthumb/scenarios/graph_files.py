"""Pose graphs with point landmarks as logs: g2o, iSAM and TORO text files, CityTrees10000 among them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.geometry import compose
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import Cartesian
from tomthumb.scenarios.reading import MAX_ROWS, Steps, floats, read_text
from tomthumb.types import Array, Control, Ids, Observations, Prior, Scenario, Step, Truth

Convention = Literal["auto", "g2o", "isam", "toro"]


@dataclass(slots=True)
class _Graph:
    """What a file holds, in its own numbers: edges between poses and from poses to landmarks, and vertices."""

    motions: dict[int, tuple[int, Array, Array]] = field(default_factory=dict)  # by later pose
    loops: int = 0
    seen: dict[int, list[tuple[int, Array, Array]]] = field(default_factory=dict)  # by pose
    poses: dict[int, Array] = field(default_factory=dict)
    points: dict[int, Array] = field(default_factory=dict)


def graph(
    path: Path, *, convention: Convention = "auto", truth: Path | None = None, merge_twins: bool = True
) -> Scenario:
    """A log out of EDGE_SE2 / EDGE2 / ODOMETRY and EDGE_SE2_XY / LANDMARK lines, poses in the order of their numbers.

    Matrices are information (g2o, TORO) or the square root of it (iSAM); "auto" takes g2o for its tags, TORO where
    VERTEX2 stands and iSAM otherwise. Edges between poses that do not follow one another (loop closures) are left out
    and counted in ``info["loops"]``. `truth` is a file of the same kind without noise; without it NAME_groundtruth of
    the same or the upper folder is taken, if it is there. Landmarks that stand at one place in the truth under two
    numbers share one id with `merge_twins`, since nobody could tell them apart; ``info["twins"]`` counts them.

    Raises BrokenFile naming the line that is not what the format says.
    """
    file = _file(Path(path))
    read = _read(file, convention)
    if not read.motions and not read.seen:
        raise BrokenFile(file, "holds no edges")
    truth_file = Path(truth) if truth is not None else _truth_beside(file)
    numbers = sorted({*read.motions, *read.seen, *(before for before, _, _ in read.motions.values())})
    names = sorted({name for scan in read.seen.values() for name, _, _ in scan})
    poses, landmarks = _truth(truth_file, numbers, names, convention)
    first = numbers[0]
    start = read.poses.get(first, np.zeros(3)) if poses is None else poses[0]
    row, twins = _rows(names, landmarks, merge_twins)

    def step(k: int) -> Step:
        number = numbers[k]
        edges = read.seen.get(number, [])
        z = np.array([point for _, point, _ in edges]).reshape(-1, 2)
        R = np.array([cov for _, _, cov in edges]).reshape(-1, 2, 2)
        ids = np.array([row[name] for name, _, _ in edges], np.int64)
        return Step(
            float(k),
            None if k == 0 or number not in read.motions else Control(*_control(read.motions[number])),
            Observations(z, R),
            Truth(None if poses is None else poses[k], ids),
        )

    reach = max((math.hypot(*point) for scan in read.seen.values() for _, point, _ in scan), default=1.0)
    return Scenario(
        name=file.name.split(".")[0],
        motion=OdometryIncrement(),
        sensor=Cartesian(max_range=reach * 1.02, detect=DETECT, clutter=1e-3),
        prior=Prior(start, np.zeros((3, 3))),
        steps=Steps(len(numbers), step),
        landmarks=landmarks,
        info={"file": str(file), "loops": read.loops, "twins": twins},
    )


def _control(edge: tuple[int, Array, Array]) -> tuple[Array, float, Array]:
    return edge[1], 1.0, edge[2]


def _file(path: Path) -> Path:
    if not path.is_dir():
        return path
    found = [p for p in sorted(path.iterdir()) if p.name.split(".", 1)[-1] in _SUFFIXES and "groundtruth" not in p.name]
    if len(found) != 1:
        raise BrokenFile(path, f"holds {len(found)} graph files: name the one to read")
    return found[0]


_SUFFIXES = {f"{kind}{zip_}" for kind in ("g2o", "graph", "toro", "txt") for zip_ in ("", ".gz", ".xz", ".bz2")}


def _truth_beside(file: Path) -> Path | None:
    stem = file.name.split(".")[0]
    for name in (stem, stem.rsplit("_", 1)[0]):
        for folder in (file.parent, file.parent.parent):
            for suffix in (".txt", ".txt.gz", ".txt.xz", ".g2o"):
                candidate = folder / f"{name}_groundtruth{suffix}"
                if candidate.exists():
                    return candidate
    return None


def _read(file: Path, convention: Convention) -> _Graph:
    lines = read_text(file).splitlines()
    if len(lines) > MAX_ROWS:
        raise BrokenFile(file, f"more than {MAX_ROWS} lines")
    edge2: Convention = convention
    if convention == "auto":
        edge2 = "toro" if any(line.startswith("VERTEX2 ") for line in lines[:10_000]) else "isam"
    out = _Graph()
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#") or words[0] in _IGNORED:
            continue
        if words[0] not in _WIDTH:
            raise BrokenFile(file, f"unknown tag {words[0][:40]!r}; known: {', '.join(_WIDTH)}", number)
        values = floats(words[1:], file, number)
        if len(values) != _WIDTH[words[0]]:
            raise BrokenFile(file, f"{words[0]} has {len(values)} values where {_WIDTH[words[0]]} are expected", number)
        _TAGS[words[0]](out, values, words[0], edge2, f"{file}:{number}")
    return out


def _number(value: float, where: str) -> int:
    if value != int(value) or abs(value) > 2**53:
        raise BrokenFile(where, "a vertex number is not whole")
    return int(value)


def _vertex(out: _Graph, v: list[float], tag: str, kind: Convention, where: str) -> None:
    (out.poses if len(v) == 4 else out.points)[_number(v[0], where)] = np.array(v[1:])


def _motion(out: _Graph, v: list[float], tag: str, kind: Convention, where: str) -> None:
    before, after = _number(v[0], where), _number(v[1], where)
    if after != before + 1 or after in out.motions:
        out.loops += 1
        return
    order = _TORO if kind == "toro" and tag == "EDGE2" else _ROWS3
    out.motions[after] = before, np.array(v[2:5]), _covariance(v[5:], order, 3, tag, kind, where)


def _sighting(out: _Graph, v: list[float], tag: str, kind: Convention, where: str) -> None:
    pose, name = _number(v[0], where), _number(v[1], where)
    cov = _covariance(v[4:], ((0, 0), (0, 1), (1, 1)), 2, tag, kind, where)
    out.seen.setdefault(pose, []).append((name, np.array(v[2:4]), cov))


_ROWS3 = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_TORO = ((0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2))


def _covariance(
    v: list[float], order: tuple[tuple[int, int], ...], k: int, tag: str, kind: Convention, where: str
) -> Array:
    """The covariance of an edge: the inverse of its information, given as such or as an upper square root."""
    info = np.zeros((k, k))
    for value, (i, j) in zip(v, order, strict=True):
        info[i, j] = value
    root = kind == "isam" and tag in ("EDGE2", "ODOMETRY", "LANDMARK")
    info = info.T @ info if root else info + np.triu(info, 1).T
    try:
        if np.linalg.eigvalsh(info).min() <= 0:
            raise np.linalg.LinAlgError
        with np.errstate(all="ignore"):
            cov = np.linalg.inv(info)
    except np.linalg.LinAlgError:
        raise BrokenFile(where, f"the information of {tag} is not positive definite") from None
    if not np.isfinite(cov).all():
        raise BrokenFile(where, f"the information of {tag} is too small to be inverted")
    return np.asarray((cov + cov.T) / 2)


DETECT = 0.3  # such files tell nothing of the field of view; in CityTrees10000 a quarter of the trees in range are seen
Handler = Callable[[_Graph, list[float], str, Convention, str], None]
_WIDTH = {
    "EDGE_SE2": 11,
    "EDGE2": 11,
    "ODOMETRY": 11,
    "EDGE_SE2_XY": 7,
    "LANDMARK": 7,
    "VERTEX_SE2": 4,
    "VERTEX2": 4,
    "VERTEX_XY": 3,
}
_TAGS: dict[str, Handler] = {
    **dict.fromkeys(("EDGE_SE2", "EDGE2", "ODOMETRY"), _motion),
    **dict.fromkeys(("EDGE_SE2_XY", "LANDMARK"), _sighting),
    **dict.fromkeys(("VERTEX_SE2", "VERTEX2", "VERTEX_XY"), _vertex),
}
_IGNORED = ("FIX", "PARAMS_SE2OFFSET")


def _truth(
    file: Path | None, numbers: list[int], names: list[int], convention: Convention
) -> tuple[Array | None, Array | None]:
    """True poses (K, 3) and landmarks (n, 2), chained from the noise-free edges."""
    if file is None:
        return None, None
    read = _read(file, convention)
    poses = [read.poses.get(numbers[0], np.zeros(3))]
    for number in numbers[1:]:
        if number not in read.motions:
            raise BrokenFile(file, f"has no edge to pose {number}")
        poses.append(compose(poses[-1], read.motions[number][1]))
    where = dict(zip(numbers, poses, strict=True))
    landmarks = np.full((len(names), 2), np.nan)
    row = {name: k for k, name in enumerate(names)}
    for number, scan in read.seen.items():
        for name, point, _ in scan:
            if name in row and number in where:
                landmarks[row[name]] = compose(where[number], np.array([*point, 0.0]))[:2]
    return np.array(poses), landmarks


def _rows(names: list[int], landmarks: Array | None, merge: bool) -> tuple[dict[int, int], int]:
    """The id of each landmark's number, and how many stand where another does."""
    rows: Ids = np.arange(len(names))
    twins = 0
    if landmarks is not None and merge:
        for k in range(len(names)):
            same = np.flatnonzero(np.linalg.norm(landmarks[:k] - landmarks[k], axis=1) < TWIN)
            if same.size:
                rows[k], twins = rows[same[0]], twins + 1
    return {name: int(row) for name, row in zip(names, rows, strict=True)}, twins


TWIN = 1e-3  # m: chaining ten thousand edges leaves rounding of this order
