"""Lengths of Lévy flights from a cumulative table and uniform numbers: array in, array out."""

from __future__ import annotations

from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def levy_length(cdf: Array, u: float) -> int:
    """The length 1..len(cdf) whose share of [0, 1) holds `u`; `cdf (L,)` ends in exactly 1.

    Most flights are short, so the search doubles its reach from 1 and then halves back: a few looks whatever L.
    """
    low, high = 0, 1  # the answer's index lies in [low, high)
    while high < cdf.shape[0] and cdf[high - 1] <= u:
        low, high = high, 2 * high
    if high > cdf.shape[0]:
        high = cdf.shape[0]
    while low < high:
        middle = (low + high) // 2
        if cdf[middle] <= u:
            low = middle + 1
        else:
            high = middle
    return low + 1 if low < cdf.shape[0] else cdf.shape[0]


@jit
def levy_lengths(cdf: Array, u: Array) -> Array:
    """`levy_length` of every uniform number of `u (n,)`; int64 (n,)."""
    lengths = np.empty(u.shape[0], np.int64)
    for i in range(u.shape[0]):
        lengths[i] = levy_length(cdf, u[i])
    return lengths
