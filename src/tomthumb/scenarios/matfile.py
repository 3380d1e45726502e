"""MATLAB 5 files (versions 5 to 7), read in bounded memory whatever they claim to hold.

A small reader of our own: numbers, text, cells and structs. References: MathWorks, "MAT-File Format", level 5.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.scenarios.reading import MAX_BYTES, MAX_NUMBER, read_bytes, sane
from tomthumb.types import Array

MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, CHAR = 1, 2, 4
NUMERIC = range(6, 16)
DEPTH = 12
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8", 16: "u1", 17: "u2"}


@dataclass(frozen=True, slots=True)
class _Reader:
    """A piece of the file, its byte order, and how deep it is nested."""

    data: memoryview
    order: str
    depth: int = 0

    def elements(self) -> Iterator[tuple[int, memoryview]]:
        """The type and content of each element in turn."""
        at = 0
        while at + 8 <= len(self.data):
            kind, size = struct.unpack_from(self.order + "II", self.data, at)
            if kind >> 16:  # a small element: size and type in one word, the content in the next
                kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 8
                if size > 4:
                    raise ValueError("a small element of more than 4 bytes")
            else:
                start = at + 8
                step = 8 + (size if kind == COMPRESSED else -(-size // 8) * 8)
            if start + size > len(self.data):
                raise ValueError("an element is cut off")
            yield kind, self.data[start : start + size]
            at += step

    def inside(self, data: memoryview) -> _Reader:
        if self.depth >= DEPTH:
            raise ValueError(f"nested more than {DEPTH} deep")
        return _Reader(data, self.order, self.depth + 1)


def load_mat(path: Path, wanted: Sequence[str]) -> dict[str, Any]:
    """The named variables of a MATLAB 5 file: float arrays (rows, columns), strings, lists (cells), dicts (structs).

    An array of structs is a list of dicts. Raises BrokenFile where the file is not one, or lacks a name.
    """
    data = read_bytes(path)
    try:
        found = dict(_variables(data, set(wanted)))
    except (ValueError, struct.error, zlib.error, OverflowError, KeyError) as error:
        raise BrokenFile(path, f"not a readable MATLAB 5 file: {error}") from None
    for name in wanted:
        if name not in found:
            raise BrokenFile(path, f"holds no variable {name!r}")
    return found


def _variables(data: bytes, wanted: set[str]) -> Iterator[tuple[str, Any]]:
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI"):
        raise ValueError("no MATLAB 5 header")
    order = "<" if data[126:128] == b"IM" else ">"
    left = MAX_BYTES
    for kind, content in _Reader(memoryview(data)[128:], order).elements():
        reader = _Reader(content, order)
        if kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            plain = unpacker.decompress(content, left)
            left -= len(plain)
            if unpacker.unconsumed_tail or left <= 0:
                raise ValueError(f"more than {MAX_BYTES >> 20} MiB when unpacked")
            kind, content = next(_Reader(memoryview(plain), order).elements(), (0, memoryview(b"")))
            reader = _Reader(content, order)
        if kind == MATRIX and _name(reader) in wanted:
            yield _name(reader), _matrix(reader)


def _name(reader: _Reader) -> str:
    parts = reader.elements()
    next(parts, None), next(parts, None)
    name = next(parts, None)
    return "" if name is None else bytes(name[1]).decode("latin-1")


def _matrix(reader: _Reader) -> Any:
    parts = list(reader.elements())
    if len(parts) < 3:
        return np.empty((0, 0))
    flags = _first(parts[0][1], reader.order + "u4")
    shape = tuple(int(k) for k in np.frombuffer(parts[1][1], reader.order + "i4"))
    if not 2 <= len(shape) <= 4 or min(shape) < 0:
        raise ValueError(f"a matrix of shape {shape}")
    rest = parts[3:]
    kind = flags & 0xFF
    if kind == CELL:
        return [_matrix(reader.inside(content)) for _, content in rest]
    if kind == STRUCT:
        return _structs(reader, rest, math.prod(shape))
    if kind == CHAR or kind in NUMERIC:
        return _numbers(reader, rest, shape, kind)
    raise ValueError(f"a matrix of class {kind}, which is not supported")


def _first(content: memoryview, code: str) -> int:
    """The first integer of an element."""
    values = np.frombuffer(content, code)
    if not len(values):
        raise ValueError("an element without content")
    return int(values[0])


def _numbers(reader: _Reader, parts: list[tuple[int, memoryview]], shape: tuple[int, ...], kind: int) -> Any:
    if not parts:
        return "" if kind == CHAR else np.empty((0, 0))
    code, content = parts[0]
    if code not in TYPES:
        raise ValueError(f"numbers of type {code}, which is not supported")
    values = np.frombuffer(content, reader.order + TYPES[code])
    if kind == CHAR:
        return "".join(map(chr, values.astype(np.int64) & 0xFFFF))
    if len(values) != math.prod(shape):
        raise ValueError(f"{len(values)} numbers for a matrix of shape {shape}")
    return values.astype(float).reshape(shape, order="F")


def _structs(reader: _Reader, parts: list[tuple[int, memoryview]], count: int) -> Any:
    if len(parts) < 2:
        raise ValueError("a struct without field names")
    width = _first(parts[0][1], reader.order + "i4")
    if width <= 0:
        raise ValueError("a struct with field names of no length")
    raw = bytes(parts[1][1])
    names = [raw[k : k + width].split(b"\0")[0].decode("latin-1") for k in range(0, len(raw), width)]
    if len(parts) - 2 != count * len(names):
        raise ValueError(f"{len(parts) - 2} fields for {count} structs of {len(names)}")
    values = [_matrix(reader.inside(content)) for _, content in parts[2:]]
    rows = [dict(zip(names, values[k * len(names) : (k + 1) * len(names)], strict=True)) for k in range(count)]
    return rows[0] if count == 1 else rows


def matrix(source: Mapping[str, Any], name: str, path: object, shape: tuple[int | None, ...]) -> Array:
    """A finite array of a given shape (None: any) out of what `load_mat` gave. Raises BrokenFile otherwise."""
    value = source.get(name)
    if not isinstance(value, np.ndarray):
        raise BrokenFile(path, f"{name} is not an array of numbers")
    if len(shape) == 1:
        value = value.ravel(order="F")
    if value.ndim != len(shape) or any(want not in (None, have) for have, want in zip(value.shape, shape, strict=True)):
        raise BrokenFile(path, f"{name} has shape {value.shape} where {_shape(shape)} is expected")
    if not sane(value).all():
        raise BrokenFile(path, f"{name} holds values that are not finite, or beyond {MAX_NUMBER:g}")
    return value


def _shape(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("n" if k is None else str(k) for k in shape) + ")"
