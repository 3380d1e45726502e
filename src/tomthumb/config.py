"""Settings as text: ``--set key=value`` and TOML files become keyword arguments. No parameter is declared here."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tomthumb.errors import BrokenFile, TomThumbError, UnknownName

PARTS = ("scenario", "associator", "estimator", "slam")
Settings = dict[str, dict[str, Any]]


def parse_sets(sets: Iterable[str]) -> Settings:
    """``key=value`` texts split by part: bare keys are the scenario's, ``associator.key`` and so on the others'.

    Values are TOML scalars or lists, and words where they are not. A key ending in ``_deg`` loses the ending and
    becomes radians. A bare ``faithful`` goes to every part. Raises TomThumbError for a text without ``=`` and for a
    part that does not exist.
    """
    settings = empty()
    for text in sets:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise TomThumbError(f"--set {text!r}: write key=value, as in --set laps=2 or --set associator.gate=0.999")
        _put(settings, key.strip(), parse_value(value.strip()))
    return settings


def empty() -> Settings:
    """No settings for any part."""
    return {part: {} for part in PARTS}


def parse_value(text: str) -> Any:
    """A TOML scalar or list; anything else is taken as a word."""
    if "\n" in text or "\r" in text:
        return text
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, (bool, int, float, str, list)) else text


def read_file(path: Path) -> Settings:
    """Settings from TOML with tables [scenario], [associator], [estimator], [slam]. Raises BrokenFile, UnknownName."""
    try:
        tables = tomllib.loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as reason:
        raise BrokenFile(path, f"cannot be read as TOML: {reason}") from None
    return from_tables(tables)


def from_tables(tables: Mapping[str, Any]) -> Settings:
    """The same from tables already read; top-level keys that are no table are the scenario's."""
    settings = empty()
    for name, table in tables.items():
        if not isinstance(table, dict):
            _put(settings, name, table)
            continue
        if name not in PARTS:
            raise UnknownName("table of settings", name, PARTS)
        for key, value in table.items():
            _put(settings, f"{name}.{key}", value)
    return settings


def join(first: Settings, second: Settings) -> Settings:
    """Both; where they disagree the second counts."""
    return {part: {**first[part], **second[part]} for part in PARTS}


def _put(settings: Settings, key: str, value: Any) -> None:
    part, dot, name = key.rpartition(".")
    if dot and part not in PARTS:
        raise UnknownName("part in a setting", part, PARTS)
    name, value = in_radians(name, value)
    if not dot and name == "faithful":
        for each in PARTS:
            settings[each][name] = value
    else:
        settings[part or "scenario"][name] = value


def in_radians(key: str, value: Any) -> tuple[str, Any]:
    """``fov_deg = 180`` is ``fov = pi``; other keys stay as they are. Raises TomThumbError for what is no number."""
    if not key.endswith("_deg"):
        return key, value
    values = value if isinstance(value, list) else [value]
    if any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in values):
        raise TomThumbError(f"{key} must be a number of degrees, got {value!r}")
    turned = [math.radians(v) for v in values]
    return key.removesuffix("_deg"), turned if isinstance(value, list) else turned[0]
