"""Bag files opened so that a damaged or hostile one costs bounded memory: the library that reads them trusts lengths.

A length in a damaged file may be anything up to 2^64, and reading that many bytes allocates them first; a compressed
chunk of some megabytes may unfold into any size. References: MCAP specification 1.0; ROS bag format 2.0.
"""

from __future__ import annotations

import bz2
import io
import os
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

from tomthumb.errors import BrokenFile

MCAP, ROS1 = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"
MCAP_CHUNK, ROS1_CHUNK = 0x06, 0x05
MAX_CHUNK = 128 << 20  # bytes of one chunk unpacked; recorders write 1 to 16 MiB
MAX_FILE = 8 << 30  # bytes of a file packed as a whole, which the reader unpacks onto the disk
MAX_YAML = 1 << 20
BLOCK = 1 << 16


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path whose files never read beyond their end, whatever length is asked for."""

    def open(self, mode: str = "r", *rest: Any, **options: Any) -> Any:
        """As `Path.open`; binary files are bounded."""
        return _Bounded(io.FileIO(str(self))) if mode == "rb" else super().open(mode, *rest, **options)

    def read_text(self, *rest: Any, **options: Any) -> str:
        """As `Path.read_text`. Raises BrokenFile where the file, which is the metadata of a bag, is too long."""
        if self.stat().st_size > MAX_YAML:
            raise BrokenFile(Path(str(self)), f"more than {MAX_YAML >> 20} MiB of metadata")
        return str(super().read_text(*rest, **options))


class _Bounded(io.BufferedReader):
    """A file of which `read` asks for no more than is left."""

    def __init__(self, raw: io.FileIO) -> None:
        super().__init__(raw)
        self.end = os.fstat(raw.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """As `BufferedReader.read`."""
        if size is not None and size > BLOCK:
            size = min(size, max(0, self.end - self.tell()))
        return super().read(size)


def check_bag(path: Path) -> None:
    """Unpack once, in bounded memory, all that is compressed in a bag (a file or a folder): chunks, messages, files.

    Raises BrokenFile for a chunk or a message of more than MAX_CHUNK bytes, a file of more than MAX_FILE; whatever else
    is wrong is the reader's to find.
    """
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if not file.is_file():
            continue
        with open(file, "rb") as stream:
            if file.suffix == ".zst" and _unfolds(stream, file.stat().st_size, b"zstd", MAX_FILE):
                raise BrokenFile(file, f"more than {MAX_FILE >> 30} GiB when unpacked")
            _check_chunks(stream, file)
        if file.suffix == ".db3" and _packs_messages(file.with_name("metadata.yaml")):
            _check_messages(file)


def _packs_messages(metadata: Path) -> bool:
    """Whether a bag's metadata says that each message is compressed on its own."""
    if not metadata.is_file() or metadata.stat().st_size > MAX_YAML:
        return False
    return re.search(rb"compression_mode\W+message", metadata.read_bytes(), re.IGNORECASE) is not None


def _check_messages(file: Path) -> None:
    try:
        with closing(sqlite3.connect(f"file:{quote(str(file))}?immutable=1", uri=True)) as base:
            for (data,) in base.execute("SELECT data FROM messages"):
                if isinstance(data, bytes) and _unfolds(io.BytesIO(data), len(data), b"zstd", MAX_CHUNK):
                    raise BrokenFile(file, f"a message of more than {MAX_CHUNK >> 20} MiB when unpacked")
    except sqlite3.Error:  # the reader meets it again and says what is wrong
        return


def _check_chunks(stream: io.BufferedReader, file: Path) -> None:
    size = file.stat().st_size
    head = stream.read(len(ROS1))
    chunks = _mcap_chunks if head.startswith(MCAP) else _ros1_chunks if head == ROS1 else None
    if chunks is None:
        return
    for compression, at, length in chunks(stream, size):
        stream.seek(at)
        if _unfolds(stream, length, compression, MAX_CHUNK):
            raise BrokenFile(file, f"a chunk of more than {MAX_CHUNK >> 20} MiB when unpacked, at byte {at}")


def _mcap_chunks(stream: io.BufferedReader, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Compression, place and length of the data of each chunk; ends where the records do."""
    at = len(MCAP)
    while at + 9 <= size:
        stream.seek(at)
        kind, length = struct.unpack("<BQ", stream.read(9))
        if length > size - at - 9:
            return
        if kind == MCAP_CHUNK and length >= 40:
            (words,) = struct.unpack("<28xI", stream.read(32))
            name = stream.read(words) if words <= 16 else b""
            yield name, at + 9 + 40 + words, length - 40 - words
        at += 9 + length


def _ros1_chunks(stream: io.BufferedReader, size: int) -> Iterator[tuple[bytes, int, int]]:
    at = len(ROS1)
    while at + 8 <= size:
        stream.seek(at)
        (length,) = struct.unpack("<I", stream.read(4))
        if length > size - at - 8:
            return
        fields = _fields(stream.read(length))
        (content,) = struct.unpack("<I", stream.read(4))
        at += 8 + length
        if content > size - at:
            return
        if fields.get(b"op") == bytes([ROS1_CHUNK]):
            yield fields.get(b"compression", b""), at, content
        at += content


def _fields(header: bytes) -> dict[bytes, bytes]:
    """The ``name=value`` fields of a record of ROS 1."""
    out: dict[bytes, bytes] = {}
    at = 0
    while at + 4 <= len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        out[name] = value
        at += 4 + length
    return out


def _unpacker(compression: bytes) -> Callable[[bytes, int], bytes] | None:
    """A function of a block and the most bytes wanted, which may be called again with b"" for more of the same."""
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress
    if compression == b"lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        return LZ4FrameDecompressor().decompress  # type: ignore[no-any-return]
    if compression == b"zstd":
        try:
            from compression import zstd  # type: ignore[import-not-found,unused-ignore]
        except ModuleNotFoundError:
            from backports import zstd
        return zstd.ZstdDecompressor().decompress  # type: ignore[no-any-return,unused-ignore]
    return None


def _unfolds(stream: IO[bytes], length: int, compression: bytes, most: int) -> bool:
    """Whether the `length` bytes that follow unpack to more than `most`; False too where they do not unpack."""
    unpack = _unpacker(compression)
    if unpack is None:
        return False
    total = 0
    try:
        while length > 0 and (block := stream.read(min(BLOCK, length))):
            length -= len(block)
            while part := unpack(block, 16 * BLOCK):
                total, block = total + len(part), b""
                if total > most:
                    return True
    except Exception:  # of many kinds, by library; the reader meets it again and says what is wrong
        return False
    return False
