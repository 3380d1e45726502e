"""The individually compatible landmarks of each observation, as flat lists that the kernels walk through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.types import Array, Ids


@dataclass(frozen=True, slots=True)
class Candidates:
    """Observation `order[s]` may pair with `columns[start[s]:start[s + 1]]`."""

    order: Ids
    start: Ids
    columns: Ids


def gated(d2: Array, gate2: float, *, nearest_first: bool = True, fewest_first: bool = True) -> Candidates:
    """Landmarks with d2 (m, n) below `gate2`: nearest first, observations with the fewest candidates first (ties by index)."""
    inside = d2 < gate2
    counts = inside.sum(1)
    order = np.argsort(counts, kind="stable") if fewest_first else np.arange(len(d2))
    start = np.concatenate([[0], np.cumsum(counts[order])]).astype(np.int64)
    ranked = np.where(inside, d2, np.inf)[order]
    columns = (
        np.argsort(ranked, axis=1, kind="stable")
        if nearest_first
        else np.argsort(~inside[order], axis=1, kind="stable")
    )
    taken = np.arange(d2.shape[1])[None] < counts[order][:, None]
    return Candidates(order.astype(np.int64), start, columns[taken].astype(np.int64))
