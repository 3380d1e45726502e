"""Simulated Tom Thumb names the landmarks: the joint posterior, searched by the family.

    0  window      candidates of each observation
    1  quick path  a scan without ambiguity is done at once (branch and bound then takes one node an observation)
    2  anchored flights: pairs of observations give poses, the others vote; the best basins are refined
    3  Levy flights inside a basin: ruin r related pairs, force an alternative, complete again
    4  boots: stagnation makes the ruins larger
    5  certificate: branch and bound from the incumbent within a budget: "optimal" (award INFINITY), or "truncated"
    6  ambiguity: hypotheses within a few nats live on as brothers

The decision is not the single most probable hypothesis but the most probable partner of each observation, over all
hypotheses met: that is what maximises the expected number of right decisions, and it gives each its confidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from tomthumb.associators.tom_thumb.scene import Rigid, Window, base_gains, permitted, rigid, weighed, window
from tomthumb.kernels import flights, posterior
from tomthumb.protocols import Rng
from tomthumb.tale.levy import power_law
from tomthumb.tale.stdp import LogMemory
from tomthumb.types import Array, Association, AssociationProblem, Ids, Lessons

SMALL = 30  # observations up to which the certificate is tried first
POLISHED = 4  # basins, best first, whose assignment is made optimal


@dataclass(frozen=True, slots=True)
class Basin:
    """One pose basin: its best hypothesis, L, and the gains of all listed pairings given the others.

    `pose (3,)` and its inverse covariance `M (3, 3)` where the search went over poses.
    """

    match: Ids
    value: float
    gains: Array
    window: Window
    pose: Array | None = None
    M: Array | None = None


@dataclass(slots=True)
class TomThumb:
    """The STT associator. Every number's reason is in docs/stt.md.

    gates: the first, where it is the narrower, chooses the pose basin; the second completes it. nodes: budget of the
    certificate. flights, patience, exponent: Levy flights in a basin. anchors, basins, poses: anchored flights and their
    budgets. brothers: hypotheses returned at most (use with `slam.width`), `ambiguity` nats: how far behind the best they may be.
    least: a pairing less probable than this is left unpaired. decide: "marginal" (most probable partner of each) or "map"
    (most probable hypothesis). samples: poses drawn, over all basins, to integrate the pose out, when a decision is not `sure`
    or there are several basins within `reach` nats. hard: mean number of candidates from which pose basins are searched.
    memory: weigh candidates by who was seen with whom (STDP) in the last `recent` s, within `clip` nats; at most `size`
    landmarks are remembered.
    """

    gates: tuple[float, float] = (1.0 - 1e-6, 1.0 - 1e-6)
    nodes: int = 2000
    flights: int = 60
    patience: int = 15
    exponent: float = 1.5
    anchors: int = 15
    basins: int = 12
    poses: int = 200_000
    brothers: int = 1
    ambiguity: float = 3.0
    least: float = 0.0
    decide: str = "marginal"
    samples: int = 48
    reach: float = 7.0
    sure: float = 0.98
    hard: float = 1.5
    memory: bool = False
    recent: float = 3.0
    clip: float = 2.0
    size: int = 1000
    lessons: LogMemory = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.lessons = LogMemory(self.recent, clip=self.clip, size=self.size)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64), info={"proof": "optimal", "nodes": 0}, confidence=np.ones(m))]
        prior = self.lessons.prior(problem.predictions.ids, problem.t) if self.memory else None
        base, odds = base_gains(problem, prior)
        near = window(problem.weighed_d2, self.gates[1])
        table = weighed(base[:, None] + odds[None], problem.evidence)
        found: list[Basin] = []
        info: dict[str, Any] = {"proof": "truncated"}
        if self._is_small(near):
            found, info = self._within(problem, near, table, rng)
        scene = rigid(problem, base, odds) if self._is_hard(near) else None
        if scene is not None and info["proof"] != "optimal":
            found, info = self._anchored(scene, near)
        elif scene is not None:
            found = [self._at_pose(scene, b.match, near) for b in found]
        if not found:
            found, info = self._within(problem, near, table, rng)
        return self._decided(found, n, info, scene, rng)

    def learn(self, ids: Ids, t: float) -> None:
        """See `protocols.Associator`: who is seen after whom, as a log prior for the next scans."""
        if self.memory:
            self.lessons.learn(ids, t)

    def recall(self, ids: Ids) -> Lessons | None:
        """See `protocols.Learner`."""
        return self.lessons.recall(ids) if self.memory else None

    def remind(self, lessons: Lessons) -> None:
        """See `protocols.Learner`."""
        self.lessons.remind(lessons)

    def _is_hard(self, near: Window) -> bool:
        """More than one candidate for most observations, or a large scan: pose basins matter."""
        m = len(near.counts)
        return m >= 3 and (float(near.counts.mean()) > self.hard or m > SMALL)

    def _is_small(self, near: Window) -> bool:
        """Small enough for the certificate: it comes first there, and settles most scans."""
        return len(near.counts) <= SMALL and float(near.counts.mean()) <= 8.0

    # --- 2: anchored flights ------------------------------------------------------------------------------------

    def _anchored(self, s: Rigid, near: Window) -> tuple[list[Basin], dict[str, Any]]:
        """Poses from anchors, refined; one basin for each distinct pose."""
        noise = s.R + s.D.mean(0)
        pairs, tolerance = anchor_pairs(s.q, near.counts, noise, self.anchors)
        spread = 3.0 * noise  # an anchor's pose is itself uncertain by about the noise of two observations
        inverse = np.linalg.inv(spread)
        packed = np.ascontiguousarray(np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1))
        top = float(s.odds.max())
        gain = s.base + top - 0.5 * np.log(np.linalg.det(noise)) - posterior.LOG_2PI
        reach = np.sqrt(2.0 * np.maximum(gain, 1.0) * np.linalg.eigvalsh(spread)[:, 1])
        cell = float(reach.max())
        grid = flights.fill_grid(s.p, cell)
        Xi_inverse: Array = np.asarray(np.linalg.inv(s.Xi), np.float64)
        apart = np.array(
            [
                2.0 * np.sqrt(np.trace(noise.mean(0))),
                2.0 * np.sqrt(np.trace(noise.mean(0))) / max(np.abs(s.q).max(), 1e-9),
            ]
        )
        limit = chdtri(3, 1.0 - self.gates[1])
        poses, scores, tried, used = flights.explore(
            s.q, packed, gain, pairs, tolerance, near.start, near.columns, s.p, s.odds - top,
            Xi_inverse, limit, cell, *grid, apart, self.basins, self.poses,
        )  # fmt: skip
        poses = np.concatenate([np.zeros((1, 3)), poses[np.isfinite(scores) & (scores > scores[0] - 15.0)]])
        found = distinct([self._basin(s, pose, cell, grid, Xi_inverse) for pose in poses], self.reach)
        found = [*(untangled(s, b, Xi_inverse) for b in found[:POLISHED]), *found[POLISHED:]]
        return found, {"poses": tried, "anchors": used, "proof": "truncated"}

    def _basin(self, s: Rigid, pose: Array, cell: float, grid: Any, Xi_inverse: Array) -> Basin:
        gate2 = float(chdtri(2, 1.0 - self.gates[1]))
        reach = np.sqrt(gate2 * np.linalg.eigvalsh(s.R + 3.0 * s.D.mean(0))[:, 1])
        near = permitted(*flights.local_candidates(pose, s.q, 1.5 * reach, s.p, cell, *grid), s.allowed)
        start, columns = near.start, near.columns
        args = (s.q, s.R, s.p, s.D, s.base, s.odds)
        at, M, match, value = flights.refine(pose, *args, Xi_inverse, start, columns, gate2, 3)
        gains = flights.left_out_gains(at, M, match, *args, start, columns, gate2) + s.of_looks(near)
        return Basin(match, value + s.of_match(match), gains, near, at, M)

    def _at_pose(self, s: Rigid, match: Ids, near: Window) -> Basin:
        """A hypothesis from the full covariance, with the pose that it implies."""
        gate2 = float(chdtri(2, 1.0 - self.gates[1]))
        args = (s.q, s.R, s.p, s.D, s.base, s.odds)
        at, M, value = flights.fit(np.zeros(3), match, *args, np.linalg.inv(s.Xi), 4)
        gains = flights.left_out_gains(at, M, match, *args, near.start, near.columns, gate2) + s.of_looks(near)
        return Basin(match, value + s.of_match(match), gains, near, at, M)

    # --- 1, 3, 5: on the full covariance --------------------------------------------------------------------------

    def _within(
        self, problem: AssociationProblem, near: Window, base: Array, rng: Rng
    ) -> tuple[list[Basin], dict[str, Any]]:
        """Greedy, certificate, and Levy flights where the certificate's budget did not suffice."""
        nu, R = problem.innovation, problem.R
        C = np.ascontiguousarray(problem.predictions.cov)
        m = len(nu)
        gate2 = float(chdtri(2, 1.0 - self.gates[1]))
        args = (nu, C, R, base, near.start, near.columns)
        first, value = posterior.complete(np.full(m, -1, np.int64), *args, gate2)
        bound = most_possible(near, base, R)
        order = np.argsort(near.counts, kind="stable")
        ranked = _reordered(near, order)
        pool, pool_value = np.full((8, m), -1, np.int64), np.full(8, -np.inf)
        free = np.full(m + 1, np.inf)
        nodes, proven = posterior.search(
            nu, C, R, base, bound, order, ranked.start, ranked.columns, free, first, value, self.ambiguity, self.nodes,
            pool, pool_value,
        )  # fmt: skip
        flown = 0
        if not proven and self.flights and not self._is_hard(near):
            lengths = power_law(self.exponent, m).draw(rng, self.flights)
            pool[0], pool_value[0], flown = posterior.ruin(
                pool[0], pool_value[0], *args, gate2, lengths, rng.random((self.flights, 2)), self.patience
            )
        core = self._core(pool[0], problem, C, base, bound, order, ranked)
        if core is not None:
            match, total = posterior.complete(core, *args, gate2)
            if not np.array_equal(match, pool[0]):  # the best is in a pose basin that the first gate rules out
                only = Basin(match, total, posterior.left_out_gains(match, *args), near)
                return [only], {"nodes": nodes, "flights": flown, "proof": "first gate"}
        keep = np.flatnonzero(pool_value > pool_value[0] - self.ambiguity)
        found = [Basin(pool[k], pool_value[k], posterior.left_out_gains(pool[k], *args), near) for k in keep[:4]]
        return found, {"nodes": nodes, "flights": flown, "proof": "optimal" if proven else "truncated"}

    def _core(
        self, best: Ids, problem: AssociationProblem, C: Array, base: Array, bound: Array, order: Ids, ranked: Window
    ) -> Ids | None:
        """Where the best hypothesis fails the joint test at the first gate: the best that passes it, if of two pairs or more.

        That choice is of the pose basin; the second gate then completes it, so the first costs no pairs by itself.
        """
        if self.gates[0] >= self.gates[1]:
            return None
        m = len(best)
        gates2 = chdtri(2.0 * np.arange(m + 1), 1.0 - self.gates[0])
        gates2[0] = np.inf
        _, d2, pairs = posterior.value_of(best, problem.innovation, C, problem.R, base)
        if d2 < gates2[pairs]:
            return None
        pool, value = np.full((1, m), -1, np.int64), np.zeros(1)
        posterior.search(
            problem.innovation, C, problem.R, base, bound, order, ranked.start, ranked.columns, gates2,
            np.full(m, -1, np.int64), 0.0, 0.0, self.nodes, pool, value,
        )  # fmt: skip
        return pool[0] if np.count_nonzero(pool[0] >= 0) >= 2 else None

    # --- 6: decision -----------------------------------------------------------------------------------------------

    def _decided(
        self, found: list[Basin], n: int, info: dict[str, Any], scene: Rigid | None, rng: Rng
    ) -> Sequence[Association]:
        found = distinct(found, self.reach)
        best = found[0]
        info = {**info, "objective": best.value, "basins": len(found)}
        weights = np.exp(np.array([b.value for b in found]) - best.value)
        p, none = mixed_marginals(found, weights / weights.sum(), n)
        if scene is not None and self.samples and (len(found) > 1 or np.maximum(p.max(1), none).min() < self.sure):
            share = max(8, self.samples // len(found))
            p, none = sampled_marginals(found, scene, n, share, float(chdtri(2, 1.0 - self.gates[1])), rng)
        match = best.match if self.decide == "map" else most_probable(p, none, self.least)
        chance = np.where(match >= 0, p[np.arange(len(match)), np.maximum(match, 0)], none)
        first = Association(match, best.value, info, chance)
        return [first, *self._brothers(found[1:], best.value, match)]

    def _brothers(self, others: list[Basin], best: float, match: Ids) -> list[Association]:
        """Other hypotheses that are nearly as good, to be carried on until later scans decide."""
        near = [b for b in others if b.value > best - self.ambiguity and not np.array_equal(b.match, match)]
        return [Association(b.match, b.value, {"brother": k + 1}) for k, b in enumerate(near[: self.brothers - 1])]


def untangled(s: Rigid, basin: Basin, Xi_inverse: Array) -> Basin:
    """The basin with the best assignment at its pose, and the pose of that, until it stays: greedy leaves pairs swapped."""
    if basin.pose is None or basin.M is None:
        return basin
    args = (s.q, s.R, s.p, s.D, s.base, s.odds)
    still, near, pose = np.zeros((3, 3)), basin.window, basin.pose
    best, M = basin, basin.M
    for _ in range(3):
        gains = flights.pose_gains(pose, still, *args, near.start, near.columns, np.inf) + s.of_looks(near)
        match = assigned(gains, near)
        if np.array_equal(match, best.match):
            break
        pose, M, value = flights.fit(pose, match, *args, Xi_inverse, 2)
        value += s.of_match(match)
        if value <= best.value:
            break
        left = flights.left_out_gains(pose, M, match, *args, near.start, near.columns, np.inf) + s.of_looks(near)
        best = Basin(match, value, left, near, pose, M)
    return best


def assigned(gains: Array, near: Window) -> Ids:
    """The one-to-one match of greatest total gain over the listed pairings; a pairing without gain is left out."""
    m = len(near.counts)
    names, place = np.unique(near.columns, return_inverse=True)
    table = np.zeros((m, len(names)))
    table[np.repeat(np.arange(m), near.counts), place] = np.maximum(gains, 0.0)
    rows, picked = linear_sum_assignment(table, maximize=True)
    match = np.full(m, -1, np.int64)
    good = table[rows, picked] > 0.0
    match[rows[good]] = names[picked[good]]
    return match


def anchor_pairs(q: Array, counts: Ids, noise: Array, most: int) -> tuple[Ids, Array]:
    """Pairs of observations to anchor on, few candidates and long baseline first, each used at most three times.

    Returns (a, 2) indices and the tolerance (a,) m on their distance: 3.5 sigma of the two.
    """
    a, b = np.triu_indices(len(q), 1)
    work = counts[a].astype(float) * counts[b]
    length = np.hypot(*(q[a] - q[b]).T)
    spread = np.sqrt(np.linalg.eigvalsh(noise)[:, 1])
    useful = np.flatnonzero((work > 0) & (length > 3.0 * (spread[a] + spread[b])))
    rank = np.log(work[useful]) - 2.0 * np.log(length[useful])
    times, chosen = np.zeros(len(q), np.int64), []
    for k in useful[np.argsort(rank, kind="stable")]:
        if times[a[k]] < 3 and times[b[k]] < 3:
            times[a[k]] += 1
            times[b[k]] += 1
            chosen.append(k)
            if len(chosen) == most:
                break
    picked = np.array(chosen, np.int64)
    pairs = np.column_stack([a[picked], b[picked]])
    return pairs, 3.5 * np.hypot(spread[a[picked]], spread[b[picked]])


def most_possible(near: Window, base: Array, R: Array) -> Array:
    """Upper bound (m,) of what each observation can add to L: the best base gain at a perfect fit, S no less than R."""
    perfect = -0.5 * np.log(np.linalg.det(R)) - posterior.LOG_2PI
    best = np.array(
        [
            base[i, near.columns[a:b]].max() if b > a else 0.0
            for i, (a, b) in enumerate(zip(near.start, near.start[1:], strict=False))
        ]
    )
    most: Array = np.maximum(best + perfect, 0.0)
    return most


def _reordered(near: Window, order: Ids) -> Window:
    parts = [near.columns[near.start[i] : near.start[i + 1]] for i in order]
    start = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int64)
    return Window(start, np.concatenate(parts) if parts else near.columns)


