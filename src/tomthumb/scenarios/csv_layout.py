"""The CSV layout: odometry.csv and observations.csv, with truth.csv, landmarks.csv and scenario.toml as wanted.

docs/csv-layout.md describes it. Files may be .gz, .xz or .bz2 under the plain name plus suffix. Long logs are streamed.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.scenarios.jsonl import covariances
from tomthumb.scenarios.layout import CONTROL_COLUMNS, MOTIONS, OBSERVATION_COLUMNS, SENSORS, model_name, parse_header
from tomthumb.scenarios.params import unknown_key
from tomthumb.scenarios.reading import MAX_ROWS, floats, known, pose_at, read_text, unpacked
from tomthumb.scenarios.streaming import steps_of
from tomthumb.types import Array, Control, Ids, Observations, Scenario, Step, Truth

SUFFIXES = ("", ".gz", ".xz", ".bz2")
MAX_LINE = 1 << 16
MAX_TRUTH_GAP = 1.0  # s over which the true pose may be interpolated

Row = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the files of one log hold: models, columns, and whether an odometry row moves up to its time or from it."""

    folder: Path
    values: Mapping[str, Any]
    u: tuple[str, ...]
    z: tuple[str, str]
    forward: bool
    truth: Array | None


def load_csv(folder: Path) -> Scenario:
    """A scenario from a folder in the CSV layout; any of its files may be given instead of the folder.

    Raises BrokenFile naming file and line that are not what the layout says.
    """
    folder = Path(folder) if Path(folder).is_dir() else Path(folder).parent
    values, forward = _settings(folder)
    u = CONTROL_COLUMNS[model_name(values["motion"], MOTIONS)]
    z = OBSERVATION_COLUMNS[model_name(values["sensor"], SENSORS)]
    assert len(z) == 2
    layout = _Layout(folder, values, u, z, forward, _truth(folder))
    files = [file for name in ("odometry", "observations") if (file := _find(folder, name)) is not None]
    if not files:
        raise BrokenFile(folder, "holds neither odometry.csv nor observations.csv")
    steps = steps_of(partial(_steps, layout), *files)
    return Scenario(landmarks=_landmarks(folder), info={"file": str(folder)}, steps=steps, **values)


def _find(folder: Path, name: str) -> Path | None:
    return next((file for s in SUFFIXES if (file := folder / f"{name}.csv{s}").exists()), None)


def _settings(folder: Path) -> tuple[dict[str, Any], bool]:
    """The header's values and whether odometry rows hold forward in time."""
    file = folder / "scenario.toml"
    raw: dict[str, Any] = {}
    if file.exists():
        try:
            raw = tomllib.loads(read_text(file, 1 << 20))
        except (ValueError, RecursionError) as error:  # a TOMLDecodeError, or an integer of too many digits
            raise BrokenFile(file, f"not TOML: {error}") from None
    odometry = raw.get("odometry", {})
    if not isinstance(odometry, dict) or odometry.get("holds", "until") not in ("until", "from"):
        raise BrokenFile(file, 'odometry: holds = "until" or "from" is expected')
    try:
        values = parse_header({"name": folder.resolve().name, **raw}, str(file))
    except BrokenFile:
        raise
    except TomThumbError as error:
        raise BrokenFile(file, str(error).removeprefix(f"{file}: ")) from None
    return values, odometry.get("holds", "until") == "from"


def read_rows(file: Path, needed: tuple[str, ...], optional: tuple[str, ...]) -> Iterator[tuple[int, Row]]:
    """Line number and named values of each row; empty cells are NaN. Columns may stand in any order.

    Raises BrokenFile for columns that are missing, unknown or double, for rows of another width and for bad numbers.
    """
    with unpacked(file) as stream:
        names = [c.strip() for c in _decode(stream.readline(MAX_LINE), file, 1).split(",")]
        _check_columns(names, needed, optional, file)
        number = 1
        while line := stream.readline(MAX_LINE):
            number += 1
            text = _decode(line, file, number).strip()
            if not text or text.startswith("#"):
                continue
            cells = text.split(",")
            if len(cells) != len(names):
                raise BrokenFile(file, f"{len(cells)} columns where {len(names)} are expected", number)
            given = [(name, cell) for name, cell in zip(names, cells, strict=True) if cell.strip()]
            row = dict.fromkeys(names, math.nan)
            row.update(zip([n for n, _ in given], floats([c for _, c in given], file, number), strict=True))
            yield number, row


def _decode(line: bytes, file: Path, number: int) -> str:
    if len(line) >= MAX_LINE:
        raise BrokenFile(file, f"a line of more than {MAX_LINE >> 10} KiB", number)
    try:
        return line.decode("utf-8-sig" if number == 1 else "utf-8")
    except UnicodeDecodeError:
        raise BrokenFile(file, "not UTF-8 text", number) from None


