"""A scenario written in the CSV layout (docs/csv-layout.md)."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.scenarios.csv_layout import triangle
from tomthumb.scenarios.layout import CONTROL_COLUMNS, MOTIONS, OBSERVATION_COLUMNS, SENSORS, header, model_name
from tomthumb.types import Array, Control, Observations, Scenario, Step


def save_csv(scenario: Scenario, folder: Path) -> None:
    """Write a scenario so that `load_csv` gives it back, the folder being made where it does not exist.

    Every step must have a control or a scan, and its own time, or the files cannot tell it from its neighbour (the
    JSONL layout has no such limits). Raises TomThumbError for models that the layout does not know.
    """
    folder = Path(folder)
    head = header(scenario)
    u = CONTROL_COLUMNS[model_name(scenario.motion, MOTIONS)]
    z = OBSERVATION_COLUMNS[model_name(scenario.sensor, SENSORS)]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scenario.toml").write_text(toml(head), encoding="utf-8")
    with (
        open(folder / "odometry.csv", "w", newline="", encoding="utf-8") as odometry,
        open(folder / "observations.csv", "w", newline="", encoding="utf-8") as observations,
        open(folder / "truth.csv", "w", newline="", encoding="utf-8") as truth,
    ):
        writers = [csv.writer(file, lineterminator="\n") for file in (odometry, observations, truth)]
        writers[0].writerow(["t_s", "dt_s", *u, *triangle(len(u))])
        writers[1].writerow(["t_s", *z, *triangle(2), "id", "label", "signature"])
        writers[2].writerow(["t_s", "x_m", "y_m", "heading_rad"])
        for step in scenario.steps:
            _write(step, writers)
    if scenario.landmarks is not None:
        _landmarks(scenario.landmarks, folder / "landmarks.csv")


def _write(step: Step, writers: list[Any]) -> None:
    if step.control is not None:
        writers[0].writerow([step.t, *_control(step.control)])
    if step.observations is not None:
        ids = None if step.truth is None else step.truth.ids
        writers[1].writerows([step.t, *row] for row in _scan(step.observations, ids))
    if step.truth is not None and step.truth.pose is not None:
        writers[2].writerow([step.t, *step.truth.pose.tolist()])


def _control(control: Control) -> list[Any]:
    k = len(control.u)
    cov = [""] * (k * (k + 1) // 2) if control.cov is None else _upper(control.cov)
    return [control.dt, *control.u.tolist(), *cov]


def _scan(scan: Observations, ids: Any) -> Iterable[list[Any]]:
    if not len(scan):
        return [[""] * 8]
    return [
        [
            *scan.z[i].tolist(),
            *_upper(scan.R[i]),
            "" if ids is None else int(ids[i]),
            "" if scan.labels is None else int(scan.labels[i]),
            "" if scan.signature is None or math.isnan(scan.signature[i]) else float(scan.signature[i]),
        ]
        for i in range(len(scan))
    ]


def _upper(matrix: Array) -> list[Any]:
    return [float(v) for v in matrix[np.triu_indices(len(matrix))]]


def _landmarks(landmarks: Array, file: Path) -> None:
    rows = [f"{k},{x!r},{y!r}" for k, (x, y) in enumerate(landmarks.tolist()) if math.isfinite(x) and math.isfinite(y)]
    file.write_text("\n".join(["id,x_m,y_m", *rows]) + "\n", encoding="utf-8")


def toml(data: Mapping[str, Any]) -> str:
    """A mapping of scalars, lists and one level of tables as TOML."""
    plain = [f"{key} = {json.dumps(v)}" for key, v in data.items() if not isinstance(v, Mapping)]
    for key, section in data.items():
        if isinstance(section, Mapping):
            plain += ["", f"[{key}]", *(f"{k} = {json.dumps(v)}" for k, v in section.items())]
    return "\n".join(plain) + "\n"
