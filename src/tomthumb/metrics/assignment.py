"""The best one-to-one assignment of a sparse table, piece by connected piece."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tomthumb.types import Array, Ids, Mask


def best_assignment(left: Ids, right: Ids, gain: Array) -> tuple[Mask, float]:
    """Which of the entries (left (e,), right (e,), gain (e,) > 0) to keep, no node twice, for the largest total gain.

    Nodes are numbered from 0 on each side. Exact: the table falls into connected pieces, each solved by itself, so that
    ten thousand landmarks cost no more than their crowded corners.
    """
    keep = np.zeros(len(gain), bool)
    if not len(gain):
        return keep, 0.0
    n_left = int(left.max()) + 1
    size = n_left + int(right.max()) + 1
    graph = coo_matrix((np.ones(len(gain)), (left, right + n_left)), shape=(size, size))
    piece = connected_components(graph, directed=False)[1][left]
    order = np.argsort(piece, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1):
        keep[rows[_solve(left[rows], right[rows], gain[rows])]] = True
    return keep, float(gain[keep].sum())


def _solve(left: Ids, right: Ids, gain: Array) -> Ids:
    """Positions of the entries kept in one connected piece."""
    if len(gain) == 1:
        return np.zeros(1, np.int64)
    rows, i = np.unique(left, return_inverse=True)
    cols, j = np.unique(right, return_inverse=True)
    table = np.zeros((len(rows), len(cols)))
    entry = np.full(table.shape, -1, np.int64)
    table[i, j], entry[i, j] = gain, np.arange(len(gain))
    chosen: Ids = entry[linear_sum_assignment(table, maximize=True)]
    return chosen[chosen >= 0]