def _check_columns(names: list[str], needed: tuple[str, ...], optional: tuple[str, ...], file: Path) -> None:
    for name in names:
        if name not in needed + optional:
            raise BrokenFile(file, unknown_key("header", name, needed + optional).replace("key", "column"), 1)
    for name in needed:
        if name not in names:
            raise BrokenFile(file, f"the column {name} is missing", 1)
    if len(set(names)) != len(names):
        raise BrokenFile(file, "a column stands twice", 1)


def triangle(k: int) -> tuple[str, ...]:
    """The columns of a symmetric k x k matrix: cov_11, cov_12, ..., cov_kk."""
    return tuple(f"cov_{i + 1}{j + 1}" for i in range(k) for j in range(i, k))


def _symmetric(row: Row, k: int, file: Path, number: int) -> Array | None:
    values = [row.get(name, math.nan) for name in triangle(k)]
    if all(map(math.isnan, values)):
        return None
    out = np.empty((k, k))
    out[np.triu_indices(k)] = values
    out = np.triu(out) + np.triu(out, 1).T
    if not np.isfinite(out).all():
        raise BrokenFile(file, "a covariance is not complete", number)
    try:
        return covariances(out, "cov")
    except TomThumbError as error:
        raise BrokenFile(file, str(error), number) from None


def _need(row: Row, names: tuple[str, ...], file: Path, number: int) -> Array:
    values = np.array([row[name] for name in names])
    if np.isnan(values).any():
        raise BrokenFile(file, f"{names[int(np.argmax(np.isnan(values)))]} is empty", number)
    return values


def _in_time(rows: Iterator[tuple[int, Row]], file: Path) -> Iterator[tuple[int, Row]]:
    before = -math.inf
    for number, row in rows:
        t = row["t_s"]
        if math.isnan(t) or t < before:
            raise BrokenFile(file, "t_s is empty" if math.isnan(t) else f"time runs back to {t:.9g}", number)
        before = t
        yield number, row


def _controls(layout: _Layout) -> Iterator[tuple[float, float, Array, Array | None]]:
    """Time, dt (NaN where not given), u and covariance of each odometry row."""
    file = _find(layout.folder, "odometry")
    if file is None:
        return
    k = len(layout.u)
    for number, row in _in_time(read_rows(file, ("t_s", *layout.u), ("dt_s", *triangle(k))), file):
        dt = row.get("dt_s", math.nan)
        if dt < 0:
            raise BrokenFile(file, "dt_s must not be negative", number)
        yield row["t_s"], dt, _need(row, layout.u, file, number), _symmetric(row, k, file, number)


def _scans(layout: _Layout) -> Iterator[tuple[float, Observations, Ids | None]]:
    file = _find(layout.folder, "observations")
    if file is None:
        return
    optional = (*triangle(2), "id", "label", "signature")
    rows = _in_time(read_rows(file, ("t_s", *layout.z), optional), file)
    for t, group in groupby(rows, key=lambda item: item[1]["t_s"]):
        yield t, *_scan(layout, [(n, row) for n, row in group if not _blank(row)], file)


def _blank(row: Row) -> bool:
    """A row with nothing but its time stands for a scan that saw nothing."""
    return all(math.isnan(value) for name, value in row.items() if name != "t_s")


def _scan(layout: _Layout, rows: list[tuple[int, Row]], file: Path) -> tuple[Observations, Ids | None]:
    z = np.array([[row[name] for name in layout.z] for _, row in rows]).reshape(-1, 2)
    if np.isnan(z).any():
        number, row = rows[int(np.argmax(np.isnan(z).any(1)))]
        _need(row, layout.z, file, number)
    names = rows[0][1] if rows else {}
    R = layout.values["sensor"].noise(z)
    if any(name in names for name in triangle(2)):
        R = _noise(rows, R, file)
    ids = _integers([r["id"] for _, r in rows], -2, file) if "id" in names else None
    labels = _integers([r["label"] for _, r in rows], -1, file) if "label" in names else None
    signature = np.array([r["signature"] for _, r in rows]) if "signature" in names else None
    return Observations(z, R, labels, signature), ids


def _noise(rows: list[tuple[int, Row]], default: Array, file: Path) -> Array:
    """R (m, 2, 2) of a scan, `default` where the columns are empty; all rows at once, since most are right."""
    v = np.array([[row.get(name, math.nan) for name in triangle(2)] for _, row in rows])
    blank = np.isnan(v).all(1)
    with np.errstate(invalid="ignore", over="ignore"):
        good = (v[:, 0] >= 0) & (v[:, 2] >= 0) & (v[:, 0] * v[:, 2] - v[:, 1] ** 2 >= -1e-12 * v[:, 0] * v[:, 2])
    for k in np.flatnonzero(~blank & ~good):
        _symmetric(rows[k][1], 2, file, rows[k][0])
    R = np.stack([v[:, :2], v[:, 1:]], axis=1)
    return np.where(blank[:, None, None], default, R)


