"""Our own layout's header: models, prior and scoring as plain data, in scenario.toml or in the .jsonl's first line."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.models.motion import Ackermann, OdometryIncrement, Velocity
from tomthumb.models.sensor import Cartesian, RangeBearing
from tomthumb.scenarios.params import convert, unknown_key
from tomthumb.scenarios.reading import MAX_NUMBER, sane
from tomthumb.types import Array, Prior, Scenario

MOTIONS: dict[str, Callable[..., Any]] = {
    "increment": OdometryIncrement,
    "velocity": Velocity,
    "ackermann": Ackermann,
}
SENSORS: dict[str, Callable[..., Any]] = {"range_bearing": RangeBearing, "cartesian": Cartesian}
CONTROL_COLUMNS = {
    "increment": ("dx_m", "dy_m", "dheading_rad"),
    "velocity": ("speed_m_s", "turn_rad_s"),
    "ackermann": ("speed_m_s", "steering_rad"),
}
OBSERVATION_COLUMNS = {"range_bearing": ("range_m", "bearing_rad"), "cartesian": ("x_m", "y_m")}
KEYS = ("name", "motion", "sensor", "prior", "scoring", "odometry", "format")
FIXED = {"motion": ("rates",), "sensor": ("angles",)}  # fields that follow from the model


def model_name(model: object, known: Mapping[str, Callable[..., Any]]) -> str:
    """The layout's word for a model. Raises TomThumbError for a model that the layout does not know."""
    for name, kind in known.items():
        if type(model) is kind:
            return name
    raise TomThumbError(f"the layout cannot hold a {type(model).__name__}: only {', '.join(known)}")


def header(scenario: Scenario) -> dict[str, Any]:
    """Everything of a scenario but its steps and landmarks, as plain data."""
    return {
        "format": 1,
        "name": scenario.name,
        "motion": _model(scenario.motion, MOTIONS, "motion"),
        "sensor": _model(scenario.sensor, SENSORS, "sensor"),
        "prior": {"pose": scenario.prior.pose.tolist(), "cov": scenario.prior.cov.tolist()},
        "scoring": {"score_from": scenario.score_from, "teach_steps": scenario.teach_steps},
    }


def parse_header(raw: Any, where: str) -> dict[str, Any]:
    """The keyword arguments of a Scenario that a header holds (name, motion, sensor, prior, scoring).

    Raises TomThumbError naming the key that is missing, unknown or wrong.
    """
    if not isinstance(raw, dict):
        raise TomThumbError(f"{where}: a table of keys is expected")
    for key in raw:
        if key not in KEYS:
            raise TomThumbError(unknown_key(where, key, KEYS))
    if raw.get("format", 1) != 1:
        raise TomThumbError(f"{where}: format {raw['format']!r}; this version reads format 1")
    scoring = convert(_scoring, _section(raw, "scoring", where), f"{where}: scoring")
    return {
        "name": str(raw.get("name", "log")),
        "motion": _build(_section(raw, "motion", where), MOTIONS, "increment", f"{where}: motion"),
        "sensor": _build(_section(raw, "sensor", where), SENSORS, "range_bearing", f"{where}: sensor"),
        "prior": _prior(_section(raw, "prior", where), f"{where}: prior"),
        **_scoring(**scoring),
    }


def _scoring(score_from: int = 1, teach_steps: int = 0) -> dict[str, int]:
    if score_from < 0 or teach_steps < 0:
        raise TomThumbError("scoring: score_from and teach_steps must be 0 or more")
    return {"score_from": score_from, "teach_steps": teach_steps}


def _section(raw: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    section = raw.get(key, {})
    if not isinstance(section, dict):
        raise TomThumbError(f"{where}: {key} must be a table")
    return section


def _build(section: Mapping[str, Any], known: Mapping[str, Callable[..., Any]], default: str, where: str) -> Any:
    name = section.get("model", default)
    if not isinstance(name, str) or name not in known:
        raise TomThumbError(f"{where}: model {name!r}: one of {', '.join(known)}")
    given = {key: value for key, value in section.items() if key != "model"}
    values = convert(known[name], given, where, skip=("rates", "angles"))
    for key, value in values.items():
        _sound(key, value, where)
    return known[name](**values)


def _sound(key: str, value: Any, where: str) -> None:
    """Raise unless a model's value is possible: stds and ranges not negative, probabilities within 0 and 1."""
    items = value if isinstance(value, tuple) else (value,)
    numbers = [v for v in items if isinstance(v, int | float)]
    if key in ("std", "pose_std", "slip_std", "min_range", "clutter") and min(numbers) < 0:
        raise TomThumbError(f"{where}: {key} must not be negative")
    if key == "detect" and not 0 < numbers[0] <= 1:
        raise TomThumbError(f"{where}: detect must be above 0 and at most 1")
    if key in ("max_range", "fov", "wheel_base") and not numbers[0] > 0:
        raise TomThumbError(f"{where}: {key} must be above 0")
    if key != "max_range" and not all(abs(v) <= MAX_NUMBER for v in numbers):
        raise TomThumbError(f"{where}: {key} must be finite, and at most {MAX_NUMBER:g}")


def _model(model: object, known: Mapping[str, Callable[..., Any]], part: str) -> dict[str, Any]:
    name = model_name(model, known)
    values = {f.name: getattr(model, f.name) for f in dataclasses.fields(model)}  # type: ignore[arg-type]
    kept = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items() if k not in FIXED[part]}
    finite = {k: v for k, v in kept.items() if not (isinstance(v, float) and math.isinf(v))}  # infinite is the default
    return {"model": name, **finite}


def _prior(section: Mapping[str, Any], where: str) -> Prior:
    for key in section:
        if key not in ("pose", "cov", "std"):
            raise TomThumbError(unknown_key(where, key, ("pose", "cov", "std")))
    pose = array(section.get("pose", [0.0, 0.0, 0.0]), (3,), f"{where}: pose")
    if "std" in section:
        return Prior(pose, np.diag(array(section["std"], (3,), f"{where}: std") ** 2))
    cov = array(section.get("cov", np.zeros((3, 3)).tolist()), (3, 3), f"{where}: cov")
    if not np.allclose(cov, cov.T) or np.linalg.eigvalsh(cov).min() < -1e-9:
        raise TomThumbError(f"{where}: cov is not a covariance")
    return Prior(pose, cov)


def array(value: Any, shape: tuple[int | None, ...], where: str) -> Array:
    """A finite float array of a shape (None: any) out of nested lists. Raises TomThumbError otherwise."""
    try:
        out = np.asarray(value, float)
    except (ValueError, TypeError, OverflowError):
        raise TomThumbError(f"{where}: numbers in a shape of {_shape(shape)} are expected") from None
    if out.size == 0 and 0 not in out.shape[:1]:
        raise TomThumbError(f"{where}: numbers in a shape of {_shape(shape)} are expected")
    if out.size == 0 and shape[0] is None:
        return np.empty(tuple(k or 0 for k in shape))
    if out.ndim != len(shape) or any(k not in (None, n) for n, k in zip(out.shape, shape, strict=True)):
        raise TomThumbError(f"{where}: has shape {out.shape} where {_shape(shape)} is expected")
    if not sane(out).all():
        raise TomThumbError(f"{where}: holds values that are not finite, or beyond {MAX_NUMBER:g}")
    return out


def _shape(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("n" if k is None else str(k) for k in shape) + ")"
