"""Rows as files: CSV and Parquet out, CSV, Parquet and journals in."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tomthumb.bench.journal import reading
from tomthumb.bench.measures import MEASURES, is_time_or_place
from tomthumb.errors import BrokenFile, TomThumbError

Rows = list[dict[str, Any]]
FIRST = ("scenario", "method", "estimator", "associator", "slam", "seed", "status", "reason")
NEEDED = ("case", "seed", "status", "method", "scenario")


def read_rows(path: Path) -> Rows:
    """Rows of a CSV, a Parquet file, a journal, or the folder of a grid. Raises BrokenFile, TomThumbError."""
    if path.is_dir():
        path = path / "journal.sqlite"
    if not path.is_file():
        raise TomThumbError(f"{path}: no such file")
    readers = {".csv": _read_csv, ".parquet": _read_parquet, ".sqlite": _read_journal}
    if path.suffix not in readers:
        raise TomThumbError(f"{path}: rows are read from {', '.join(readers)}")
    rows = readers[path.suffix](path)
    missing = [column for column in NEEDED if rows and column not in rows[0]]
    if missing:
        raise BrokenFile(path, f"has no column {', '.join(missing)}: not rows of tomthumb bench")
    return rows


def write_rows(path: Path, rows: Rows) -> None:
    """Write a CSV or Parquet file, by its ending, at once or not at all. Raises TomThumbError."""
    writers = {".csv": _write_csv, ".parquet": _write_parquet}
    if path.suffix not in writers:
        raise TomThumbError(f"{path}: rows are written as {' or '.join(writers)}")
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writers[path.suffix](part, rows)
        part.replace(path)
    except OSError as reason:
        raise TomThumbError(f"{path}: cannot be written: {reason.strerror or reason}") from None


def columns(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Every column of any row: labels first, then in the order they occur."""
    seen = dict.fromkeys(FIRST)
    for row in rows:
        seen.update(dict.fromkeys(row))
    return list(seen)


def lasting(rows: Sequence[Mapping[str, Any]]) -> Rows:
    """The rows without the columns that tell of time and place only: equal for two runs of one grid, wherever run."""
    return [{key: value for key, value in row.items() if not is_time_or_place(key)} for row in rows]


def kept(rows: Sequence[Mapping[str, Any]]) -> Rows:
    """What a later comparison needs and nothing of the machine: labels, configuration, seed, status and measures."""
    wanted = [key for key in (*FIRST, "case", "failure", *MEASURES) if not is_time_or_place(key)]
    return [{key: row[key] for key in wanted if key in row} for row in rows]


def _write_csv(path: Path, rows: Rows) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns(rows), restval=None, lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _text(value) for key, value in row.items()} for row in rows)


def _text(value: Any) -> Any:
    if isinstance(value, (bool, list, dict)):
        return json.dumps(value)
    return value


def _read_csv(path: Path) -> Rows:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [{key: _value(key, text) for key, text in row.items() if key} for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as reason:
        raise BrokenFile(path, f"cannot be read as CSV: {reason}") from None


def _value(key: str, text: str | None) -> Any:
    """What was written: empty is None; the measures and the seed are numbers."""
    if text is None or text == "":
        return None
    if key == "seed":
        return int(text)
    if key in MEASURES or key == "seconds" or "." in key:
        try:
            number = float(text)
        except ValueError:
            return text
        return int(number) if number.is_integer() and "." not in text and "e" not in text else number
    return text


def _write_parquet(path: Path, rows: Rows) -> None:
    pyarrow, parquet = _pyarrow()
    names = columns(rows)
    table = {name: _one_type([row.get(name) for row in rows]) for name in names}
    parquet.write_table(pyarrow.table(table), path)


def _one_type(values: list[Any]) -> list[Any]:
    """A column of numbers, of truth values, or of texts: where they are mixed, texts."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int} or kinds <= {float} or kinds <= {bool} or kinds <= {str}:
        return values
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else str(value) for value in values]


def _read_parquet(path: Path) -> Rows:
    _, parquet = _pyarrow()
    try:
        found: Rows = parquet.read_table(path).to_pylist()
    except (OSError, ValueError) as reason:
        raise BrokenFile(path, f"cannot be read as Parquet: {reason}") from None
    return found


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise TomThumbError("Parquet needs pyarrow: pip install 'tomthumb[parquet]', or use CSV") from None
    return pyarrow, pyarrow.parquet


def _read_journal(path: Path) -> Rows:
    with reading(path) as journal:
        return list(journal.rows())
