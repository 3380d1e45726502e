"""The trail: stones that never fade and crumbs that do (paper, assumptions A6 to A10).

A mark is a step number and a strength. To follow the trail home is to go, again and again, to the mark in the window
with the highest number below the one stood on; the trail has disappeared when the window holds none.
"""

from __future__ import annotations

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.kernels.forest import mark_strength, next_mark
from tomthumb.types import Array, Ids, Mask

__all__ = ["followed_length", "mark_strength", "next_mark", "strengths"]


def strengths(ages: Array | Ids, tau: float, stones: Mask) -> Array:
    """Strength in [0, 1] of marks laid `ages (k,)` steps ago; 1 for `stones (k,)`, else exp(-age / tau).

    `next_mark(numbers, strengths, current, floor)` picks among them the one to go to.

    Raises:
        TomThumbError: tau is not positive.
    """
    if not tau > 0.0:
        raise TomThumbError(f"crumbs fade with a time constant > 0 steps, not {tau}")
    faded: Array = np.where(stones, 1.0, np.exp(-np.asarray(ages, dtype=float) / tau))
    return faded


def followed_length(loss: float, length: int) -> float:
    """Mean number of cells followed of a straight trail of `length` marks, each lost with chance `loss` on its own."""
    if loss == 0.0:
        return float(length)
    return (1.0 - loss) * (1.0 - (1.0 - loss) ** length) / loss
