"""Exact values of random search on the torus: hitting times by Fourier sum and by linear solve, and figure 4's odds.

These are what the simulated family is tested against. A law of flights is its step table `p (n, n)`: the probability
of landing (row, column) cells further, both modulo n.

References:
    Lovász, Random walks on graphs: a survey (1993), section 3 (the spectral form of the hitting time).
    Guinard and Korman, Intermittent inverse-square Lévy walks are optimal for finding targets of all sizes (2021).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.tale.levy import LengthLaw
from tomthumb.types import Array, Ids, Mask

EIGHT = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)])
FOUR = np.array([(-1, 0), (0, -1), (0, 1), (1, 0)])
# A dense solve beyond this many cells would need more than 1 GiB.
_MOST_CELLS = 10_000

Cell = tuple[int, int]


def step_table(law: LengthLaw, n: int, directions: Ids = EIGHT) -> Array:
    """Probability (n, n) of each displacement of one flight on a torus of side n, directions equally likely."""
    table = np.zeros((n, n))
    lengths = np.arange(1, law.l_max + 1)
    for row, column in directions:
        np.add.at(table, ((lengths * row) % n, (lengths * column) % n), law.pmf / len(directions))
    return table


def hitting_one_cell(table: Array) -> float:
    """Mean flights from a uniform start until one given cell is landed on: the sum over k != 0 of 1 / (1 - p(k))."""
    eigenvalues = np.fft.fft2(table).real.ravel()[1:]
    return float((1.0 / (1.0 - eigenvalues)).sum())


def transition(table: Array) -> Array:
    """Transition matrix (n n, n n), cells row by row.

    Raises:
        TomThumbError: the torus is too large for a dense matrix.
    """
    n = len(table)
    if n * n > _MOST_CELLS:
        raise TomThumbError(f"the linear solve is for at most {_MOST_CELLS} cells, not {n} x {n}")
    rows, columns = np.divmod(np.arange(n * n), n)
    P: Array = table[(rows[None, :] - rows[:, None]) % n, (columns[None, :] - columns[:, None]) % n]
    return P


def window_cells(n: int, place: Cell) -> Mask:
    """The cells (n n,) from whose 3 x 3 window `place` is seen, on a torus."""
    seen = np.zeros((n, n), bool)
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            seen[(place[0] + row) % n, (place[1] + column) % n] = True
    return seen.ravel()


def hitting(P: Array, targets: Mask) -> Array:
    """Mean flights (k,) from every cell until one of `targets (k,)` is landed on: (I - P) t = 1 solved elsewhere."""
    times = np.zeros(len(P))
    rest = ~targets
    inside = P[np.ix_(rest, rest)]
    times[rest] = np.linalg.solve(np.eye(len(inside)) - inside, np.ones(len(inside)))
    return times


def first_reached(P: Array, targets: Mask, others: Mask) -> tuple[Array, Array]:
    """Where a walk that ends in `targets` or `others` ends: chance (k,) of `targets` by start, and the chances by cell.

    Returns:
        `chance (k,)`, and `landing (k, k)`: landing[s, c] is the chance that the walk from s ends at target cell c.
    """
    stop = targets | others
    rest = ~stop
    landing = np.zeros_like(P)
    landing[targets, targets] = 1.0
    inside = P[np.ix_(rest, rest)]
    landing[np.ix_(rest, targets)] = np.linalg.solve(np.eye(len(inside)) - inside, P[np.ix_(rest, targets)])
    return landing.sum(axis=1), landing


@dataclass(frozen=True)
class LoopOdds:
    """One pass of figure 4's WHILE: the chance of the ogre before home, and of the king's award."""

    ogre: float
    success: float

    @property
    def iterations(self) -> float:
        """Mean number of passes until the award: each is a new, independent try."""
        return 1.0 / self.success


def loop_odds(walk: Array, boots: Array, home: Cell, ogre: Cell, king: Cell, outward: int) -> LoopOdds:
    """Odds of steps 10 to 25 on a bare torus: `outward` flights that do not sense, then, crumbs all eaten, a search.

    The place where the parents flee is sensed first. Home, ogre and king are seen through the 3 x 3 window.

    Args:
        walk: step table (n, n) of the family on foot.
        boots: step table (n, n) with the magic boots on.
    """
    n = len(walk)
    P = transition(walk)
    seen = [window_cells(n, place) for place in (home, ogre, king)]
    start = np.zeros((n, n))
    start[home] = 1.0
    spectrum = np.fft.fft2(walk) ** outward
    fled = np.fft.ifft2(np.fft.fft2(start) * spectrum).real.ravel()
    chance, landing = first_reached(P, seen[1], seen[0])
    award, _ = first_reached(transition(boots), seen[2], seen[0])
    return LoopOdds(ogre=float(fled @ chance), success=float(fled @ landing @ award))
