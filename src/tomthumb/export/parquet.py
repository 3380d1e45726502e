"""The tables of a run as Parquet (extra: parquet)."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from tomthumb.export.tables import tables
from tomthumb.types import Scenario, Trace


def save_parquet(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """trajectory.parquet, map.parquet and observations.parquet in the folder `path`; NaN becomes null."""
    path.mkdir(parents=True, exist_ok=True)
    for name, table in tables(trace, scenario).items():
        columns = {key: pa.array(values, from_pandas=True) for key, values in table.items()}
        pq.write_table(pa.table(columns), path / f"{name}.parquet")
