"""Worlds and logs: simulators ``(parameters, rng) -> Scenario`` and loaders ``path -> Scenario``, found by name."""

from __future__ import annotations

from tomthumb.scenarios.catalogue import Entry, entries, load, parameters
from tomthumb.scenarios.inspection import info, suggest

__all__ = ["Entry", "entries", "info", "load", "parameters", "suggest"]
