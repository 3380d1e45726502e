"""One run of a grid as plain data, and the key its result is kept under.

The key is a checksum of everything the result depends on: the configuration, the seed, the code, and the content of
every file it names (a log, a plug-in). Where those files lie does not count, so a run has the same key on every
machine.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

KINDS = ("scenario", "estimator", "associator", "slam")


@dataclass(frozen=True)
class Part:
    """One choice on one axis: what to `use`, its parameters, the label it has in tables.

    `files` is the checksum of the files that `use` names, "" when it names none; `use` then holds a full path.
    """

    use: str
    params: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""
    files: str = ""

    def content(self) -> dict[str, Any]:
        """What the result depends on."""
        name = f"{_base(self.use)} {self.files}" if self.files else self.use
        return {"use": name, "params": dict(self.params)}


@dataclass(frozen=True)
class RunSpec:
    """A scenario, an estimator, an associator and a life cycle, each with its parameters; one seed; the code's
    version.
    """

    scenario: Part
    estimator: Part
    associator: Part
    slam: Part
    seed: int
    code: str

    @cached_property
    def key(self) -> str:
        """Under which the result is kept: 32 hex digits."""
        return digest({**self._content(), "seed": self.seed, "code": self.code})

    @cached_property
    def case(self) -> str:
        """The same without seed and code: what pairs rows of different seeds, or of different versions."""
        return digest(self._content())

    @cached_property
    def world(self) -> str:
        """What two runs must share to be a pair: scenario and seed."""
        return digest({"scenario": self.scenario.content(), "seed": self.seed})

    def job(self) -> dict[str, Any]:
        """What a worker needs, as JSON."""
        parts = {kind: {"use": part.use, "params": dict(part.params)} for kind, part in self.parts().items()}
        files = {part.use: part.files for part in self.parts().values() if part.files}
        return {"key": self.key, "world": self.world, "seed": self.seed, "files": files, **parts}

    def parts(self) -> dict[str, Part]:
        """The four choices by kind."""
        return {kind: getattr(self, kind) for kind in KINDS}

    def _content(self) -> dict[str, Any]:
        return {kind: part.content() for kind, part in self.parts().items()}


def digest(content: Any) -> str:
    """Checksum of plain data: the order of keys and 1 against 1.0 make no difference."""
    return hashlib.sha256(canonical(content).encode()).hexdigest()[:32]


def canonical(content: Any) -> str:
    """Plain data as the one JSON text it has."""
    return json.dumps(_plain(content), sort_keys=True, separators=(",", ":"), allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _base(use: str) -> str:
    """A path without the folders it lies in."""
    return use.replace("\\", "/").rsplit("/", 1)[-1]
