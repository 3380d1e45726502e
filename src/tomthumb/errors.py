"""What can go wrong through no fault of ours: each is one clear line, and the command line exits with 2."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable


class TomThumbError(ValueError):
    """Bad input: says what, where, and what is valid."""


class UnknownName(TomThumbError):
    """A name that stands for nothing, with a "did you mean"."""

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        known = sorted(valid)
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else "."
        super().__init__(f"unknown {kind} {name!r}{hint} Valid: {', '.join(known) or 'none'}")


class BrokenFile(TomThumbError):
    """A file that cannot be read as what it claims to be: names the file and, where known, the line."""

    def __init__(self, path: object, what: str, line: int | None = None) -> None:
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {what}")


class Diverged(ArithmeticError):
    """The filter has lost the robot: the run ends with this name in its result, never with a crash."""


def from_zero(owner: str, part: object, names: str, most: float = math.inf) -> None:
    """Raises TomThumbError if one of a part's settings (names with spaces between) is not a number between 0 and `most`."""
    wanted = "a number from 0 on" if math.isinf(most) else f"a number from 0 to {most:g}"
    for name in names.split():
        if not 0 <= getattr(part, name) <= most:
            raise TomThumbError(f"{owner}.{name}={getattr(part, name)}: {wanted}")
