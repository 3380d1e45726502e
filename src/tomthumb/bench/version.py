"""What made a row: checksum of the code, of the data, and the versions of what lies below."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import tomthumb
from tomthumb.errors import TomThumbError

PACKAGE = Path(tomthumb.__file__).parent
NO_EFFECT = ("bench", "cli", "site", "stats", "report", "live")  # cannot change the result of a run ...
BUT = ("bench/execute.py",)  # ... except where it is run
BLOCK = 1 << 20


@cache
def code_version() -> str:
    """The package's version with a checksum of all source files that can change a result.

    So a row outlives a change of the report or of this package, and never a change of a filter.
    """
    files = [path for path in sorted(PACKAGE.rglob("*.py")) if _counts(path.relative_to(PACKAGE).as_posix())]
    return f"{tomthumb.__version__}+{checksum(files, PACKAGE)[:12]}"


def _counts(name: str) -> bool:
    return name in BUT or name.split("/")[0] not in NO_EFFECT


def checksum(files: Iterable[Path], root: Path) -> str:
    """SHA-256 over names (relative to `root`) and contents of `files`."""
    total = hashlib.sha256()
    for path in files:
        total.update(path.relative_to(root).as_posix().encode() + b"\0" + _content(path))
    return total.hexdigest()


def _content(path: Path) -> bytes:
    """The checksum of one file, read in blocks."""
    one = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            one.update(block)
    return one.digest()


def data_checksum(path: Path) -> str:
    """Checksum of a file, or of all files below a folder. Raises TomThumbError where it cannot be read."""
    try:
        files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
        return checksum(files, path.parent)[:32]
    except OSError as reason:
        raise TomThumbError(f"{path}: cannot be read: {reason.strerror or reason}") from None


@cache
def environment() -> dict[str, str]:
    """Versions and machine, for the report. Not part of a run's key: two machines may share a grid."""
    import llvmlite
    import numba
    import numpy
    import scipy

    modules = {"numpy": numpy, "scipy": scipy, "numba": numba, "llvmlite": llvmlite}
    return {
        "tomthumb": code_version(),
        "python": platform.python_version(),
        **{name: str(module.__version__) for name, module in modules.items()},
        "system": platform.platform(),
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "command": " ".join(["tomthumb", *sys.argv[1:]]),
    }


def _processor() -> str:
    """The model of the processor: its rounding may differ from another's in the last digit."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not Linux
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")
