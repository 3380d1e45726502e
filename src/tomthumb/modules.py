"""Code of other people, by ``package.module`` or ``./file.py``."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from tomthumb.errors import TomThumbError


def module_at(where: str, wanted: str) -> ModuleType:
    """The module at `where`; `wanted` is what a message calls the thing that is looked for in it.

    Raises TomThumbError where there is no such module or file; what goes wrong inside of it is its own to show.
    """
    return _from_file(Path(where)) if where.endswith(".py") else _from_package(where, wanted)


def _from_package(name: str, wanted: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as missing:
        if missing.name is None or not (name == missing.name or name.startswith(missing.name + ".")):
            raise  # the module exists, and misses something itself
        raise TomThumbError(f"{wanted}: there is no module {missing.name!r}") from None


def _from_file(path: Path) -> ModuleType:
    """A file as a module; the same file gives the same module, so that its classes stay themselves."""
    full = path.expanduser().resolve()
    if not full.is_file():
        raise TomThumbError(f"{path}: no such file")
    name = f"tomthumb_file_{full.stem}_{hashlib.sha256(str(full).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, full)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up while it is being executed
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
