"""The maps of all particles: pages of landmarks that particles share until one of them writes (copy on write)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tomthumb.kernels import fastslam as kernel
from tomthumb.types import Array, Ids, Mask

SIZE = kernel.SIZE


@dataclass(slots=True)
class Pages:
    """`table (M, T)`: page of each particle and column, -1 none. By page: `mean (Q, SIZE, 2)`, `cov (Q, SIZE, 3)` as xx,
    xy, yy, `has (Q, SIZE)`, owners `uses (Q,)`; `free`: count, then free pages. By slot: `live`, `stone`, `box`, `ids`.
    """

    table: Ids
    mean: Array
    cov: Array
    has: Mask
    uses: Ids
    free: Ids
    live: Mask
    stone: Mask
    box: Array
    ids: Ids
    slot: dict[int, int] = field(default_factory=dict)
    spare: list[int] = field(default_factory=list)


def empty(particles: int) -> Pages:
    """No landmarks, no pages."""
    none, nobody = np.empty(0, bool), np.empty(0, np.int64)
    mean, cov, has = np.empty((0, SIZE, 2)), np.empty((0, SIZE, 3)), np.empty((0, SIZE), bool)
    table = np.full((particles, 0), -1, np.int64)
    return Pages(table, mean, cov, has, nobody, np.zeros(1, np.int64), none, none, np.empty((0, 4)), nobody)


def copy(m: Pages) -> Pages:
    """A copy that shares nothing."""
    return Pages(
        m.table.copy(), m.mean.copy(), m.cov.copy(), m.has.copy(), m.uses.copy(), m.free.copy(), m.live.copy(),
        m.stone.copy(), m.box.copy(), m.ids.copy(), dict(m.slot), list(m.spare),
    )  # fmt: skip


def arrays(m: Pages) -> tuple[Ids, Array, Array, Mask, Ids, Ids]:
    """What the kernels that write a map take."""
    return m.table, m.mean, m.cov, m.has, m.uses, m.free


def reserve(m: Pages, columns: int) -> None:
    """Free pages for every particle to write on `columns` columns: the pool doubles where it is short."""
    need = len(m.table) * columns
    have = int(m.free[0])
    if have >= need:
        return
    old = len(m.uses)
    more = max(need - have, old, 64)
    m.mean = np.concatenate([m.mean, np.empty((more, SIZE, 2))])
    m.cov = np.concatenate([m.cov, np.empty((more, SIZE, 3))])
    m.has = np.concatenate([m.has, np.zeros((more, SIZE), bool)])
    m.uses = np.concatenate([m.uses, np.zeros(more, np.int64)])
    listed = np.zeros(1 + old + more, np.int64)
    listed[1 : 1 + have] = m.free[1 : 1 + have]
    listed[1 + have : 1 + have + more] = np.arange(old, old + more)
    listed[0] = have + more
    m.free = listed


def columns_of(slots: Ids) -> int:
    """How many columns a set of slots (-1 none) touches."""
    return len(set((slots[slots >= 0] // SIZE).tolist()))


def distinct(slots: Ids) -> Ids:
    """The slots that occur (-1: none), each once, ascending."""
    flat = slots[slots >= 0]
    seen = np.zeros(int(flat.max()) + 1, bool)
    seen[flat] = True
    return np.flatnonzero(seen)


def open_slots(m: Pages, ids: list[int]) -> list[int]:
    """A slot for each new landmark; the slots of forgotten ones are used again."""
    out = []
    for i in ids:
        s = m.spare.pop() if m.spare else _fresh(m)
        m.slot[i], m.ids[s], m.live[s], m.stone[s] = s, i, True, False
        out.append(s)
    return out


def _fresh(m: Pages) -> int:
    s = len(m.slot)
    if s >= len(m.live):
        more = max(4 * SIZE, len(m.live) // SIZE * SIZE)
        m.live = np.concatenate([m.live, np.zeros(more, bool)])
        m.stone = np.concatenate([m.stone, np.zeros(more, bool)])
        m.box = np.concatenate([m.box, np.zeros((more, 4))])
        m.ids = np.concatenate([m.ids, np.full(more, -1, np.int64)])
        m.table = np.concatenate([m.table, np.full((len(m.table), more // SIZE), -1, np.int64)], 1)
    return s


def forget(m: Pages, i: int) -> None:
    """Landmark `i` out of every map, shared pages included."""
    s = m.slot.pop(i)
    pages = np.unique(m.table[:, s // SIZE])
    m.has[pages[pages >= 0], s % SIZE] = False
    m.live[s] = m.stone[s] = False
    m.spare.append(s)
