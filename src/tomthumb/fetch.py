"""Logs downloaded from where they are published, at a pinned revision, checked by SHA-256, resumed when broken off.

``sources.toml`` lists them with licence and citation. What this project computed from them (truth by batch solution,
labels) is not published anywhere and not fetched: a loader then gives the log without it.
"""

from __future__ import annotations

import hashlib
import shutil
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

from tomthumb.errors import TomThumbError, UnknownName

CHUNK = 1 << 18
TIMEOUT = 30.0  # s without a byte
PARTIAL = 206  # HTTP: the rest of a file, as asked for
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """One file: where it is below the source's address, where it goes, its size in bytes and SHA-256."""

    remote: str
    local: str
    bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Source:
    """A log that can be fetched. `kind` is the scenario that reads it; `seen` what of the address was found in an index
    of public repositories (the addresses themselves were not tried when the list was made).
    """

    name: str
    kind: str
    url: str
    licence: str
    citation: str
    seen: str
    files: tuple[RemoteFile, ...]


def sources() -> dict[str, Source]:
    """All logs that can be fetched, by name."""
    raw = tomllib.loads(files("tomthumb").joinpath("sources.toml").read_text(encoding="utf-8"))
    return {name: parse_source(name, table) for name, table in raw.items()}


def parse_source(name: str, raw: Mapping[str, Any]) -> Source:
    """A source out of a TOML table. Raises TomThumbError where a key is missing or a path leads out of the folder."""
    try:
        listed = tuple(RemoteFile(f["remote"], f["local"], int(f["bytes"]), f["sha256"]) for f in raw["files"])
        source = Source(name, raw["kind"], raw["url"], raw["licence"], raw["citation"], raw["seen"], listed)
    except (KeyError, TypeError, ValueError) as error:
        raise TomThumbError(f"source {name}: {type(error).__name__}: {error}") from None
    for file in listed:
        parts = PurePosixPath(file.local)
        if parts.is_absolute() or ".." in parts.parts or "\\" in file.local or not file.local:
            raise TomThumbError(f"source {name}: {file.local!r} leads out of the folder")
        if len(file.sha256) != 64 or file.bytes < 0:
            raise TomThumbError(f"source {name}: {file.local}: no SHA-256 or size")
    return source


def fetch(name: str, folder: Path, *, base: str | None = None, progress: Progress | None = None) -> dict[str, Any]:
    """Download the log `name` into `folder`/`name`; files that are there and right are kept.

    `base` stands for the source's address (a mirror, a test). ``progress(file, done, total)`` is called as bytes come
    in. Returns name, kind, folder, licence, citation, and which files were `downloaded` and which `kept`. Raises
    UnknownName, and TomThumbError where a download fails or its content is not what was expected (then it is removed).
    """
    known = sources()
    if name not in known:
        raise UnknownName("log to fetch", name, known)
    return fetch_source(known[name], Path(folder) / name, base=base, progress=progress)


def fetch_source(
    source: Source, folder: Path, *, base: str | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """`fetch` of a given source, into `folder` itself."""
    downloaded, kept = [], []
    for file in source.files:
        target = folder / file.local
        if is_right(target, file):
            kept.append(file.local)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        download((base or source.url).rstrip("/") + "/" + quote(file.remote), target, file, progress)
        downloaded.append(file.local)
    return {
        "name": source.name,
        "kind": source.kind,
        "folder": str(folder),
        "licence": source.licence,
        "citation": source.citation,
        "downloaded": downloaded,
        "kept": kept,
    }


def is_right(path: Path, file: RemoteFile) -> bool:
    """Whether a file is there with the size and the SHA-256 it should have."""
    return path.is_file() and path.stat().st_size == file.bytes and sha256(path) == file.sha256


def sha256(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def download(url: str, target: Path, file: RemoteFile, progress: Progress | None = None) -> None:
    """Load `url` into `target`, by way of ``target.part``, from which a broken download is taken up again.

    Raises TomThumbError where the server fails, sends more or less than it should, or something else.
    """
    part = target.with_name(target.name + ".part")
    if part.exists() and part.stat().st_size >= file.bytes:
        part.unlink()
    try:
        _receive(url, part, file, progress)
    except HTTPError as error:
        raise TomThumbError(f"{url}: HTTP {error.code} {error.reason}") from None
    except (URLError, OSError) as error:
        reason = getattr(error, "reason", None) or error
        raise TomThumbError(f"{url}: {reason}; what has come is kept, try again") from None
    size = part.stat().st_size
    if size < file.bytes:
        raise TomThumbError(f"{url}: broken off after {size} of {file.bytes} bytes; what has come is kept, try again")
    if not is_right(part, file):
        part.unlink()
        raise TomThumbError(f"{url}: is not the file that was expected (its SHA-256 or size differs); removed")
    shutil.move(part, target)


def _receive(url: str, part: Path, file: RemoteFile, progress: Progress | None) -> None:
    """Append to `part` what is missing of it, never more than one byte beyond the expected size."""
    have = part.stat().st_size if part.exists() else 0
    if have == file.bytes and part.exists():
        return
    headers = {"Range": f"bytes={have}-"} if have else {}
    with urlopen(Request(url, headers=headers), timeout=TIMEOUT) as answer:
        resumed = have > 0 and answer.status == PARTIAL
        done = have if resumed else 0
        with open(part, "ab" if resumed else "wb") as out:
            for block in _blocks(answer, file.bytes + 1 - done):
                out.write(block)
                done += len(block)
                if progress is not None:
                    progress(file.local, done, file.bytes)


def _blocks(answer: Any, most: int) -> Iterator[bytes]:
    while most > 0 and (block := answer.read(min(CHUNK, most))):
        most -= len(block)
        yield block
