"""The JSONL layout: a header line, then one line a step. It loses nothing, so it is also how scenarios are saved."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.scenarios.layout import array, header, parse_header
from tomthumb.scenarios.params import unknown_key
from tomthumb.scenarios.reading import unpacked
from tomthumb.scenarios.streaming import steps_of
from tomthumb.types import Array, Control, Ids, Observations, Scenario, Step, Truth

MAX_LINE = 16 << 20  # bytes
STEP_KEYS = ("t", "control", "observations", "truth")


def load_jsonl(path: Path) -> Scenario:
    """A scenario from a .jsonl file (plain, .gz, .xz or .bz2). Long files are streamed, not kept.

    Raises BrokenFile naming the line that is not what the layout says (docs/csv-layout.md).
    """
    path = Path(path)
    with unpacked(path) as stream:
        first = _line(stream.readline(MAX_LINE + 1), path, 1)
    landmarks = None
    try:
        if isinstance(first, dict):
            landmarks = _landmarks(first.pop("landmarks", None))
        values = parse_header(first, "header")
    except TomThumbError as error:
        raise BrokenFile(path, str(error), 1) from None
    width = 2 if values["motion"].rates else 3
    read = partial(_steps, path, width)
    return Scenario(landmarks=landmarks, info={"file": str(path)}, steps=steps_of(read, path), **values)


def save_jsonl(scenario: Scenario, path: Path) -> None:
    """Write a scenario so that `load_jsonl` gives it back: models, prior, scoring, steps with truth, landmarks.

    `info` is not saved. Raises TomThumbError for models that the layout does not know.
    """
    first = header(scenario)
    first["landmarks"] = None if scenario.landmarks is None else [_or_none(p) for p in scenario.landmarks]
    with open(path, "w", encoding="utf-8") as file:
        file.write(json.dumps(first, allow_nan=False) + "\n")
        for step in scenario.steps:
            file.write(json.dumps(_plain(step), allow_nan=False) + "\n")


def _steps(path: Path, width: int) -> Iterator[Step]:
    before = -np.inf
    with unpacked(path) as stream:
        stream.readline(MAX_LINE + 1)
        for number, line in enumerate(_lines(stream), 2):
            if not line.strip():
                continue
            try:
                step = _step(_line(line, path, number), width)
            except TomThumbError as error:
                raise error if isinstance(error, BrokenFile) else BrokenFile(path, str(error), number) from None
            if step.t < before:
                raise BrokenFile(path, f"time runs back from {before:.6g} to {step.t:.6g}", number)
            before = step.t
            yield step


def _lines(stream: IO[bytes]) -> Iterator[bytes]:
    while line := stream.readline(MAX_LINE + 1):
        yield line


def _line(line: bytes, path: Path, number: int) -> Any:
    if len(line) > MAX_LINE:
        raise BrokenFile(path, f"a line of more than {MAX_LINE >> 20} MiB", number)
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise BrokenFile(path, f"not JSON: {error}", number) from None


def _step(raw: Any, width: int) -> Step:
    if not isinstance(raw, dict):
        raise TomThumbError("a step must be an object")
    for key in raw:
        if key not in STEP_KEYS:
            raise TomThumbError(unknown_key("step", key, STEP_KEYS))
    scan = _observations(raw.get("observations"))
    return Step(_number(raw.get("t"), "t"), _control(raw.get("control"), width), scan, _truth(raw.get("truth"), scan))


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TomThumbError(f"{where}: a number is expected")
    return float(array([value], (1,), where)[0])


def _control(raw: Any, width: int) -> Control | None:
    if raw is None:
        return None
    if not isinstance(raw, dict):
        raise TomThumbError("control: an object is expected")
    dt = _number(raw.get("dt"), "control: dt")
    if dt < 0:
        raise TomThumbError("control: dt must not be negative")
    u = array(raw.get("u"), (width,), "control: u")
    if raw.get("cov") is None:
        return Control(u, dt)
    return Control(u, dt, covariances(array(raw["cov"], (width, width), "control: cov"), "control: cov"))


def _observations(raw: Any) -> Observations | None:
    if raw is None:
        return None
    if not isinstance(raw, dict):
        raise TomThumbError("observations: an object is expected")
    z = array(raw.get("z"), (None, 2), "observations: z")
    R = array(raw.get("R"), (len(z), 2, 2), "observations: R") if len(z) else np.empty((0, 2, 2))
    signature = raw.get("signature")
    if signature is not None:
        if not isinstance(signature, list):
            raise TomThumbError("observations: signature: a list is expected")
        blank = np.array([value is None for value in signature], bool)
        signature = array([0.0 if v is None else v for v in signature], (len(z),), "observations: signature")
        signature[blank] = np.nan
    labels = _ids(raw.get("labels"), len(z), "observations: labels")
    return Observations(z, covariances(R, "observations: R"), labels, signature)


def covariances(R: Array, where: str) -> Array:
    """Covariances (..., k, k) that must be symmetric and positive definite; raises TomThumbError where one is not."""
    if R.size and (not np.allclose(R, np.swapaxes(R, -1, -2)) or np.linalg.eigvalsh(R).min() < -1e-12):
        raise TomThumbError(f"{where}: not a covariance")
    return R


def _ids(raw: Any, m: int, where: str) -> Ids | None:
    if raw is None:
        return None
    values = array(raw, (None,), where)
    if len(values) != m or (values != np.rint(values)).any() or (np.abs(values) > 2**53).any():
        raise TomThumbError(f"{where}: {m} whole numbers are expected")
    return values.astype(np.int64)


def _truth(raw: Any, scan: Observations | None) -> Truth | None:
    if raw is None:
        return None
    if not isinstance(raw, dict):
        raise TomThumbError("truth: an object is expected")
    pose = None if raw.get("pose") is None else array(raw["pose"], (3,), "truth: pose")
    return Truth(pose, _ids(raw.get("ids"), 0 if scan is None else len(scan), "truth: ids"))


def _landmarks(raw: Any) -> Array | None:
    if raw is None:
        return None
    if not isinstance(raw, list):
        raise TomThumbError("header: landmarks: a list is expected")
    out = np.full((len(raw), 2), np.nan)
    for k, row in enumerate(raw):
        if row is not None:
            out[k] = array(row, (2,), f"header: landmarks: row {k}")
    return out


def _or_none(point: Array) -> list[float] | None:
    return [float(v) for v in point] if np.isfinite(point).all() else None


def _plain(step: Step) -> dict[str, Any]:
    out: dict[str, Any] = {"t": step.t}
    if step.control is not None:
        c = step.control
        out["control"] = {"u": c.u.tolist(), "dt": c.dt, "cov": None if c.cov is None else c.cov.tolist()}
    if step.observations is not None:
        out["observations"] = _plain_scan(step.observations)
    if step.truth is not None:
        pose, ids = step.truth.pose, step.truth.ids
        out["truth"] = {"pose": None if pose is None else pose.tolist(), "ids": None if ids is None else ids.tolist()}
    return out


def _plain_scan(scan: Observations) -> dict[str, Any]:
    out: dict[str, Any] = {"z": scan.z.tolist(), "R": scan.R.tolist()}
    if scan.labels is not None:
        out["labels"] = scan.labels.tolist()
    if scan.signature is not None:
        out["signature"] = [None if np.isnan(v) else float(v) for v in scan.signature]
    return out