def _integers(values: list[float], blank: int, file: Path) -> Ids:
    filled = np.array([blank if math.isnan(v) else v for v in values])
    if (filled != np.rint(filled)).any() or (np.abs(filled) > 2**53).any():
        raise BrokenFile(file, "an id or label is not a whole number")
    return filled.astype(np.int64)


def _steps(layout: _Layout) -> Iterator[Step]:
    """Odometry and scans in order of time. A scan between two rows gets its share of the motion if u is a rate."""
    merge = _from_on if layout.forward else _up_to
    for t, control, scan, ids in merge(layout):
        pose = None if layout.truth is None else _pose(layout.truth, t)
        truth = None if pose is None and ids is None else Truth(pose, ids)
        yield Step(t, control, scan, truth)


Event = tuple[float, Control | None, Observations | None, Ids | None]


def _up_to(layout: _Layout) -> Iterator[Event]:
    """Events where an odometry row tells of the time that ends with it."""
    scans = _scans(layout)
    scan = next(scans, None)
    last: float | None = None
    rates = layout.values["motion"].rates
    for t, dt, u, cov in _controls(layout):
        start = t - dt if not math.isnan(dt) else last
        while scan is not None and scan[0] < t:
            inside = rates and start is not None and scan[0] > start
            control = Control(u, scan[0] - start, cov) if inside and start is not None else None
            start = scan[0] if inside else start
            yield scan[0], control, scan[1], scan[2]
            scan = next(scans, None)
        control = None if start is None or t < start else Control(u, t - start, cov)
        if scan is not None and scan[0] == t:
            yield t, control, scan[1], scan[2]
            scan = next(scans, None)
        else:
            yield t, control, None, None
        last = t
    while scan is not None:
        yield scan[0], None, scan[1], scan[2]
        scan = next(scans, None)


def _from_on(layout: _Layout) -> Iterator[Event]:
    """Events where an odometry row is in force from its time until the next one's."""
    held: tuple[Array, Array | None] | None = None
    last = math.nan
    for t, u, cov, scan, ids in _merged(layout):
        control = None if held is None or math.isnan(last) else Control(held[0], t - last, held[1])
        yield t, control, scan, ids
        last = t
        held = held if u is None else (u, cov)


def _merged(
    layout: _Layout,
) -> Iterator[tuple[float, Array | None, Array | None, Observations | None, Ids | None]]:
    controls, scans = _controls(layout), _scans(layout)
    control, scan = next(controls, None), next(scans, None)
    while control is not None or scan is not None:
        t = min(item[0] for item in (control, scan) if item is not None)
        mine = control if control is not None and control[0] == t else None
        seen = scan if scan is not None and scan[0] == t else None
        yield t, *((mine[2], mine[3]) if mine else (None, None)), *((seen[1], seen[2]) if seen else (None, None))
        control = next(controls, None) if mine else control
        scan = next(scans, None) if seen else scan


def _pose(truth: Array, t: float) -> Array | None:
    k = int(np.searchsorted(truth[:, 0], t))
    if k < len(truth) and truth[k, 0] == t:
        return known(truth[k, 1:])
    return known(pose_at(np.array([t]), truth[:, 0], truth[:, 1:], MAX_TRUTH_GAP)[0])


def _columns(folder: Path, name: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> Array | None:
    file = _find(folder, name)
    if file is None:
        return None
    out = []
    for number, row in read_rows(file, needed, optional):
        out.append(_need(row, needed, file, number))
        if number > MAX_ROWS:
            raise BrokenFile(file, f"more than {MAX_ROWS} lines", number)
    return np.array(out).reshape(-1, len(needed))


def _truth(folder: Path) -> Array | None:
    rows = _columns(folder, "truth", ("t_s", "x_m", "y_m", "heading_rad"))
    if rows is None or not len(rows):
        return None
    if (np.diff(rows[:, 0]) < 0).any():
        raise BrokenFile(_find(folder, "truth"), "time runs back")
    return rows


def _landmarks(folder: Path) -> Array | None:
    rows = _columns(folder, "landmarks", ("id", "x_m", "y_m"), ("label",))
    if rows is None:
        return None
    file = _find(folder, "landmarks")
    if (rows[:, 0] != np.rint(rows[:, 0])).any() or (rows[:, 0] < 0).any() or (rows[:, 0] > MAX_ROWS).any():
        raise BrokenFile(file, f"an id is not a whole number from 0 to {MAX_ROWS}")
    out = np.full((int(rows[:, 0].max(initial=-1)) + 1, 2), np.nan)
    out[rows[:, 0].astype(int)] = rows[:, 1:]
    return out