def distinct(found: list[Basin], reach: float) -> list[Basin]:
    """Basins within `reach` nats of the best, best first, each hypothesis once."""
    ranked = sorted(found, key=lambda b: -b.value)
    kept: list[Basin] = []
    for basin in ranked:
        if basin.value < ranked[0].value - reach:
            break
        if not any(np.array_equal(basin.match, other.match) for other in kept):
            kept.append(basin)
    return kept


def mixed_marginals(found: list[Basin], weights: Array, n: int) -> tuple[Array, Array]:
    """Probability of each pairing (m, n) and of staying unpaired (m,), over all basins."""
    m = len(found[0].match)
    p, none = np.zeros((m, n)), np.zeros(m)
    for basin, weight in zip(found, weights, strict=True):
        if weight < 1e-4:
            continue
        near = basin.window
        chance, alone, _ = posterior.marginals(basin.gains, near.start, near.columns, n, 50)
        np.add.at(p, (np.repeat(np.arange(m), near.counts), near.columns), weight * chance)
        none += weight * alone
    return p, none


def sampled_marginals(
    found: list[Basin], s: Rigid, n: int, samples: int, gate2: float, rng: Rng
) -> tuple[Array, Array]:
    """The same with the pose integrated out by importance sampling: given the pose, the pairings are independent.

    Poses are drawn from a mixture of the basins' Gaussians, widened by half; each is weighed by its prior times the sum
    over all assignments (Bethe), divided by the mixture's density (deterministic mixture weights).
    """
    Xi_inverse = np.linalg.inv(s.Xi)
    known = [(b.pose, b.M) for b in found if b.pose is not None and b.M is not None]
    centres = [pose for pose, _ in known]
    factors: list[Array] = [1.5 * np.linalg.cholesky(np.linalg.inv(M)) for _, M in known]
    m, p, none = len(s.q), np.zeros((len(s.q), n)), np.zeros(len(s.q))
    parts, logs = [], []
    still = np.zeros((3, 3))
    for b, factor, centre in zip(found, factors, centres, strict=True):
        near = b.window
        for step in rng.standard_normal((samples, 3)):
            pose = centre + factor @ step
            gains = flights.pose_gains(pose, still, s.q, s.R, s.p, s.D, s.base, s.odds, near.start, near.columns, gate2)
            gains += s.of_looks(near)
            chance, alone, log_z = posterior.marginals(gains, near.start, near.columns, n, 10)
            density = _mixture(pose, centres, factors)
            parts.append((near, chance, alone))
            logs.append(flights.log_prior(pose, Xi_inverse) + log_z - density)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    for weight, (near, chance, alone) in zip(weights, parts, strict=True):
        if weight > 1e-5:
            np.add.at(p, (np.repeat(np.arange(m), near.counts), near.columns), weight * chance)
            none += weight * alone
    return p, none


def _mixture(pose: Array, centres: list[Array], factors: list[Array]) -> float:
    """Log density of an equal mixture of Gaussians given by centres and Cholesky factors, but for a constant."""
    logs = []
    for centre, factor in zip(centres, factors, strict=True):
        y = np.linalg.solve(factor, pose - centre)
        logs.append(-0.5 * float(y @ y) - float(np.log(np.diag(factor)).sum()))
    top = max(logs)
    return top + float(np.log(np.mean(np.exp(np.array(logs) - top))))


def most_probable(p: Array, none: Array, least: float) -> Ids:
    """The one-to-one assignment that maximises the expected number of right decisions."""
    match = np.full(len(p), -1, np.int64)
    columns = np.flatnonzero((p > max(least, 1e-3)).any(0))
    if not len(columns):
        return match
    gain = np.where(p[:, columns] > least, p[:, columns] - none[:, None], 0.0)
    rows, picked = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
    good = gain[rows, picked] > 0.0
    match[rows[good]] = columns[picked[good]]
    return match
