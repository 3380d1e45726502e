"""The tale's inner loops: marks of a trail, STDP changes, and the family's moves. Array in, array out.

What the associator shares with the forest (marks, pair rule) stands here beside its callers, because kernels that call
one another live in one file.
"""

from __future__ import annotations

import math
from typing import Any

from tomthumb.kernels.jit import jit

Array = Any


@jit
def mark_strength(age: float, tau: float, stone: bool) -> float:
    """Strength in [0, 1] of a mark laid `age` steps ago: a stone keeps 1, a crumb fades by exp(-1/tau) a step."""
    return 1.0 if stone else math.exp(-age / tau)


@jit
def next_mark(numbers: Array, strengths: Array, current: int, floor: float) -> int:
    """Index of the mark with the highest number below `current` among those at least `floor` strong; -1 if none.

    `numbers (k,)` are the step numbers at which the marks were laid (-1 no mark), `strengths (k,)` in [0, 1].
    """
    best, best_number = -1, -1
    for k in range(numbers.shape[0]):
        if best_number < numbers[k] < current and strengths[k] >= floor:
            best, best_number = k, numbers[k]
    return best


@jit
def potentiate(w: Any, x: Any, a_plus: float, mu: float) -> Any:
    """w + A+ (1 - w)^mu x, at most 1: the post-synaptic spike, x the trace of the pre-synaptic one."""
    return min(1.0, w + a_plus * x * (1.0 - w) ** mu)


@jit
def depress(w: Any, y: Any, a_minus: float, mu: float) -> Any:
    """w - A- w^mu y, at least 0: the pre-synaptic spike, y the trace of the post-synaptic one."""
    return max(0.0, w - a_minus * y * w**mu)


@jit
def pair_spikes(w: Array, x: Array, y: Array, neurons: Array, a_plus: float, a_minus: float, mu: float) -> None:
    """Spikes at one moment in a dense memory `w (n, n)`, w[i, j] from pre j to post i; changes w, x and y in place.

    Traces `x (n,)` (as pre) and `y (n,)` (as post) are as they stand now, already decayed; the spikes' own traces are
    added last, so nobody learns from itself nor from whoever spikes in the same moment.
    """
    for neuron in neurons:
        for j in range(w.shape[0]):
            if j != neuron:
                w[neuron, j] = potentiate(w[neuron, j], x[j], a_plus, mu)
                w[j, neuron] = depress(w[j, neuron], y[j], a_minus, mu)
    for neuron in neurons:
        x[neuron] += 1.0
        y[neuron] += 1.0
