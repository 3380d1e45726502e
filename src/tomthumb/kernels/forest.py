"""The tale's inner loops: marks of a trail, STDP changes, and the family's moves. Array in, array out.

What the associator shares with the forest stands here beside its callers: kernels that call one another share a file.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

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


# What a cell is; the ogre's house has the negative sign of the paper, the palace its special mark.
FREE, OGRE, MOUNTAIN, HOME, PALACE = 0, -1, 1, 2, 3
TORUS, REFLECT, CLIP = 0, 1, 2
HAT, CROWN = 1, -1


@jit
def fold(x: int, n: int, boundary: int) -> int:
    """Coordinate `x` brought onto 0..n-1: round the torus, mirrored at the edge, or held there."""
    if 0 <= x < n:
        return x
    if boundary == TORUS:
        return x % n
    if boundary == CLIP:
        return 0 if x < 0 else n - 1
    if n == 1:
        return 0
    x = x % (2 * n - 2)
    return x if x < n else 2 * n - 2 - x


@jit
def on_the_way(start: int, delta: int, i: int, steps: int) -> int:
    """Coordinate after `i` of `steps` unit moves of a straight flight by `delta`, rounded half up."""
    return start + (2 * i * delta + steps) // (2 * steps)


@jit
def sense(cells: Array, row: int, column: int, eyes: Array, wear: int, royal: bool, boundary: int) -> int:
    """What the window sees: HOME before the ogre before the palace, FREE for none of them.

    The sign of the wear times that of the cell decides: under a HAT (+1) the ogre's house is negative and is noticed,
    under a CROWN (-1) it is one of the family's own. `royal` says whether palaces count.
    """
    rows, columns = cells.shape
    found = FREE
    for i in range(3):
        for j in range(3):
            r, c = row + i - 1, column + j - 1
            if not eyes[i, j]:
                continue
            if boundary == TORUS:
                r, c = r % rows, c % columns
            elif not (0 <= r < rows and 0 <= c < columns):
                continue
            value = cells[r, c]
            if value == HOME:
                return HOME
            if value < 0 and value * wear < 0:
                found = OGRE
            elif value == PALACE and royal and found == FREE:
                found = PALACE
    return found


@jit
def unfaded(laid: int, tick: int, tau: float) -> float:
    """Strength of the mark whose `laid` is 0 (none), -1 (stone) or 1 + the tick of a crumb."""
    return mark_strength(float(tick + 1 - laid), tau, laid < 0) if laid != 0 else 0.0


@jit
def drop_mark(
    number: Array, laid: Array, r: int, c: int, step: int, tick: int, stone: bool, tau: float, low: float
) -> None:
    """Tom drops a stone or a crumb: the oldest number that can still be seen stays, the strength is new.

    Keeping the oldest is what makes a walk that crosses itself lead home: whoever stands on the mark of step n > 0 has
    in the window the mark of the step before, whose number is lower still.
    """
    if laid[r, c] == 0 or unfaded(laid[r, c], tick, tau) < low or step < number[r, c]:
        number[r, c] = step
    if stone:
        laid[r, c] = -1
    elif laid[r, c] >= 0:
        laid[r, c] = tick + 1


@jit
def recall(way: Array, touched: Array, r: int, c: int, tick: int, tau: float) -> None:
    """Bring the weights of a cell up to date: those learned with crumbs have faded since they were touched."""
    if touched[r, c] > 0:
        fade = math.exp(-(tick + 1 - touched[r, c]) / tau)
        for d in range(8):
            way[r, c, d] *= fade
        touched[r, c] = tick + 1


@jit
def direction_of(dr: int, dc: int) -> int:
    """0..7 for a unit offset, row by row through the window without its middle; -1 if it is no neighbour."""
    if abs(dr) > 1 or abs(dc) > 1 or (dr == 0 and dc == 0):
        return -1
    k = 3 * (dr + 1) + dc + 1
    return k if k < 4 else k - 1


@jit
def near(delta: int, n: int, boundary: int) -> int:
    """A difference of coordinates by the shorter way round."""
    return (delta + n // 2) % n - n // 2 if boundary == TORUS else delta


@jit
def learn_way(
    way: Array, touched: Array, recent: Array, at: int, tick: int, stone: bool, boundary: int, stdp: Array
) -> None:
    """Equation 3 on cells: the family enters the cell `recent[at]`; `recent (k, 3)` is a ring of (row, column, tick).

    way[r, c, d] is the synapse from the neighbour in direction d to the cell (r, c): "from there one comes here". The
    neighbours' traces are sums of exp(-age/tau) over the ring. `stdp` holds tau+, tau-, A+, A-, mu, tau of forgetting.
    """
    rows, columns = way.shape[0], way.shape[1]
    r, c = recent[at, 0], recent[at, 1]
    x, y = np.zeros(8), np.zeros(8)
    for k in range(recent.shape[0]):
        age = tick - recent[k, 2]
        if k == at or recent[k, 2] < 0:
            continue
        d = direction_of(near(recent[k, 0] - r, rows, boundary), near(recent[k, 1] - c, columns, boundary))
        if d >= 0:
            x[d] += math.exp(-age / stdp[0])
            y[d] += math.exp(-age / stdp[1])
    recall(way, touched, r, c, tick, stdp[5])
    for d in range(8):
        if x[d] > 0.0:
            k = d if d < 4 else d + 1
            nr, nc = fold(r + k // 3 - 1, rows, boundary), fold(c + k % 3 - 1, columns, boundary)
            way[r, c, d] = potentiate(way[r, c, d], x[d], stdp[2], stdp[4])
            recall(way, touched, nr, nc, tick, stdp[5])
            way[nr, nc, 7 - d] = depress(way[nr, nc, 7 - d], y[d], stdp[3], stdp[4])
    if stone:
        touched[r, c] = -1
    elif touched[r, c] >= 0:
        touched[r, c] = tick + 1


@jit
def march(
    cells: Array, number: Array, laid: Array, way: Array, touched: Array, recent: Array, counts: Array, place: Array,
    flights: Array, stone: bool, boundary: int, tau: float, low: float, stdp: Array, path: Array,
) -> int:  # fmt: skip
    """Steps 10 to 12: the parents lead on `flights (k, 2)`; marks are dropped and the way is learned at every cell.

    Mountains stop a flight. `counts` holds the tick, the step number since home, and the ring's cursor. With A+ and A-
    nought nothing is learned. Everything named so far but the flights is changed in place.
    Returns how many cells were written to `path (n, 2)`.
    """
    rows, columns = cells.shape
    entered = 0
    for f in range(flights.shape[0]):
        r0, c0, dr, dc = place[0], place[1], flights[f, 0], flights[f, 1]
        steps = max(abs(dr), abs(dc))
        for i in range(1, steps + 1):
            r = fold(on_the_way(r0, dr, i, steps), rows, boundary)
            c = fold(on_the_way(c0, dc, i, steps), columns, boundary)
            if cells[r, c] == MOUNTAIN:
                break
            place[0], place[1] = r, c
            counts[0] += 1
            counts[1] += 1
            drop_mark(number, laid, r, c, counts[1], counts[0], stone, tau, low)
            if stdp[2] > 0.0 or stdp[3] > 0.0:
                at = (counts[2] + 1) % recent.shape[0]
                recent[at, 0], recent[at, 1], recent[at, 2] = r, c, counts[0]
                counts[2] = at
                learn_way(way, touched, recent, at, counts[0], stone, boundary, stdp)
            path[entered, 0], path[entered, 1] = r, c
            entered += 1
    return entered


@jit
def follow(
    cells: Array, number: Array, laid: Array, counts: Array, place: Array, eyes: Array, boundary: int, tau: float,
    low: float, path: Array,
) -> tuple[int, int]:  # fmt: skip
    """Step 15: go to the window's mark with the highest lower number until HOME is seen or the trail has disappeared.
    Returns how many cells were written to `path (n, 2)`, n bounding the walk, and HOME or FREE.
    """
    rows, columns = cells.shape
    numbers, strong = np.empty(8, np.int64), np.empty(8)
    for i in range(path.shape[0]):
        r, c = place[0], place[1]
        if sense(cells, r, c, eyes, HAT, False, boundary) == HOME:
            return i, HOME
        for d in range(8):
            k = d if d < 4 else d + 1
            nr, nc = r + k // 3 - 1, c + k % 3 - 1
            inside = boundary == TORUS or (0 <= nr < rows and 0 <= nc < columns)
            nr, nc = fold(nr, rows, boundary), fold(nc, columns, boundary)
            strong[d] = unfaded(laid[nr, nc], counts[0], tau) if inside else 0.0
            numbers[d] = number[nr, nc] if inside and laid[nr, nc] != 0 else -1
        # whoever stands on a lost mark still remembers its number
        d = next_mark(numbers, strong, counts[1], low)
        if d < 0:
            return i, FREE
        k = d if d < 4 else d + 1
        place[0], place[1] = fold(r + k // 3 - 1, rows, boundary), fold(c + k % 3 - 1, columns, boundary)
        counts[0] += 1
        counts[1] = numbers[d]
        path[i, 0], path[i, 1] = place[0], place[1]
    return path.shape[0], sense(cells, place[0], place[1], eyes, HAT, False, boundary)


@jit
def learned_direction(way: Array, touched: Array, r: int, c: int, tick: int, tau: float, heat: float, u: float) -> int:
    """Neighbour drawn from exp(w / heat) over the ways that lead here, to walk back as learned; -1 if none is known."""
    fade = math.exp(-(tick + 1 - touched[r, c]) / tau) if touched[r, c] > 0 else 1.0
    top = 0.0
    for d in range(8):
        top = max(top, way[r, c, d] * fade)
    if top < 0.01:
        return -1
    total = 0.0
    for d in range(8):
        if way[r, c, d] > 0.0:
            total += math.exp((way[r, c, d] * fade - top) / heat)
    share, chosen = u * total, -1
    for d in range(8):
        if way[r, c, d] > 0.0:
            chosen = d
            share -= math.exp((way[r, c, d] * fade - top) / heat)
            if share < 0.0:
                break
    return chosen


@jit
def fly(cells: Array, place: Array, dr: int, dc: int, leap: bool, bare: bool, boundary: int) -> int:
    """One flight, `place (2,)` changed in place: stopped before the first mountain, or with `leap` before the last.

    Returns the distance in cells; `bare` says that there are no mountains, so the landing is known at once.
    """
    rows, columns = cells.shape
    r0, c0, steps = place[0], place[1], max(abs(dr), abs(dc))
    if bare:
        place[0], place[1] = fold(r0 + dr, rows, boundary), fold(c0 + dc, columns, boundary)
        return steps
    gone = 0
    for i in range(1, steps + 1):
        r = fold(on_the_way(r0, dr, i, steps), rows, boundary)
        c = fold(on_the_way(c0, dc, i, steps), columns, boundary)
        if cells[r, c] == MOUNTAIN:
            if not leap:
                break
        else:
            place[0], place[1], gone = r, c, i
    return gone


@jit
def stroll(
    cells: Array, place: Array, dr: int, dc: int, leap: bool, boundary: int, eyes: Array, wear: int, royal: bool
) -> tuple[int, int]:
    """One flight on foot: every cell on the way is sensed, and the family stops where something is seen."""
    rows, columns = cells.shape
    r0, c0, steps, gone = place[0], place[1], max(abs(dr), abs(dc)), 0
    for i in range(1, steps + 1):
        r = fold(on_the_way(r0, dr, i, steps), rows, boundary)
        c = fold(on_the_way(c0, dc, i, steps), columns, boundary)
        if cells[r, c] != MOUNTAIN:
            place[0], place[1], gone = r, c, i
            found = sense(cells, r, c, eyes, wear, royal, boundary)
            if found != FREE:
                return gone, found
        elif not leap:
            break
    return gone, sense(cells, place[0], place[1], eyes, wear, royal, boundary)


@jit
def wander(
    cells: Array, way: Array, touched: Array, counts: Array, place: Array, eyes: Array, flights: Array, luck: Array,
    wear: int, royal: bool, leap: bool, bare: bool, on_foot: bool, boundary: int, trust: float, heat: float, tau: float,
    path: Array,
) -> tuple[int, int, int]:  # fmt: skip
    """Steps 17 and 22: fly, or with chance `trust` walk back as learned, until the window sees something.

    Args:
        flights: displacements (k, 2); luck: uniform numbers (k, 2), whether to trust what was learned, and which way.
        leap: boots on: mountains do not stop a flight.
        on_foot: sense at every cell on the way (a walk), not only where one lands (a flight).
        path: filled with the place after each move (k, 2).

    Returns:
        Moves made, what was found (FREE: the flights ran out), and the distance in cells.
    """
    distance = 0
    for f in range(flights.shape[0]):
        dr, dc = flights[f, 0], flights[f, 1]
        if trust > 0.0 and luck[f, 0] < trust:
            d = learned_direction(way, touched, place[0], place[1], counts[0], tau, heat, luck[f, 1])
            if d >= 0:
                k = d if d < 4 else d + 1
                dr, dc = k // 3 - 1, k % 3 - 1
        counts[0] += 1
        if on_foot:
            gone, found = stroll(cells, place, dr, dc, leap, boundary, eyes, wear, royal)
        else:
            gone = fly(cells, place, dr, dc, leap, bare, boundary)
            found = sense(cells, place[0], place[1], eyes, wear, royal, boundary)
        distance += gone
        path[f, 0], path[f, 1] = place[0], place[1]
        if found != FREE:
            return f + 1, found, distance
    return flights.shape[0], FREE, distance


@jit
def learn_features(
    features: Array, path: Array, seen: Array, w: Array, x: Array, y: Array, stdp: Array, boundary: int
) -> None:
    """Step 12: features come into the window along `path (k, 2)`, and equation 3 ties each to those before.

    `features (n, m)` holds 0 (nothing) or 1..F; `seen (F,)` is what the window held before; `w (F, F)`, traces `x` and
    `y (F,)` belong to a PairMemory. All but the first two are changed in place.
    """
    rows, columns = features.shape
    now = np.empty(seen.shape[0], np.bool_)
    for p in range(path.shape[0]):
        now[:] = False
        for k in range(9):
            r, c = path[p, 0] + k // 3 - 1, path[p, 1] + k % 3 - 1
            if boundary == TORUS or (0 <= r < rows and 0 <= c < columns):
                feature = features[fold(r, rows, boundary), fold(c, columns, boundary)]
                if feature > 0:
                    now[feature - 1] = True
        x *= math.exp(-1.0 / stdp[0])
        y *= math.exp(-1.0 / stdp[1])
        pair_spikes(w, x, y, np.flatnonzero(now & ~seen), stdp[2], stdp[3], stdp[4])
        seen[:] = now
