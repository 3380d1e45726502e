"""Trajectories and maps as text: TUM, KITTI, CSV, JSON."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.export.tables import Table, tables
from tomthumb.types import Array, Scenario, Trace


def save_tum(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """One line a step: t x y z qx qy qz qw (s, m, unit quaternion), as the tools of the TUM RGB-D benchmark read it."""
    half = trace.pose[:, 2] / 2
    zero = np.zeros(len(half))
    xy = trace.pose[:, :2]
    np.savetxt(path, np.column_stack([trace.t, xy, zero, zero, zero, np.sin(half), np.cos(half)]), fmt="%.9g")


def save_kitti(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """One line a step: the first three rows of the 4 x 4 pose matrix, row by row; there are no times."""
    np.savetxt(path, matrices(trace.pose).reshape(-1, 12), fmt="%.9g")


def matrices(pose: Array) -> Array:
    """Poses (K, 3) as the upper 3 x 4 of their matrices in space, z = 0."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    out = np.zeros((len(pose), 3, 4))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 3] = c, -s, pose[:, 0]
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 3] = s, c, pose[:, 1]
    out[:, 2, 2] = 1.0
    return out


def save_csv(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """The tables trajectory.csv, map.csv and observations.csv in the folder `path`; unknown values are empty."""
    path.mkdir(parents=True, exist_ok=True)
    for name, table in tables(trace, scenario).items():
        _write(path / f"{name}.csv", table)


def _write(path: Path, table: Table) -> None:
    columns = [_plain(np.asarray(values)) for values in table.values()]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(zip(*columns, strict=True))


def _plain(values: Any) -> list[Any]:
    """A column as Python values, None where it is not finite; booleans as 0 and 1."""
    if values.dtype == bool:
        return values.astype(int).tolist()  # type: ignore[no-any-return]
    if values.dtype.kind == "f":
        return [v if np.isfinite(v) else None for v in values.tolist()]
    return values.tolist()  # type: ignore[no-any-return]


def save_json(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """One object: scenario, failure, and the three tables as columns; null where a value is not known."""
    columns = {name: {k: _plain(np.asarray(v)) for k, v in t.items()} for name, t in tables(trace, scenario).items()}
    out = {"scenario": trace.scenario, "failure": trace.failure, **columns}
    path.write_text(json.dumps(out, allow_nan=False) + "\n", encoding="utf-8")
