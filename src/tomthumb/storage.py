"""Runs kept on disk: trajectory as TUM, map as CSV, trace with its truth as npz (never pickled), and read again."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.metrics.truth import TruthTable
from tomthumb.scenarios.reading import BROKEN, BROKEN_ZIP
from tomthumb.types import Array, Estimate, Lessons, Trace

FORMAT = 1
MOST_ID = 2**53  # beyond it ids are no longer exact as floats
MAP_COLUMNS = ("id", "x_m", "y_m", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2", "stone")
ARRAYS = ("t", "pose", "pose_cov", "offsets", "ids", "paired", "with_stone", "seconds", "nis", "dof", "died", "merged")
MAYBE = ("final_ids", "final_pose")
LESSONS = ("ids", "sightings", "together", "lately", "total")
FINAL = ("pose", "pose_cov", "ids", "landmarks", "covs", "stone")


@dataclass(frozen=True)
class SavedRun:
    """A trace with the truth it is judged by, and what it was run with (scenario, associator, seed, settings)."""

    trace: Trace
    truth: TruthTable
    about: Mapping[str, Any] = field(default_factory=dict)


def save_run(folder: Path, run: SavedRun) -> list[Path]:
    """Write trajectory.tum, map.csv and trace.npz into `folder`, which is made if need be. Raises TomThumbError."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "trajectory.tum", folder / "map.csv", folder / "trace.npz"]
    save_trajectory(paths[0], run.trace.t, run.trace.pose)
    save_map(paths[1], run.trace.final, run.trace.lessons)
    save_trace(paths[2], run)
    return paths


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Whatever the system says when writing fails, as one line."""
    try:
        yield
    except OSError as reason:
        raise TomThumbError(f"{path}: cannot be written: {reason.strerror or reason}") from None


def save_trajectory(path: Path, t: Array, pose: Array) -> None:
    """TUM format, a line a step: t s, x y z m, quaternion qx qy qz qw."""
    half = 0.5 * pose[:, 2]
    zero = np.zeros(len(t))
    table = np.column_stack([t, pose[:, :2], zero, zero, zero, np.sin(half), np.cos(half)])
    with writing(path):
        np.savetxt(path, table, fmt="%.9g", header="t_s x_m y_m z_m qx qy qz qw")


def save_map(path: Path, estimate: Estimate, lessons: Lessons | None = None) -> None:
    """One row a landmark: id, position, covariance, and 1 for a stone (confirmed) or 0 for a crumb.

    What was learned about them goes into a file beside it, map.memory.npz for map.csv; one that is there from an earlier
    map, and would not fit this one, is removed.
    """
    with writing(path):
        _beside(path).unlink(missing_ok=True)  # first: whenever this is killed, no memory lies beside a foreign map
    covs = estimate.covs
    numbers = np.column_stack([estimate.landmarks, covs[:, 0, 0], covs[:, 0, 1], covs[:, 1, 1]])
    part = path.with_name(path.name + ".part")
    with writing(path):
        with part.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(MAP_COLUMNS)
            for i, values, stone in zip(estimate.ids, numbers, estimate.stone, strict=True):
                rows.writerow([int(i), *(f"{v:.12g}" for v in values), int(stone)])
        part.replace(path)  # whole or not at all: a shorter map would not show that it was cut
    if lessons is not None:
        _save_lessons(_beside(path), lessons)


def load_map(path: Path) -> Estimate:
    """A map to start in, from map.csv, trace.npz or a folder that holds them. Raises BrokenFile.

    The correlations between landmarks are not kept in a CSV; the pose of the estimate is that of the end of the run, or
    the origin, with no certainty, where the file does not tell.
    """
    if path.is_dir():
        path = path / "trace.npz" if (path / "trace.npz").is_file() else path / "map.csv"
    return load_run(path).trace.final if path.suffix == ".npz" else _map_from_csv(path)


def load_lessons(path: Path) -> Lessons | None:
    """What was learned about the landmarks of the map at `path` (as for `load_map`), or None. Raises BrokenFile."""
    file = _beside(path / "map.csv" if path.is_dir() else path)
    if not file.is_file():
        return None
    with reading(file, "a memory"), file.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
        if not _is_memory(*(stored[name] for name in LESSONS)):
            raise BrokenFile(file, "is not a memory: shares between 0 and 1 of as many landmarks as it names")
        ids, sightings, together, lately, total = (stored[name] for name in LESSONS)
        return Lessons(ids.astype(np.int64), sightings.astype(np.int64), together, lately, int(total))


def _is_memory(ids: Any, sightings: Any, together: Any, lately: Any, total: Any) -> bool:
    """Whether arrays of a file can be `Lessons`."""
    if ids.ndim != 1 or len(np.unique(ids)) < len(ids):
        return False
    k = len(ids)
    fits = sightings.shape == lately.shape == (k,) and together.shape == (k, k) and total.shape == ()
    counts = all(n.dtype.kind == "i" and (n >= 0).all() for n in (ids, sightings, total))
    shares = all(p.dtype == np.float64 and ((p > 0) & (p < 1)).all() for p in (together, lately))
    return fits and counts and shares


def _beside(path: Path) -> Path:
    """Where the memory of a map lies."""
    return path.with_name("map.memory.npz") if path.suffix == ".npz" else path.with_suffix(".memory.npz")


def _save_lessons(path: Path, lessons: Lessons) -> None:
    arrays: dict[str, Any] = {name: np.asarray(getattr(lessons, name)) for name in LESSONS}
    with writing(path), path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _map_from_csv(path: Path) -> Estimate:
    with reading(path, "a map"), path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows or tuple(rows[0]) != MAP_COLUMNS:
        raise BrokenFile(path, f"a map starts with the columns {','.join(MAP_COLUMNS)}", 1)
    values = np.array([_map_row(path, k, row) for k, row in enumerate(rows[1:], 2)]).reshape(-1, len(MAP_COLUMNS))
    ids = values[:, 0].astype(np.int64)
    if len(np.unique(ids)) < len(ids):
        raise BrokenFile(path, "the same id stands twice")
    covs = values[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    return Estimate(np.zeros(3), np.full((3, 3), np.inf), ids, values[:, 1:3], covs, values[:, 6] > 0)


def _map_row(path: Path, line: int, row: Sequence[str]) -> list[float]:
    if len(row) != len(MAP_COLUMNS):
        raise BrokenFile(path, f"{len(row)} columns, {len(MAP_COLUMNS)} are needed", line)
    try:
        values = [float(int(row[0])), *map(float, row[1:])]
    except (ValueError, OverflowError):
        raise BrokenFile(path, f"not a number among {','.join(row)[:200]!r}", line) from None
    if not np.isfinite(values).all() or abs(values[0]) > MOST_ID:
        raise BrokenFile(path, "a value is not finite, or an id beyond 2^53", line)
    xx, xy, yy = values[3:6]
    if xx <= 0.0 or xx * yy - xy * xy <= 0.0:
        raise BrokenFile(path, "the covariance is not positive definite", line)
    return values


def save_trace(path: Path, run: SavedRun) -> None:
    """The whole run as one npz of plain arrays, with a JSON text beside them for names and settings."""
    trace, truth = run.trace, run.truth
    arrays: dict[str, Any] = {name: getattr(trace, name) for name in ARRAYS}
    arrays |= {name: getattr(trace, name) for name in MAYBE if getattr(trace, name) is not None}
    arrays |= {f"final.{name}": getattr(trace.final, name) for name in FINAL}
    arrays |= {"truth.pose": truth.pose, "truth.ids": truth.ids}
    if truth.landmarks is not None:
        arrays["truth.landmarks"] = truth.landmarks
    about = {
        "format": FORMAT,
        "scenario": trace.scenario,
        "failure": trace.failure,
        "settings": trace.settings,
        "stats": trace.stats,
        "score_from": truth.score_from,
        "about": run.about,
    }
    text = json.dumps(about, default=_as_text)
    with writing(path), path.open("wb") as file:
        np.savez_compressed(file, about=np.frombuffer(text.encode(), np.uint8), **arrays)


def _as_text(value: Any) -> Any:
    """What JSON has no form for: mappings and arrays plainly, everything else by its text."""
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)


def load_run(path: Path) -> SavedRun:
    """A run saved before; `path` is trace.npz or the folder that holds it. Raises BrokenFile."""
    path = path / "trace.npz" if path.is_dir() else path
    with reading(path, "a trace"), path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
        about = json.loads(arrays["about"].tobytes().decode())
        if about["format"] != FORMAT:
            raise BrokenFile(path, f"format {about['format']}, this version reads {FORMAT}")
        return _restore(arrays, about)


def _restore(arrays: Mapping[str, Array], about: Mapping[str, Any]) -> SavedRun:
    trace = Trace(
        scenario=about["scenario"],
        failure=about["failure"],
        settings=about["settings"],
        stats=about["stats"],
        final=Estimate(*(arrays[f"final.{name}"] for name in FINAL)),  # type: ignore[arg-type]
        **{name: arrays[name] for name in _present(arrays, ARRAYS, MAYBE)},  # type: ignore[arg-type]
    )
    ids: Any = arrays["truth.ids"]
    truth = TruthTable(arrays["truth.pose"], ids, arrays.get("truth.landmarks"), about["score_from"])
    return SavedRun(trace, truth, about["about"])


def _present(arrays: Mapping[str, Array], needed: Iterable[str], optional: Iterable[str]) -> list[str]:
    return [*needed, *(name for name in optional if name in arrays)]


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Whatever goes wrong inside a file that was cut or is something else, as one line naming it."""
    try:
        yield
    except (BrokenFile, MemoryError):
        raise
    except OSError as reason:
        raise BrokenFile(path, f"cannot be read as {what}: {reason.strerror or reason}") from None
    except (ValueError, KeyError, TypeError, *BROKEN, *BROKEN_ZIP) as reason:
        raise BrokenFile(path, f"is not {what}, or is damaged ({type(reason).__name__}: {reason})") from None
