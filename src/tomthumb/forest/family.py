"""The family and what it leaves behind: window, wallet and wear; marks on the ground; what the children learned."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from tomthumb.forest.rules import Rules
from tomthumb.forest.world import Cell, Forest
from tomthumb.kernels.forest import FREE, HAT, PALACE
from tomthumb.tale.stdp import PairMemory
from tomthumb.tale.window import PARENTS
from tomthumb.types import Array, Ids

Numbers = npt.NDArray[np.int32]
RING = 12  # cells the children still have in mind: four time constants of the traces


@dataclass(frozen=True)
class Family:
    """The family at one moment.

    Attributes:
        place: row and column of Tom, in the middle of the window.
        window: (3, 3), figure 3's cells: each carries the sign of the heads' wear, the parents' 0 once they fled.
        wear: HAT = +1 or CROWN = -1.
        alpha: step size; 1 on foot, the maximum with the boots on.
        wallet: what the kings gave; 0 is EMPTY.
    """

    place: Cell
    window: Array = field(default_factory=lambda: np.ones((3, 3)))
    wear: int = HAT
    alpha: float = 1.0
    wallet: float = 0.0

    def wearing(self, wear: int) -> Family:
        """The same heads under another wear (steps 9 and 20)."""
        return replace(self, wear=wear, window=np.where(self.window == 0.0, 0.0, float(wear)))

    def complete(self) -> Family:
        """Everybody together again at the start of an iteration."""
        return replace(self, window=np.full((3, 3), float(self.wear)))

    def without_parents(self) -> Family:
        """Step 14: zero the parents' cell."""
        window = self.window.copy()
        window[PARENTS] = 0.0
        return replace(self, window=window)


@dataclass(frozen=True)
class Ground:
    """What the kernels write into, one entry a cell: the trail and the learned ways. A run owns its own.

    Attributes:
        cells: the run's own copy of the forest's, for palaces that move.
        number: step number of the mark (n, m); `laid`: 0 no mark, -1 a stone, else 1 + the tick a crumb was laid at.
        way: (n, m, 8), weight of "from the neighbour in direction d one comes here"; `touched`: 0 never, -1 learned
            with stones, else 1 + the tick of the last change.
        recent: ring (RING, 3) of the last cells and ticks; `counts`: tick, step number since home, cursor of the ring.
        seen: features in the window just now (8,) or as many as there are.
        sights: the STDP memory of features.
    """

    cells: npt.NDArray[np.int8]
    number: Numbers
    laid: Numbers
    way: npt.NDArray[np.float32]
    touched: Numbers
    recent: Ids
    counts: Ids
    seen: npt.NDArray[np.bool_]
    sights: PairMemory

    @property
    def tick(self) -> int:
        """Unit steps on the trail and moves of the search since the tale began."""
        return int(self.counts[0])


def ground_of(forest: Forest, rules: Rules) -> Ground:
    """Untrodden ground. 45 bytes a cell at most; pages never trodden cost nothing."""
    kinds = max(1, int(forest.features.max(initial=0)))
    return Ground(
        cells=forest.cells.copy(),
        number=np.zeros(forest.shape, np.int32),
        laid=np.zeros(forest.shape, np.int32),
        way=np.zeros((*forest.shape, 8), np.float32),
        touched=np.zeros(forest.shape, np.int32),
        recent=np.full((RING, 3), -1, np.int64),
        counts=np.zeros(3, np.int64),
        seen=np.zeros(kinds, np.bool_),
        sights=PairMemory(kinds, rules.plasticity),
    )


def trail_strengths(ground: Ground, tau: float) -> Array:
    """Strength of the mark on every cell (n, m) as it is now, 0 where there is none."""
    ages = ground.tick + 1 - ground.laid
    strength = np.where(ground.laid < 0, 1.0, np.exp(-ages / tau))
    return np.where(ground.laid == 0, 0.0, strength)


def stdp_constants(rules: Rules) -> Array:
    """tau+, tau-, A+, A-, mu and the time constant of forgetting, as the kernels read them; nought where none learn."""
    p = rules.plasticity
    if p is None:
        return np.array([1.0, 1.0, 0.0, 0.0, 1.0, rules.forgetting])
    return np.array([p.tau_plus, p.tau_minus, p.a_plus, p.a_minus, p.mu, rules.forgetting])


def eaten(ground: Ground, cells: Ids, birds: float, rng: np.random.Generator) -> int:
    """The birds eat each crumb on `cells (k, 2)` with chance `birds`; stones stay. How many were eaten."""
    if birds == 0.0 or not len(cells):
        return 0
    flat = np.unique(np.ravel_multi_index((cells[:, 0], cells[:, 1]), ground.laid.shape))
    laid = ground.laid.reshape(-1)
    lost = flat[(laid[flat] > 0) & (rng.random(flat.size) < birds)]
    laid[lost] = 0
    return int(lost.size)


def drift(cells: npt.NDArray[np.int8], palaces: Ids, rng: np.random.Generator) -> Ids:
    """Every palace goes one cell in a random direction, where that is free; its new places (p, 2)."""
    moved = palaces.copy()
    for k, (row, column) in enumerate(palaces):
        dr, dc = rng.integers(-1, 2, 2)
        there = (int(row + dr) % cells.shape[0], int(column + dc) % cells.shape[1])
        if cells[there] == FREE:
            cells[row, column], cells[there] = FREE, PALACE
            moved[k] = there
    return moved


def palace_in_window(palaces: Ids, place: Cell, shape: tuple[int, int]) -> int:
    """Index of the palace nearest to `place`, the shorter way round."""
    gap = np.abs(palaces - np.array(place))
    gap = np.minimum(gap, np.array(shape) - gap)
    return int(np.argmin(gap.max(axis=1)))


def is_empty(wallet: float, enough: float) -> bool:
    """Step 6: whether the wallet still counts as EMPTY; INFINITY never does."""
    return wallet <= enough and not math.isinf(wallet)
