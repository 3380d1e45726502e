"""Steps of logs that may be too long for memory: read again from the file at every pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import overload

from tomthumb.types import Step

KEEP_BELOW = 32 << 20  # bytes of file: shorter logs are read once and kept


@dataclass(frozen=True)
class StreamedSteps(Sequence[Step]):
    """Steps read from a file at each pass by ``read()``. The length is counted by one pass, when first asked for."""

    read: Callable[[], Iterator[Step]]
    _length: list[int] = field(default_factory=list)

    def __iter__(self) -> Iterator[Step]:
        return self.read()

    def __len__(self) -> int:
        if not self._length:
            self._length.append(sum(1 for _ in self.read()))
        return self._length[0]

    @overload
    def __getitem__(self, k: int) -> Step: ...

    @overload
    def __getitem__(self, k: slice) -> Sequence[Step]: ...

    def __getitem__(self, k: int | slice) -> Step | Sequence[Step]:
        if isinstance(k, slice):
            start, stop, stride = k.indices(len(self))
            return list(islice(self.read(), start, stop, stride)) if stride > 0 else list(self.read())[k]
        found = next(islice(self.read(), k if k >= 0 else len(self) + k, None), None)
        if found is None:
            raise IndexError(k)
        return found


def steps_of(read: Callable[[], Iterator[Step]], *files: Path) -> Sequence[Step]:
    """All steps as a list where the files are small, otherwise streamed."""
    size = sum(file.stat().st_size for file in files if file.exists())
    return list(read()) if size < KEEP_BELOW else StreamedSteps(read)
