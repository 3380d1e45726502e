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
from scipy.special import chdtri

from tomthumb.associators.tom_thumb.basins import Basin, Budget, anchored, at_pose, distinct
from tomthumb.associators.tom_thumb.decision import chances, mixed_marginals, most_probable, sampled_marginals
from tomthumb.associators.tom_thumb.scene import Rigid, Window, base_gains, rigid, weighed, window
from tomthumb.kernels import posterior
from tomthumb.kernels.left_out import left_out_gains
from tomthumb.protocols import Rng
from tomthumb.tale.levy import power_law
from tomthumb.tale.stdp import LogMemory
from tomthumb.types import Array, Association, AssociationProblem, Ids, Lessons

SMALL, FEW = 30, 8.0  # observations, and mean number of candidates, up to which the certificate is tried first
POOL = 8  # hypotheses that the certificate remembers
NOTHING_YET: dict[str, Any] = {"proof": "truncated"}


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
    lessons: LogMemory = field(default=None, repr=False)  # type: ignore[assignment]  # made below; a copy takes it along

    def __post_init__(self) -> None:
        if self.lessons is None:
            self.lessons = LogMemory(self.recent, clip=self.clip, size=self.size)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64), info={"proof": "optimal", "nodes": 0}, confidence=np.ones(m))]
        prior = self.lessons.prior(problem.predictions.ids, problem.t) if self.memory else None
        own, odds = base_gains(problem, prior)
        near = window(problem.weighed_d2, self.gates[1])
        base = weighed(own[:, None] + odds, problem.evidence)
        found, info = self._within(problem, near, base, rng) if self._is_small(near) else ([], NOTHING_YET)
        if not self._is_hard(near):
            found, info = (found, info) if found else self._within(problem, near, base, rng)
            return self._decided(found, info, *mixed_marginals(found, n))
        if info["proof"] == "optimal" and len(found) == 1:
            p, none = mixed_marginals(found, n)
            if self._is_sure(p, none):
                return self._decided(found, info, p, none)
        return self._over_poses(problem, near, base, found, info, rigid(problem, own, odds), rng)

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
        m = len(near.start) - 1
        return m >= 3 and (near.start[-1] > self.hard * m or m > SMALL)

    def _is_small(self, near: Window) -> bool:
        """Small enough for the certificate: it comes first there, and settles most scans."""
        m = len(near.start) - 1
        return bool(m <= SMALL and near.start[-1] <= FEW * m)

    def _is_sure(self, p: Array, none: Array) -> bool:
        """Every decision is so probable that it need not be looked at more closely."""
        return float(np.maximum(p.max(1), none).min()) >= self.sure

    # --- 2: over the poses ----------------------------------------------------------------------------------------

    def _over_poses(
        self, problem: AssociationProblem, near: Window, base: Array, found: list[Basin], info: dict[str, Any],
        scene: Rigid | None, rng: Rng,
    ) -> Sequence[Association]:  # fmt: skip
        """Pose basins where the certificate has not settled the scan, and the decision with the pose integrated out."""
        m, n = problem.shape
        gate2, gate3 = (float(chdtri(dof, 1.0 - self.gates[1])) for dof in (2, 3))
        if scene is None:
            found, info = (found, info) if found else self._within(problem, near, base, rng)
            return self._decided(found, info, *mixed_marginals(found, n))
        exact = found[0] if found else None
        if info["proof"] == "optimal":
            found = [at_pose(scene, b, gate2) for b in found]
        else:
            budget = Budget(self.anchors, self.basins, self.poses, self.reach)
            found, info = anchored(scene, near, gate2, gate3, budget)
        if self.decide == "map":
            pass
        found = distinct(found, self.reach)
        p, none = mixed_marginals(found, n)
        if self.samples and (len(found) > 1 or not self._is_sure(p, none)):
            p, none = sampled_marginals(found, scene, max(8, self.samples // len(found)), gate2, rng)
        return self._decided(found, info, p, none)

    # --- 1, 3, 5: on the full covariance --------------------------------------------------------------------------

    def _within(
        self, problem: AssociationProblem, near: Window, base: Array, rng: Rng
    ) -> tuple[list[Basin], dict[str, Any]]:
        """Greedy, certificate, and Levy flights where the certificate's budget did not suffice."""
        given = (problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, base)
        gate2 = float(chdtri(2, 1.0 - self.gates[1]))
        pool, values, nodes, proven = posterior.solve(
            *given, near.start, near.columns, gate2, self.ambiguity, self.nodes, POOL
        )
        info: dict[str, Any] = {"nodes": nodes, "flights": 0, "proof": "optimal" if proven else "truncated"}
        if not proven and self.flights and not self._is_hard(near):
            lengths, uniform = (
                power_law(self.exponent, len(pool[0])).draw(rng, self.flights),
                rng.random((self.flights, 2)),
            )
            pool[0], values[0], info["flights"] = posterior.ruin(
                pool[0], values[0], *given, near.start, near.columns, gate2, lengths, uniform, self.patience
            )
        core = self._core(pool[0], given, near)
        if core is not None:
            match, total = posterior.complete(core, *given, near.start, near.columns, gate2)
            if not np.array_equal(match, pool[0]):  # the best is in a pose basin that the first gate rules out
                return [_left_out(match, total, given, near)], {**info, "proof": "first gate"}
        keep = np.flatnonzero(values > values[0] - self.ambiguity)[:4]
        return [_left_out(pool[k], float(values[k]), given, near) for k in keep], info

    def _core(self, best: Ids, given: Given, near: Window) -> Ids | None:
        """Where the best hypothesis fails the joint test at the first gate: the best that passes it, if of two pairs or more.

        That choice is of the pose basin; the second gate then completes it, so the first costs no pairs by itself.
        """
        if self.gates[0] >= self.gates[1]:
            return None
        m, base, R = len(best), given[3], given[2]
        gates2 = chdtri(2.0 * np.arange(m + 1), 1.0 - self.gates[0])
        gates2[0] = np.inf
        _, d2, pairs = posterior.value_of(best, *given)
        if d2 < gates2[pairs]:
            return None
        pool, value = np.full((1, m), -1, np.int64), np.zeros(1)
        bound = posterior.most_possible(near.start, near.columns, base, R)
        posterior.search(
            *given, bound, *posterior.rank(near.start, near.columns), gates2, np.full(m, -1, np.int64), 0.0, 0.0,
            self.nodes, pool, value,
        )  # fmt: skip
        return pool[0] if np.count_nonzero(pool[0] >= 0) >= 2 else None

    # --- 6: decision -----------------------------------------------------------------------------------------------

    def _decided(self, found: list[Basin], info: dict[str, Any], p: Array, none: Array) -> Sequence[Association]:
        """The decision by its probabilities, and what was found beside it."""
        best = found[0]
        if self.decide == "map":
            match, chance = best.match, chances(best.match, p, none)
        else:
            match, chance = most_probable(p, none, self.least)
        first = Association(match, best.value, {**info, "objective": best.value, "basins": len(found)}, chance)
        return [first, *self._brothers(found[1:], best.value, match)] if len(found) > 1 else [first]

    def _brothers(self, others: list[Basin], best: float, match: Ids) -> list[Association]:
        """Other hypotheses that are nearly as good, to be carried on until later scans decide."""
        near = [b for b in others if b.value > best - self.ambiguity and not np.array_equal(b.match, match)]
        return [Association(b.match, b.value, {"brother": k + 1}) for k, b in enumerate(near[: self.brothers - 1])]


Given = tuple[Array, Array, Array, Array]  # innovation, covariance of the predictions, R, base gains


def _left_out(match: Ids, value: float, given: Given, near: Window) -> Basin:
    return Basin(match, value, left_out_gains(match, *given, near.start, near.columns), near)
