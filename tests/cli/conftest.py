"""The command line, called as a user would, in this process (fast) or in one of its own."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from tomthumb.cli.main import main


@dataclass
class Said:
    """Exit code and what was written."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """The one object on stdout."""
        found: dict[str, Any] = json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
        return found


@pytest.fixture
def tomthumb(monkeypatch, capsys) -> Callable[..., Said]:
    """`tomthumb("run", "cloister")` and what came of it."""

    def call(*arguments: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["tomthumb", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as leaving:
            code = int(leaving.code or 0)
        captured = capsys.readouterr()
        return Said(code, captured.out, captured.err)

    return call
