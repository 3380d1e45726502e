"""Graphs as g2o text, with every landmark, every edge and every covariance: what is written is read back.

VERTEX_SE2 and VERTEX_XY, EDGE_SE2 and EDGE_SE2_XY, EDGE_PRIOR_SE2; information matrices by their upper triangle; m,
rad. Range-bearing sightings have no edge type there: they are written as points, with covariances carried over.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.smoothing.graph import FLOOR, Graph
from tomthumb.types import Array

FIELDS = {"VERTEX_SE2": 4, "VERTEX_XY": 3, "EDGE_SE2": 11, "EDGE_SE2_XY": 7, "EDGE_PRIOR_SE2": 10}
IGNORED = {"FIX"}


def save_g2o(graph: Graph, path: str | Path) -> None:
    """Write a graph. Poses are vertices 0 to K - 1, landmarks those behind."""
    Path(path).write_text("\n".join(_lines(graph)) + "\n")


def _lines(graph: Graph) -> Iterator[str]:
    K = len(graph.poses)
    for k, pose in enumerate(graph.poses):
        yield _line("VERTEX_SE2", [k], pose)
    for n, point in enumerate(graph.landmarks):
        yield _line("VERTEX_XY", [K + n], point)
    yield _line("EDGE_PRIOR_SE2", [0], graph.prior, graph.prior_cov)
    for (i, j), delta, cov in zip(graph.edges.tolist(), graph.delta, graph.delta_cov, strict=True):
        yield _line("EDGE_SE2", [i, j], delta, cov)
    z, R = as_points(graph.z, graph.R) if graph.polar else (graph.z, graph.R)
    for (k, n), point, cov in zip(graph.sightings.tolist(), z, R, strict=True):
        yield _line("EDGE_SE2_XY", [k, K + n], point, cov)


def _line(tag: str, vertices: list[int], values: Array, cov: Array | None = None) -> str:
    information = [] if cov is None else np.linalg.inv(cov)[np.triu_indices(len(cov))].tolist()
    return " ".join([tag, *map(str, vertices), *(repr(v) for v in [*np.asarray(values).tolist(), *information])])


def as_points(z: Array, R: Array) -> tuple[Array, Array]:
    """Range and bearing (M, 2) with covariances (M, 2, 2) as points in the sensor's frame, to first order."""
    c, s, r = np.cos(z[:, 1]), np.sin(z[:, 1]), z[:, 0]
    J = np.stack([np.stack([c, -r * s], -1), np.stack([s, r * c], -1)], -2)
    return np.column_stack([r * c, r * s]), J @ R @ J.transpose(0, 2, 1)


@dataclass
class _Read:
    """What the lines of a file have said so far."""

    poses: dict[int, list[float]] = field(default_factory=dict)
    points: dict[int, list[float]] = field(default_factory=dict)
    edges: list[tuple[int, list[int], list[float]]] = field(default_factory=list)
    sightings: list[tuple[int, list[int], list[float]]] = field(default_factory=list)
    prior: tuple[int, list[float]] | None = None


def load_g2o(path: str | Path) -> Graph:
    """Read a graph. Without a prior the first pose is held. Raises BrokenFile, with the line that is not understood."""
    read = _Read()
    try:
        text = Path(path).read_text()
    except (OSError, UnicodeDecodeError) as reason:
        raise BrokenFile(path, f"cannot be read ({reason})") from reason
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if words and words[0] not in IGNORED and not words[0].startswith("#"):
            _take(read, words, path, number)
    if not read.poses:
        raise BrokenFile(path, "no VERTEX_SE2 in it")
    return _assemble(read, path)


def _take(read: _Read, words: list[str], path: object, number: int) -> None:
    """One line into `read`."""
    tag, rest = words[0], words[1:]
    if tag not in FIELDS:
        raise BrokenFile(path, f"{tag} is not a tag of planar graphs; known: {', '.join(FIELDS)}", number)
    if len(rest) != FIELDS[tag]:
        raise BrokenFile(path, f"{tag} has {len(rest)} fields, not {FIELDS[tag]}", number)
    ends = 2 if tag in ("EDGE_SE2", "EDGE_SE2_XY") else 1
    try:
        vertices, values = [int(w) for w in rest[:ends]], [float(w) for w in rest[ends:]]
    except ValueError as reason:
        raise BrokenFile(path, f"{tag}: {reason}", number) from reason
    if not np.isfinite(values).all():
        raise BrokenFile(path, f"{tag}: a value is not finite", number)
    if tag.startswith("VERTEX"):
        (read.poses if tag == "VERTEX_SE2" else read.points)[vertices[0]] = values
    elif tag == "EDGE_PRIOR_SE2":
        read.prior = (number, values)
    else:
        (read.edges if tag == "EDGE_SE2" else read.sightings).append((number, vertices, values))


def _assemble(read: _Read, path: object) -> Graph:
    pose_at = {v: k for k, v in enumerate(sorted(read.poses))}
    point_at = {v: n for n, v in enumerate(sorted(read.points))}
    poses = np.array([read.poses[v] for v in sorted(read.poses)])
    points = np.array([read.points[v] for v in sorted(read.points)]).reshape(-1, 2)
    edges = _named(read.edges, pose_at, pose_at, path)
    sightings = _named(read.sightings, pose_at, point_at, path)
    prior, prior_cov = poses[0], np.diag(FLOOR**2)
    if read.prior is not None:
        prior, prior_cov = np.array(read.prior[1][:3]), _covariance(read.prior[1][3:], 3, path, read.prior[0])
    return Graph(
        poses=poses, landmarks=points, steps=np.arange(len(poses)), ids=np.array(sorted(read.points), np.int64),
        prior=prior, prior_cov=prior_cov,
        edges=edges, delta=np.array([v[:3] for _, _, v in read.edges]).reshape(-1, 3),
        delta_cov=np.array([_covariance(v[3:], 3, path, n) for n, _, v in read.edges]).reshape(-1, 3, 3),
        sightings=sightings, z=np.array([v[:2] for _, _, v in read.sightings]).reshape(-1, 2),
        R=np.array([_covariance(v[2:], 2, path, n) for n, _, v in read.sightings]).reshape(-1, 2, 2),
    )  # fmt: skip


def _named(
    lines: list[tuple[int, list[int], list[float]]], first: dict[int, int], second: dict[int, int], path: object
) -> np.ndarray:
    """Places of both ends of each edge (E, 2)."""
    out = []
    for number, (a, b), _ in lines:
        for vertex, known in ((a, first), (b, second)):
            if vertex not in known:
                raise BrokenFile(path, f"an edge names vertex {vertex}, of the wrong kind or not there", number)
        out.append((first[a], second[b]))
    return np.array(out, np.int64).reshape(-1, 2)


def _covariance(upper: list[float], size: int, path: object, number: int) -> Array:
    half = np.zeros((size, size))
    half[np.triu_indices(size)] = upper
    information = half + np.triu(half, 1).T
    if np.linalg.eigvalsh(information)[0] <= 0.0:
        raise BrokenFile(path, "an information matrix is not positive definite", number)
    cov: Array = np.asarray(np.linalg.inv(information), float)
    return cov
