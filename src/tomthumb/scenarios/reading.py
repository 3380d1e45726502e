"""Files read safely: compressed or not, bounded in size, numbers checked, and one clear error that names the line."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import struct
import zipfile
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, overload

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.geometry import wrap
from tomthumb.types import Array, Mask, Step

MAX_BYTES = 128 << 20  # of one file, unpacked: no known landmark log comes near it
MAX_ROWS = 5_000_000
MAX_VALUES = 20_000_000
MAX_NUMBER = 1e30  # larger than any length, time or information in SI units; products of such numbers stay finite
CHUNK = 1 << 20
BROKEN = (OSError, EOFError, lzma.LZMAError, zlib.error, zipfile.BadZipFile, NotImplementedError, RuntimeError)
BROKEN_ZIP = (UnicodeDecodeError, struct.error, OverflowError)  # a damaged directory of an archive: names, fields

_OPENERS: dict[bytes, Callable[[Any], Any]] = {b"\x1f\x8b": gzip.open, b"\xfd7zXZ": lzma.open, b"BZh": bz2.open}


@contextmanager
def unpacked(path: Path) -> Iterator[IO[bytes]]:
    """The file as a stream of bytes, unpacked if it is gzip, xz or bzip2 (told by its content, not by its name)."""
    if path.is_dir():
        raise BrokenFile(path, "is a folder, not a file")
    try:
        with open(path, "rb") as raw:
            head = raw.read(6)
            raw.seek(0)
            opener = next((make for magic, make in _OPENERS.items() if head.startswith(magic)), None)
            yield opener(raw) if opener else raw
    except FileNotFoundError:
        raise BrokenFile(path, "no such file") from None
    except BROKEN as error:
        raise BrokenFile(path, f"cannot be read: {error or type(error).__name__}") from error


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """All of a file, unpacked. Raises BrokenFile where it cannot be read or holds more than `limit` bytes."""
    with unpacked(path) as stream:
        return _read(stream, path, limit)


def read_member(path: Path, member: str, limit: int = MAX_BYTES) -> bytes:
    """One member of a zip archive, unpacked in memory; nothing is ever written, so its name cannot lead astray."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(member) as stream:
            return _read(stream, Path(f"{path}/{member}"), limit)
    except KeyError:
        raise BrokenFile(path, f"holds no {member}") from None
    except (*BROKEN, *BROKEN_ZIP) as error:
        raise BrokenFile(path, f"cannot be read as a zip archive: {error}") from error


def read_text(path: Path, limit: int = MAX_BYTES) -> str:
    """All of a text file. Raises BrokenFile where it is not UTF-8."""
    return as_text(read_bytes(path, limit), path)


