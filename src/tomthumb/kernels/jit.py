"""The one place that knows numba: `jit` compiles, caches on disk where it can, and never holds the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., object])

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def jit(function: F) -> F:
    """Compile `function` with numba; cached on disk unless no cache directory can be written."""
    try:
        compiled: F = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # numba: "no locator available": neither __pycache__ nor the user's cache can be written
        compiled = numba.njit(**_OPTIONS)(function)
    return compiled
