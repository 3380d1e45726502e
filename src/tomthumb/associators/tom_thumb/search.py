"""Simulated Tom Thumb names the landmarks: the joint posterior, searched by the family.

    0  window      candidates of each observation
    1  quick path  a scan in which nobody has two candidates, and no gain leaves a doubt, is done at once; in a small scan
                   all hypotheses that count are listed and summed
    2  anchored flights: pairs of observations give poses, the others vote; the best basins are refined. A scan with one
                   basin is linearised there, and all hypotheses that count are listed and summed
    3  Levy flights inside a basin: ruin r related pairs, force an alternative, complete again
    4  boots: stagnation makes the ruins larger (off by default: they changed nothing, docs/parts.md)
    5  certificate: branch and bound from the incumbent within a budget: "optimal" (award INFINITY), or "truncated"
    6  ambiguity: hypotheses within a few nats live on as brothers

The decision is not the single most probable hypothesis but the most probable partner of each observation, over all
hypotheses met: that is what maximises the expected number of right decisions, and it gives each its confidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from tomthumb.associators.tom_thumb.basins import POLISHED, Basin, Budget, anchored, at_pose, distinct
from tomthumb.associators.tom_thumb.decision import beside, chances, mixed_marginals, most_probable, sampled_marginals
from tomthumb.associators.tom_thumb.scene import (
    LOOSE,
    REMAINDER,
    Rigid,
    Window,
    curved_window,
    gate_of_two,
    rigid,
    window,
)
from tomthumb.associators.tom_thumb.there import STRAIGHT, bend_of, given_there, one_pose, related, straight, unshared
from tomthumb.errors import TomThumbError, from_zero
from tomthumb.gains import base_gains, weighed
from tomthumb.kernels import listing, marginals, posterior
from tomthumb.kernels.left_out import left_out_gains, unambiguous
from tomthumb.protocols import Rng
from tomthumb.tale.levy import power_law
from tomthumb.tale.stdp import LogMemory
from tomthumb.types import Array, Association, AssociationProblem, Ids, Lessons

Given = tuple[Array, Array, Array, Array]  # innovation, covariance of the predictions, R, base gains
SMALL = 30  # observations from which a scan is large
CERTAIN = 6  # observations up to which the certificate comes first in a hard scan: it costs little there
FEW = 8.0  # candidates an observation, on average, up to which there is any hope for it
LONG, LATER = 100, 30_000  # pairings in the window up to which all hypotheses may be listed, and nodes spent on that
SHORT, SOON = 64, 2000  # the same where landmarks err together even given the pose: nodes are dearer there
MANY = 256  # hypotheses that may be listed then
POOL = 8  # hypotheses that the certificate remembers
NOTHING_YET: dict[str, Any] = {"proof": "truncated"}


@dataclass(slots=True)
class TomThumb:
    """The STT associator. Every number's reason is in docs/stt.md.

    gates: the first, where it is the narrower, chooses the pose basin; the second completes it. nodes: budget of the
    certificate. flights, exponent: Levy flights in a basin; patience: flights in vain before the boots (0: none). anchors,
    basins, poses: anchored flights and their budgets. brothers: hypotheses returned at most (use with `slam.width`),
    `ambiguity` nats: how far behind the best they may be. least: a pairing less probable than this is left unpaired. decide:
    "marginal" (most probable partner of each) or "map" (most probable hypothesis). samples: poses drawn, over all basins, to
    integrate the pose out, when a decision is not `sure` or there are several basins within `reach` nats. quick: nats that
    every pairing of an unambiguous scan must gain for it to be done at once (0: never). listed: nats behind the best within
    which all hypotheses of a small scan are summed (0: never). hard: mean number of candidates from which a scan is ambiguous
    and pose basins are searched. bent: what linearising the pose leaves out, over the noise, from which they are searched at
    once. memory: weigh candidates by who was seen with whom (STDP) in the last `recent` s, within `clip` nats a scan; at most
    `size` landmarks are remembered.
    """

    gates: tuple[float, float] = (1.0 - 1e-6, 1.0 - 1e-6)
    nodes: int = 2000
    flights: int = 60
    patience: int = 0
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
    quick: float = 4.0
    listed: float = 6.0
    hard: float = 1.5
    bent: float = 1.0
    memory: bool = False
    recent: float = 3.0
    clip: float = 2.0
    size: int = 1000
    lessons: LogMemory = field(default=None, repr=False)  # type: ignore[assignment]  # made below; a copy takes it along

    def __post_init__(self) -> None:
        from_zero(
            "associator", self, "nodes flights patience anchors ambiguity least samples reach quick listed hard bent"
        )
        if self.brothers < 1:
            raise TomThumbError(f"associator.brothers={self.brothers}: at least 1 hypothesis is returned")
        if self.lessons is None:
            self.lessons = LogMemory(self.recent, clip=self.clip, size=self.size)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64), info={"proof": "optimal", "nodes": 0}, confidence=np.ones(m))]
        # all pairings of a scan say the same, where the robot is: together they may count as one, `clip` nats at most
        prior = self.lessons.prior(problem.predictions.ids, problem.t) / m if self.memory else None
        own, odds = base_gains(problem, prior)
        bend = bend_of(problem)
        if self.decide == "marginal" and m > 2 and bend >= self.bent:
            turned = self._over_bent_poses(problem, own, odds, rng)
            if turned is not None:
                return turned
        near, cov = window(problem.weighed_d2, self.gates[1]), np.ascontiguousarray(problem.predictions.cov)
        if self._may_be_quick(problem, near):
            clear, match, chance, value = unambiguous(
                problem.innovation, cov, problem.R, own, odds, near.start, near.columns, self.quick
            )
            if clear:
                return [Association(match, value, {"proof": "unambiguous", "nodes": 0, "objective": value}, chance)]
        hard = self._is_hard(near)
        given = (problem.innovation, cov, problem.R, weighed(own[:, None] + odds, problem.evidence))
        listed = self._listed(problem, given, near) if bend < STRAIGHT and self._may_be_listed(near) else None
        if listed is not None:
            others = self._within(given, near, rng)[0] if self._doubts(listed) else []
            return [listed, *beside(listed, others, self.ambiguity, self.brothers - 1)]
        if self.decide == "map":
            return self._mode(problem, given, near, own, odds, rng)
        found, info = self._within(given, near, rng) if not hard or self._is_small(near, CERTAIN) else ([], NOTHING_YET)
        proven = info["proof"] == "optimal"
        if found:
            p, none = mixed_marginals(found, n)
            if self._is_settled(
                found[0], p, none, 0.0 if not hard else self.sure if proven and len(found) == 1 else 1.1
            ):
                return self._decided(found, info, p, none)
        scene = rigid(problem, own, odds)
        if scene is not None:
            return self._over_poses(problem, scene, near, found if proven or not hard else [], info, rng)
        if not found:
            found, info = self._within(given, near, rng)
        return self._decided(found, info, *mixed_marginals(found, n))

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

    def _may_be_quick(self, problem: AssociationProblem, near: Window) -> bool:
        """The quick path knows no looks and no first gate."""
        few = near.start[-1] <= len(problem.z)
        return bool(few and self.quick > 0.0 and problem.evidence is None and self.gates[0] >= self.gates[1])

    @property
    def _lists(self) -> bool:
        """Whether sums over all hypotheses are what is wanted."""
        return self.decide == "marginal" and self.listed > 0.0

    def _doubts(self, decided: Association) -> bool:
        """Whether a decision by sums leaves room for brothers within `ambiguity` nats."""
        chance, most = decided.confidence, 1.0 / (1.0 + math.exp(-min(self.ambiguity, self.listed)))
        return self.brothers > 1 and chance is not None and bool(chance.min() <= most)

    def _may_be_listed(self, near: Window) -> bool:
        """Few pairings to choose from."""
        return bool(self._lists and near.start[-1] <= LONG and self.gates[0] >= self.gates[1])

    def _is_hard(self, near: Window) -> bool:
        """More than one candidate for most observations, or a large scan: pose basins matter."""
        m = len(near.start) - 1
        return m >= 3 and (near.start[-1] > self.hard * m or m > SMALL)

    def _is_small(self, near: Window, most: int) -> bool:
        """Small enough for the certificate to come first."""
        m = len(near.start) - 1
        return bool(m <= most and near.start[-1] <= FEW * m)

    def _is_settled(self, best: Basin, p: Array, none: Array, sure: float) -> bool:
        """Every decision is at least so probable, and together they are the best hypothesis.

        Where two observations contend for two landmarks, gains given all the others may favour the exchange of both.
        """
        match, chance, free = marginals.pick(p, none, self.least)
        return bool(free and chance.min() >= sure and np.array_equal(match, best.match))

    def _listed(self, problem: AssociationProblem, given: Given, near: Window) -> Association | None:
        """The decision by the sums over all hypotheses that count; None where they are too many."""
        lists, whole, nodes = (near.start, near.columns), False, 0
        pose_cov, cross = problem.predictions.pose_cov, problem.predictions.cross
        if pose_cov is not None and cross is not None:
            pose = np.ascontiguousarray(pose_cov), np.ascontiguousarray(cross)
            whole, p, none, _best, value, nodes = listing.listed(*given, *pose, *lists, self.listed, LATER)
        if nodes == 0 and len(near.columns) <= SHORT:
            whole, p, none, _best, value, nodes = posterior.listed(
                *given, *lists, gate_of_two(self.gates[1]), self.listed, SOON, MANY
            )
        return self._summed(p, none, value, {"proof": "optimal", "nodes": int(nodes)}) if whole else None

    def _summed(self, p: Array, none: Array, value: float, info: dict[str, Any]) -> Association:
        match, chance = most_probable(p, none, self.least)
        return Association(match, value, {**info, "objective": value}, chance)

    def _over_bent_poses(
        self, problem: AssociationProblem, own: Array, odds: Array, rng: Rng
    ) -> Sequence[Association] | None:  # fmt: skip
        """The decision where no linearised covariance can be trusted: over poses, whatever landmarks err in common."""
        for remainder in (REMAINDER, LOOSE):
            scene = rigid(problem, own, odds, remainder)
            if scene is not None:
                near = curved_window(scene, self.gates[1])
                return self._over_poses(problem, scene, near, [], NOTHING_YET, rng)
        return None

    # --- 2: over the poses ----------------------------------------------------------------------------------------

    def _over_poses(
        self,
        problem: AssociationProblem,
        scene: Rigid,
        near: Window,
        known: list[Basin],
        info: dict[str, Any],
        rng: Rng,
    ) -> Sequence[Association]:
        """The decision with the pose integrated out, over the hypotheses known, or over the pose basins of anchors."""
        gate2, gate3 = (float(chdtri(dof, 1.0 - self.gates[1])) for dof in (2, 3))
        found = [at_pose(scene, b, gate2) for b in known]
        if not found:
            found, info = anchored(scene, near, gate2, gate3, self._budget())
        found = distinct(found, self.reach)
        listed = self._listed_there(problem, scene, found[0], info, rng) if one_pose(found) else None
        if listed is not None:
            return listed
        p, none = mixed_marginals(found, len(scene.p))
        if self.samples and (len(found) > 1 or not self._is_settled(found[0], p, none, self.sure)):
            p, none = sampled_marginals(found, scene, max(8, self.samples // len(found)), gate2, rng)
        return self._decided(found, info, p, none)

    def _listed_there(
        self, problem: AssociationProblem, scene: Rigid, basin: Basin, info: dict[str, Any], rng: Rng
    ) -> Sequence[Association] | None:  # fmt: skip
        """The decision by the sums over all hypotheses of the only basin, on the full covariance; None where they are too many."""
        near = basin.window
        if not self._lists or len(near.columns) > SHORT or basin.pose is None or not straight(scene, basin):
            return None
        some, columns = np.unique(near.columns, return_inverse=True)
        left = unshared(problem, scene, some) if len(some) > 1 else None
        if left is None or not related(scene, left):
            return None
        given = given_there(scene, basin.pose, some, left)
        whole, few, none, _best, value, nodes = posterior.listed(
            *given, near.start, columns, gate_of_two(self.gates[1]), self.listed, SOON, MANY
        )
        if not whole:
            return None
        p = np.zeros(problem.shape)
        p[:, some] = few
        spent = {**info, "basins": 1, "nodes": info.get("nodes", 0) + int(nodes)}  # the proof is that of no other basin
        first = self._summed(p, none, value, spent)
        others = self._within(given, Window(near.start, columns), rng)[0] if self._doubts(first) else []
        named = [replace(b, match=np.where(b.match >= 0, some[b.match], -1)) for b in others]
        return [first, *beside(first, named, self.ambiguity, self.brothers - 1)]

    def _budget(self) -> Budget:
        return Budget(self.anchors, self.basins, self.poses, self.reach)

    def _mode(
        self, problem: AssociationProblem, given: Given, near: Window, own: Array, odds: Array, rng: Rng
    ) -> Sequence[Association]:  # fmt: skip
        """The most probable hypothesis: proven on the full covariance, else the best that anchors and flights lead to.

        Beyond the certificate's size it is the best over rigid motions, where the search went over poses.
        """
        gate2, gate3 = (float(chdtri(dof, 1.0 - self.gates[1])) for dof in (2, 3))
        found, info = self._within(given, near, rng) if self._is_small(near, SMALL) else ([], NOTHING_YET)
        if self._is_hard(near) and info["proof"] == "truncated":
            scene = rigid(problem, own, odds)
            others, spent = anchored(scene, near, gate2, gate3, self._budget()) if scene is not None else ([], {})
            if found:
                found, info = self._polished([b.match for b in [*found, *others]], given, near, gate2, rng, info)
            else:
                found, info = distinct(others, self.reach), spent
        if not found:
            found, info = self._within(given, near, rng)
        return self._decided(found, info, *mixed_marginals(found, len(odds)))

    def _polished(
        self, matches: list[Ids], given: Given, near: Window, gate2: float, rng: Rng, info: dict[str, Any]
    ) -> tuple[list[Basin], dict[str, Any]]:
        """Levy flights from each of the best hypotheses, by L on the full covariance, and the certificate once more."""
        by_value = {tuple(a.tolist()): (float(posterior.value_of(a, *given)[0]), a) for a in matches}
        ranked = sorted(by_value.values(), key=lambda pair: -pair[0])[:POLISHED]
        flown = [self._flown(match, value, given, near, gate2, rng) for value, match in ranked]
        match, value, _ = max(flown, key=lambda f: f[1])
        m = len(match)
        pool, values = np.full((POOL, m), -1, np.int64), np.full(POOL, -np.inf)
        bound = posterior.most_possible(near.start, near.columns, given[3], given[2])
        nodes, proven = posterior.search(
            *given, bound, *posterior.rank(near.start, near.columns), np.full(m + 1, np.inf), match, value,
            self.ambiguity, self.nodes, pool, values,
        )  # fmt: skip
        spent = {"nodes": info["nodes"] + nodes, "flights": sum(f[2] for f in flown)}
        return self._kept(pool, values, given, near), {**info, **spent, "proof": "optimal" if proven else "truncated"}

    # --- 1, 3, 5: on the full covariance --------------------------------------------------------------------------

    def _within(self, given: Given, near: Window, rng: Rng) -> tuple[list[Basin], dict[str, Any]]:
        """Greedy, certificate, and Levy flights where the certificate's budget did not suffice."""
        gate2 = gate_of_two(self.gates[1])
        pool, values, nodes, proven = posterior.solve(
            *given, near.start, near.columns, gate2, self.ambiguity, self.nodes, POOL
        )
        info: dict[str, Any] = {"nodes": nodes, "flights": 0, "proof": "optimal" if proven else "truncated"}
        if not proven and self.flights and not self._is_hard(near):
            pool[0], values[0], info["flights"] = self._flown(pool[0], values[0], given, near, gate2, rng)
        core = self._core(pool[0], given, near)
        if core is not None:
            match, total = posterior.complete(core, *given, near.start, near.columns, gate2)
            if not np.array_equal(match, pool[0]):  # the best is in a pose basin that the first gate rules out
                return [_left_out(match, total, given, near)], {**info, "proof": "first gate"}
        return self._kept(pool, values, given, near), info

    def _kept(self, pool: Ids, values: Array, given: Given, near: Window) -> list[Basin]:
        """The hypotheses within `ambiguity` nats, four at most."""
        some = list(zip(pool[:4], values[:4].tolist(), strict=True))
        return [_left_out(match, value, given, near) for match, value in some if value > some[0][1] - self.ambiguity]

    def _flown(
        self, match: Ids, value: float, given: Given, near: Window, gate2: float, rng: Rng
    ) -> tuple[Ids, float, int]:
        """Levy flights from a hypothesis: the best met, its L, and the flights made."""
        lengths, uniform = power_law(self.exponent, len(match)).draw(rng, self.flights), rng.random((self.flights, 2))
        found: tuple[Ids, float, int] = posterior.ruin(
            match, value, *given, near.start, near.columns, gate2, lengths, uniform, self.patience
        )
        return found

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
        return [first, *beside(first, found[1:], self.ambiguity, self.brothers - 1)]


def _left_out(match: Ids, value: float, given: Given, near: Window) -> Basin:
    return Basin(match, value, left_out_gains(match, *given, near.start, near.columns), near)