def as_text(data: bytes, path: object) -> str:
    """Bytes as UTF-8 text, without a byte-order mark; the error names the line."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BrokenFile(path, "not UTF-8 text", data.count(b"\n", 0, error.start) + 1) from None


def _read(stream: IO[bytes], path: Path, limit: int) -> bytes:
    parts: list[bytes] = []
    size = 0
    while part := stream.read(CHUNK):
        size += len(part)
        if size > limit:
            raise BrokenFile(path, f"more than {limit >> 20} MiB when unpacked")
        parts.append(part)
    return b"".join(parts)


def numbers(data: bytes, path: object) -> Array:
    """All whitespace-separated numbers of a text, line ends ignored. Raises BrokenFile where one is not finite."""
    values = array("d")
    for piece in _pieces(data):
        try:
            values.extend(map(float, piece.split()))
        except ValueError as error:
            raise BrokenFile(path, f"{_short(error)} after {len(values)} numbers") from None
        if len(values) > MAX_VALUES:
            raise BrokenFile(path, f"more than {MAX_VALUES} numbers")
    out = np.frombuffer(values, float).copy() if values else np.empty(0)
    bad = np.flatnonzero(~sane(out))
    if len(bad):
        raise BrokenFile(path, f"number {bad[0] + 1} is not finite, or beyond {MAX_NUMBER:g}")
    return out


def sane(values: Array) -> Mask:
    """Which values are finite and not beyond MAX_NUMBER."""
    return np.asarray(np.abs(values) <= MAX_NUMBER)


def _pieces(data: bytes) -> Iterator[bytes]:
    """`data` in slices of about 1 MiB, cut between numbers."""
    start = 0
    while start < len(data):
        end = min(start + CHUNK, len(data))
        while end < len(data) and not data[end : end + 1].isspace():
            end += 1
            if end - start > 2 * CHUNK:
                break
        yield data[start:end]
        start = end


def table(
    data: bytes, path: object, columns: int, *, comment: str = "#", sep: str | None = None, header: int = 0
) -> Array:
    """The rows (n, columns) of a text of numbers. Lines that are empty or begin with `comment` are skipped.

    Raises BrokenFile, naming the line, for a wrong number of columns or anything but finite numbers.
    """
    values = array("d")
    mark = comment.encode()
    split = None if sep is None else sep.encode()
    for number, raw in enumerate(io.BytesIO(data), 1):
        line = raw.strip()
        if number <= header or not line or line.startswith(mark):
            continue
        values.extend(_row(line.split(split), columns, path, number))
        if number > MAX_ROWS:
            raise BrokenFile(path, f"more than {MAX_ROWS} lines", number)
    return np.frombuffer(values, float).reshape(-1, columns).copy() if values else np.empty((0, columns))


def _row(parts: Sequence[bytes], columns: int, path: object, number: int) -> list[float]:
    if len(parts) != columns:
        raise BrokenFile(path, f"{len(parts)} columns where {columns} are expected", number)
    return floats([part.decode("latin-1") for part in parts], path, number)


def floats(parts: Iterable[str], path: object, number: int) -> list[float]:
    """Words as finite numbers. Raises BrokenFile naming line `number`."""
    try:
        row = [float(part) for part in parts]
    except ValueError as error:
        raise BrokenFile(path, _short(error), number) from None
    if not all(abs(value) <= MAX_NUMBER for value in row):
        raise BrokenFile(path, f"a value is not finite, or beyond {MAX_NUMBER:g}", number)
    return row


def _short(error: Exception) -> str:
    text = str(error)
    return text if len(text) < 100 else f"{text[:80]}..."


def increasing(t: Array, path: object, what: str = "time", first_line: int | None = None) -> None:
    """Raise BrokenFile if `t (n,)` s ever runs back."""
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back):
        k = int(back[0]) + 1
        line = None if first_line is None else first_line + k
        raise BrokenFile(path, f"{what} runs back from {t[k - 1]:.6g} to {t[k]:.6g} at row {k + 1}", line)


def whole(values: Array, path: object, what: str) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Values that must be whole numbers, as integers. Raises BrokenFile otherwise."""
    if (values != np.rint(values)).any() or (np.abs(values) > 2**53).any():
        raise BrokenFile(path, f"{what} is not a whole number")
    return values.astype(np.int64)


@dataclass(frozen=True)
class Steps(Sequence[Step]):
    """Steps made when they are asked for: `size` of them, the k-th by ``make(k)``."""

    size: int
    make: Callable[[int], Step]

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, k: int) -> Step: ...

    @overload
    def __getitem__(self, k: slice) -> Sequence[Step]: ...

    def __getitem__(self, k: int | slice) -> Step | Sequence[Step]:
        if isinstance(k, slice):
            return [self.make(i) for i in range(*k.indices(self.size))]
        if not -self.size <= k < self.size:
            raise IndexError(k)
        return self.make(k % self.size)


def pose_at(t: Array, times: Array, poses: Array, longest_gap: float) -> Array:
    """Poses (n, 3) interpolated at `t (n,)`; NaN outside `times` and inside gaps longer than `longest_gap` s."""
    if not len(times):
        return np.full((len(t), 3), np.nan)
    k = np.clip(np.searchsorted(times, t, side="right"), 1, len(times) - 1) if len(times) > 1 else np.zeros(len(t), int)
    a, b = poses[k - 1], poses[k]
    gap = times[k] - times[k - 1]
    share = np.divide(t - times[k - 1], gap, out=np.zeros(len(t)), where=gap > 0)[:, None]
    delta = b - a
    delta[:, 2] = wrap(delta[:, 2])
    out: Array = a + share * delta
    out[:, 2] = wrap(out[:, 2])
    between = (share[:, 0] > 0) & (share[:, 0] < 1)
    out[(t < times[0]) | (t > times[-1]) | (between & (gap > longest_gap))] = np.nan
    return out


def known(pose: Array) -> Array | None:
    """The pose, or None where it is NaN."""
    return pose if np.isfinite(pose).all() else None
