"""Worlds and logs: simulators ``(parameters, rng) -> Scenario`` and loaders ``path -> Scenario``, found by name."""

from __future__ import annotations

from tomthumb.scenarios.catalogue import Entry, entries, load, parameters

__all__ = ["Entry", "entries", "load", "parameters"]
