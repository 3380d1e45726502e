"""Parameters given as text or from a file, brought to the types of the function or dataclass that wants them."""

from __future__ import annotations

import difflib
import inspect
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from tomthumb.errors import TomThumbError

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def accepted(function: Callable[..., Any], skip: Iterable[str] = ()) -> dict[str, inspect.Parameter]:
    """The named parameters of a function or dataclass, without those in `skip`."""
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    found = inspect.signature(function).parameters
    return {name: p for name, p in found.items() if p.kind in named and name not in skip}


def convert(
    function: Callable[..., Any], given: Mapping[str, Any], where: str, skip: Iterable[str] = ()
) -> dict[str, Any]:
    """Keyword arguments for `function` out of `given`, whose values may be text.

    A key ending in ``_deg`` becomes radians without the suffix. Raises TomThumbError for unknown keys (naming the valid
    ones) and for values that do not fit the parameter's type.
    """
    valid = accepted(function, skip)
    hints = typing.get_type_hints(function.__init__ if inspect.isclass(function) else function)
    out: dict[str, Any] = {}
    for key, value in given.items():
        name, degrees = (key, False) if key in valid or not key.endswith("_deg") else (key[:-4], True)
        if name not in valid:
            raise TomThumbError(unknown_key(where, key, valid))
        result = _typed(value, hints.get(name, Any), f"{where}: {key}")
        out[name] = _radians(result, f"{where}: {key}") if degrees else result
    return out


def unknown_key(where: str, key: str, valid: Iterable[str]) -> str:
    """One line: the key is unknown, what may have been meant, what is valid."""
    names = sorted(valid)
    close = difflib.get_close_matches(key, names, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else "."
    return f"{where}: unknown key {key!r}{hint} Valid: {', '.join(names) or 'none'}"


def _radians(value: Any, where: str) -> Any:
    if isinstance(value, tuple):
        return tuple(_radians(v, where) for v in value)
    if not isinstance(value, int | float):
        raise TomThumbError(f"{where}: not an angle")
    return math.radians(value)


def _typed(value: Any, hint: Any, where: str) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin is typing.Literal:
        if value not in args:
            raise TomThumbError(f"{where}={_shown(value)}: one of {', '.join(map(str, args))}")
        return value
    if origin in (typing.Union, types.UnionType):
        if value is None or (isinstance(value, str) and value.lower() == "none"):
            return None
        return _typed(value, next(a for a in args if a is not type(None)), where)
    if origin is tuple:
        return _tuple(value, args, where)
    return _simple(value, hint, where)


def _tuple(value: Any, args: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    items = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list | tuple):
        raise TomThumbError(f"{where}={_shown(value)}: a list is expected")
    kinds = [args[0]] * len(items) if len(args) == 2 and args[1] is Ellipsis else list(args)
    if len(items) != len(kinds):
        raise TomThumbError(f"{where}={_shown(value)}: {len(kinds)} values are expected")
    return tuple(_typed(item, kind, where) for item, kind in zip(items, kinds, strict=True))


def _simple(value: Any, hint: Any, where: str) -> Any:
    if hint is bool:
        return _bool(value, where)
    if hint in (int, float) and isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            number = float(value)
            whole = int(value) if hint is int and not isinstance(value, float) else None
        except (ValueError, OverflowError):  # the latter for an integer beyond all floats
            raise TomThumbError(
                f"{where}={_shown(value)}: a {'whole ' if hint is int else ''}number is expected"
            ) from None
        if hint is int:
            return whole if whole is not None else _whole(number, where)
        if math.isnan(number):
            raise TomThumbError(f"{where}={_shown(value)}: not a number")
        return number
    if hint is Path and isinstance(value, str | Path):
        return Path(value)
    if hint is str and isinstance(value, str):
        return value
    raise TomThumbError(f"{where}={_shown(value)}: {getattr(hint, '__name__', hint)} is expected")


def _shown(value: Any) -> str:
    """The value as it stands in a message: not more of it than fits."""
    text = repr(value)
    return text if len(text) < 100 else f"{text[:80]}..."


def _whole(number: float, where: str) -> int:
    if not number.is_integer():
        raise TomThumbError(f"{where}={number!r}: a whole number is expected")
    return int(number)


def _bool(value: Any, where: str) -> bool:
    if isinstance(value, bool):
        return value
    text = str(value).lower()
    if text in _TRUE:
        return True
    if text in _FALSE:
        return False
    raise TomThumbError(f"{where}={_shown(value)}: true or false is expected")
