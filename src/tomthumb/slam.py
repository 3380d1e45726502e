"""The loop: predict, expect, associate, name, update, births and deaths. It knows protocols only.

`Slam.step` is the online form; `Slam.stream` is that in a loop over a scenario. Up to `width` branches (belief, ledger,
log weight) live side by side: with one it is the classical filter, with eight Tom and his seven brothers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from tomthumb import lifecycle
from tomthumb.appearance import Crowd, Looks, weigh, with_looks
from tomthumb.branches import Branch, Child, Scan, among, apart, ranked
from tomthumb.checks import check_step
from tomthumb.copies import level
from tomthumb.court import Court
from tomthumb.doubt import mostly_stands, put_on_trial, untried_of
from tomthumb.errors import Diverged
from tomthumb.geometry import wrapped
from tomthumb.kernels.gates import innovations, paired_distances
from tomthumb.king import King
from tomthumb.lifecycle import Life, LifeCycle
from tomthumb.protocols import Associator, Estimator, Motion, Rng, Sensor
from tomthumb.returns import look_back
from tomthumb.revision import Moment, Revision
from tomthumb.sensing import Clutter, DetectionMap, Surprise, area_in_view, news, travelled
from tomthumb.stillness import record_drifts
from tomthumb.twins import record_apart
from tomthumb.types import (
    Array,
    Association,
    AssociationProblem,
    Control,
    Estimate,
    Ids,
    Mask,
    Observations,
    Predictions,
    Prior,
    Step,
    StepRecord,
)

EMPTY = Observations(np.empty((0, 2)), np.empty((0, 2, 2)))


class Slam:
    """Landmark SLAM with any associator and any estimator.

    `teacher`, where given, names the observations of the first `teach_steps` steps; the associator looks on and learns.
    Raises `TomThumbError` for input that cannot be (NaN, a covariance that is not positive definite, time running back)
    and `Diverged` when the filter is lost; `stream` turns the latter into `failure`.
    """

    def __init__(
        self,
        motion: Motion,
        sensor: Sensor,
        prior: Prior,
        associator: Associator,
        estimator: Estimator[Any],
        *,
        policy: LifeCycle | None = None,
        width: int = 1,
        teacher: Associator | None = None,
        teach_steps: int = 0,
        rng: tuple[Rng, Rng] | None = None,
        king: King | None = None,
    ) -> None:
        self.motion, self.sensor = motion, sensor
        self.associator, self.estimator = associator, estimator
        self.policy, self.width = policy or LifeCycle(), width
        self.teacher, self.teach_steps = teacher, teach_steps
        self.rng_estimator, self.rng_associator = rng or (np.random.default_rng(1), np.random.default_rng(2))
        self.branches = [Branch(estimator.init(prior.pose, prior.cov, self.rng_estimator), {})]
        self.clutter = Clutter(area_in_view(sensor))
        self.detection = DetectionMap(sensor.detect)
        self.crowd, self.weight = Crowd(), self.policy.weight
        self.t, self.index, self.scan, self.serial = -math.inf, 0, 0, 0
        self.last_control: Control | None = None
        self.surprise = Surprise()
        self.moved = math.inf  # m since the last scan: how much of it is news, for sensors that repeat their errors
        self.failure: str | None = None
        self.court, self.revision = Court(king), Revision()

    def stream(self, steps: Iterable[Step]) -> Iterator[StepRecord]:
        """Every step's record; ends early, with `failure` set, when the filter diverges."""
        for step in steps:
            try:
                yield self.step(step.t, step.control, step.observations)
            except Diverged as reason:
                self.failure = f"{reason} at step {self.index}, t = {step.t:g} s"
                return

    def step(self, t: float, control: Control | None, observations: Observations | None) -> StepRecord:
        """Move to time `t` s by `control`, then take in the scan made there. Either may be None.

        A scan without a control, later than the last reading, is predicted to its time by holding the last control.
        """
        begin = perf_counter()
        seen = observations or EMPTY
        check_step(self.index, t, self.t, control, seen)
        moment = Moment(t, control, observations)
        self.revision.before(self, moment, self.court.well)
        self.court.before(self, moment)
        for branch in self.branches:
            self.predict(branch, t, control)
        self.t = t
        predicted = perf_counter()
        serials = np.arange(self.serial, self.serial + len(seen))
        self.serial += len(seen)
        spent, infos = self._take_in(seen, serials) if observations is not None else (0.0, {})
        record = self._record(t, serials, (begin, predicted, spent), infos)
        self.index += 1
        self.scan += observations is not None
        self.revision.after(self)
        return record

    def estimate(self) -> Estimate:
        """What the best branch says now; while the family is away from home, with the old map beside the new one."""
        return self.court.whole(self.estimator.estimate(self.branches[0].belief))

    # --- prediction -------------------------------------------------------------------------------------------------

    def predict(self, branch: Branch, t: float, control: Control | None) -> None:
        """Controls cover the `dt` that ends at t; what a held control has already covered is not moved twice."""
        if control is None:
            if self.last_control is None or not self.motion.rates or t <= self.t:
                return
            self._move(branch, replace(self.last_control, dt=t - self.t))
            return
        self.last_control = control
        left = t - self.t
        if self.motion.rates and 0.0 < left < control.dt * (1.0 - 1e-9):
            control = replace(control, dt=left)
        if control.dt > 0.0 or not self.motion.rates:
            self._move(branch, control)

    def _move(self, branch: Branch, control: Control) -> None:
        branch.belief = self.estimator.predict(branch.belief, control, self.rng_estimator)
        if branch is self.branches[0] and any(self.sensor.memory):
            delta, _ = self.motion.increment(control)
            self.moved += travelled(delta)

    def _honest(self, seen: Observations) -> Observations:
        """The scan with R raised where the residuals of the last scans say that it claims too little."""
        scale = self.surprise.scale
        return seen if scale == 1.0 else replace(seen, R=seen.R * scale)

    # --- association ------------------------------------------------------------------------------------------------

    def _take_in(self, seen: Observations, serials: Ids) -> tuple[float, dict[str, Any]]:
        begin = perf_counter()
        honest = self._honest(seen)
        scan = Scan(seen, honest, news(honest, self.sensor.memory, self.moved), serials)
        children = [child for branch in self.branches for child in self._children(branch, scan)]
        ranked(children)
        children = children[: self.width]
        spent = perf_counter() - begin
        self.moved = 0.0
        for branch, predictions, matches, _ in children:
            self._settle(branch, scan, predictions, matches)
        level(self, children, scan)
        ranked(children)
        best = children[0][0]
        self.crowd.record(seen)
        self.clutter.count += float(np.count_nonzero(best.paired < 0))
        self.clutter.scans += 1.0
        self.branches = apart([c[0] for c in children], self.estimator)
        infos = children[0][3] | self.court.attend(self, scan)
        if self.teacher is not self.associator or self.index >= self.teach_steps:
            best = self.branches[0]  # from it alone: one scan, one lesson; and of stones, crumbs have no name yet
            self.associator.learn(best.ids[~among(best.ids, best.crumbs)], self.t)
        return spent, infos

    def _children(self, branch: Branch, scan: Scan) -> list[Child]:
        """The branch with each hypothesis of its associator. Many predictions (particles) take the best one each."""
        every = [self._expected(p, branch) for p in self.estimator.expect(branch.belief)]
        found = [self._ask(p, scan) for p in every]
        several = len(every) == 1 and mostly_stands(branch.trials, self.policy)
        some = found[0][: self.width if several else 1]
        grown = [branch, *(self._fork(branch) for _ in some[1:])]
        for child, hypothesis in zip(grown, some, strict=True):
            child.weigh(hypothesis.log_weight)
        others = [f[0].match for f in found[1:]]
        return [(c, every, [h.match, *others], _spent(h)) for c, h in zip(grown, some, strict=True)]

    def _expected(self, predictions: Predictions, branch: Branch) -> Predictions:
        """The predictions with what the life so far says: existence, and detection where each landmark stands."""
        if predictions.points is not None and predictions.visible is not None and len(predictions):
            learned = self.detection.chance(predictions.points) / self.detection.prior
            predictions = replace(predictions, visible=np.minimum(predictions.visible * learned, 0.999))
        known = (branch.ledger[int(i)].looks for i in predictions.ids)
        present = self.policy.present and mostly_stands(branch.trials, self.policy)
        return with_looks(lifecycle.with_existence(predictions, branch.ledger, present), known, self.crowd)

    def _fork(self, branch: Branch) -> Branch:
        belief, ledger = self.estimator.fork(branch.belief), lifecycle.copy_ledger(branch.ledger)
        return replace(branch, belief=belief, ledger=ledger, crumbs=set(branch.crumbs))

    def _ask(self, predictions: Predictions, scan: Scan) -> Sequence[Association]:
        teaching = self.teacher is not None and self.index < self.teach_steps
        who = self.teacher if teaching and self.teacher is not None else self.associator
        return who.associate(self.problem(predictions, scan.honest, scan.serials), self.rng_associator)

    def problem(self, predictions: Predictions, seen: Observations, serials: Ids) -> AssociationProblem:
        """The scan against one set of predictions, as associators are given it."""
        nu = innovations(seen.z, predictions.z_hat, wrapped(self.sensor.angles))
        density = (self.sensor.clutter + self.clutter.density) * self.sensor.scale(seen.z)
        looks = weigh(seen, predictions, self.crowd, self.weight)
        return AssociationProblem(
            seen.z, seen.R, nu, predictions, density, serials, self.sensor.angles,
            None if looks.soft else seen.labels, seen.signature, self.t, looks.ratio, looks.barred, looks.gated,
        )  # fmt: skip

    # --- naming, update, life cycle ---------------------------------------------------------------------------------

    def found(self, branch: Branch, scan: Scan) -> None:
        """A branch without a map begins one with this scan."""
        predictions = [self._expected(p, branch) for p in self.estimator.expect(branch.belief)]
        self._settle(branch, scan, predictions, [np.full(len(scan), -1, np.int64) for _ in predictions])

    def _settle(self, branch: Branch, scan: Scan, every: Sequence[Predictions], matches: Sequence[Ids]) -> None:
        """Names, update, evidence, promotions, deaths, births, merging, for one branch."""
        named = [np.where(m >= 0, p.ids[m], -1) if len(p) else m for p, m in zip(every, matches, strict=True)]
        branch.belief = self.estimator.update(branch.belief, scan.news, named, self.rng_estimator)
        ids, predictions = named[0], every[0]
        hit = ids >= 0
        self._evidence(branch, predictions, matches[0], scan, ids)
        born, late = self._births(branch, scan, named)
        here, names = self.estimator.pose(branch.belief), np.where(born, scan.serials, ids)
        if self.policy.looks_for_drift:
            expected = predictions, matches[0]
            record_drifts(branch.ledger, branch.crumbs, expected, scan.honest, self.sensor, here[0], self.scan)
        look_back(branch, here, self.sensor, scan.honest, names, born, self.policy)
        self._promote(branch, ids[hit].tolist() + scan.serials[born].tolist())
        self._bury(branch, predictions)
        if self.policy.merge and hit.any():
            self._absorb(branch, predictions, set(ids[hit].tolist()), scan)
            self._merge(branch, predictions, set(ids[hit].tolist()))
        self._doubt(branch, ids[hit].tolist())
        branch.paired = np.where(late >= 0, late, ids)
        branch.ids = np.where(born, scan.serials, branch.paired)

    def _evidence(self, branch: Branch, predictions: Predictions, match: Ids, scan: Scan, ids: Ids) -> None:
        rows = np.flatnonzero(ids >= 0)
        paired = ids[rows].tolist()
        d2 = _pair_distances(predictions, scan.honest, match, rows, wrapped(self.sensor.angles))
        if branch is self.branches[0]:
            self.surprise.record(_pair_distances(predictions, scan.raw, match, rows, wrapped(self.sensor.angles)))
        lifecycle.record_hits(branch.ledger, paired, d2, self.scan, self.policy)
        self._opportunities(branch, predictions, set(paired), scan)
        lifecycle.record_companions(branch.ledger, paired)
        crowd = self.crowd if branch is self.branches[0] else None
        lifecycle.record_looks(branch.ledger, paired, scan.raw, rows, crowd)

    def _opportunities(self, branch: Branch, predictions: Predictions, hit: set[int], scan: Scan) -> None:
        """Who was well in view, and was or was not seen: for each landmark's existence and for the map of detection."""
        if predictions.visible is None or predictions.points is None or not len(predictions):
            return
        chance = self.detection.chance(predictions.points)
        inside = predictions.visible > self.policy.in_view * np.minimum(chance, 0.999)
        seen = np.array([i in hit for i in predictions.ids.tolist()], bool)
        missed = inside & ~seen
        lifecycle.record_misses(branch.ledger, predictions.ids[missed], chance[missed])
        if predictions.stone is not None and branch is self.branches[0]:
            known = inside & predictions.stone
            self.court.look(branch, predictions.ids, known, seen, chance, len(scan), self.scan)
            self.detection.record(predictions.points[known], seen[known])

    def _absorb(self, branch: Branch, predictions: Predictions, hit: set[int], scan: Scan) -> None:
        """Of two stones that stand for one thing the one seen less is left out; where it was tells nothing."""
        for keep, drop in record_apart(branch.ledger, predictions, hit, self.detection, scan.honest, self.policy):
            if keep in branch.ledger and drop in branch.ledger:
                branch.belief = self.estimator.forget(branch.belief, np.array([drop]))
                self._united(branch, keep, drop)

    def _births(self, branch: Branch, scan: Scan, named: Sequence[Ids]) -> tuple[Any, Ids]:
        """Observations that found a crumb (m,) bool, and those named late (m,), both for the first particle."""
        nobody = np.full(len(scan), -1, np.int64)
        if (named[0] >= 0).all() and len(named) == 1:
            return nobody >= 0, nobody
        fresh = self.estimator.expect(branch.belief)
        told = [self._unexplained(p, ids, scan) for p, ids in zip(fresh, named, strict=True)]
        founded = [founders for founders, _ in told]
        branch.belief = self.estimator.add(branch.belief, scan.raw, founded, self.rng_estimator)
        for row in np.flatnonzero(np.max(founded, axis=0) >= 0):
            looks = Looks().and_seen(scan.raw, int(row))
            branch.ledger[int(scan.serials[row])] = Life(self.scan, looks=looks, born=self.scan)
            branch.crumbs.add(int(scan.serials[row]))
        return founded[0] >= 0, told[0][1]

    def _unexplained(self, predictions: Predictions, ids: Ids, scan: Scan) -> tuple[Ids, Ids]:
        """What becomes of observations that the associator left: founders of a crumb (m,) and late names (m,), or -1."""
        rows = np.flatnonzero(ids < 0)
        loose = self.problem(predictions, scan.honest.take(rows), scan.serials[rows])
        taken = np.isin(predictions.ids, ids[ids >= 0])
        new = lifecycle.may_be_born(loose.d2, taken, self.policy)
        if not new.all():
            raw = self.problem(predictions, scan.raw.take(rows[~new]), scan.serials[rows[~new]])
            self.surprise.record(np.where(taken, np.inf, raw.d2).min(1).tolist())
        founders, late = np.full(len(scan), -1, np.int64), np.full(len(scan), -1, np.int64)
        founders[rows[new]] = scan.serials[rows[new]]
        column = lifecycle.named_late(loose.d2, taken, predictions, self.policy)
        late[rows] = np.where(column >= 0, predictions.ids[column], -1) if len(predictions) else -1
        return founders, late

    def _promote(self, branch: Branch, candidates: list[int]) -> None:
        crumbs = [i for i in candidates if i in branch.crumbs]
        first = len(branch.crumbs) == len(branch.ledger)
        stones = len(candidates) - len(crumbs)
        ready, moving = lifecycle.promotions(branch.ledger, crumbs, stones, first, self.policy)
        lifecycle.restart(branch.ledger, moving)
        if len(ready):
            branch.belief = self.estimator.promote(branch.belief, ready)
            branch.crumbs.difference_update(ready.tolist())
            branch.trials = branch.trials.and_ended(0 if first else sum(not branch.ledger[i].believed for i in ready))
            branch.untried |= untried_of(branch.ledger, ready.tolist(), self.policy)

    def _doubt(self, branch: Branch, hit: list[int]) -> None:
        gone = put_on_trial(branch.ledger, branch.crumbs, branch.untried, hit, branch.trials, self.policy)
        if len(gone):
            branch.belief = self.estimator.doubt(branch.belief, gone)
            branch.crumbs.update(gone.tolist())

    def _bury(self, branch: Branch, predictions: Predictions) -> None:
        expected = [i for i in predictions.ids.tolist() if i not in branch.crumbs]
        gone = lifecycle.deaths(branch.ledger, expected, branch.crumbs, self.scan, self.policy)
        if len(gone):
            lifecycle.bequeath(branch.ledger, gone)
            branch.graves = branch.graves.and_buried(lifecycle.graves(branch.ledger, gone))
            branch.belief = self.estimator.forget(branch.belief, gone)
            branch.trials = branch.trials.and_ended(faded=len(branch.crumbs.intersection(gone.tolist())))
            branch.crumbs.difference_update(gone.tolist())
        for i in gone.tolist():
            del branch.ledger[i]
            branch.events = (branch.events, "died", i, -1, self.index)

    def _merge(self, branch: Branch, predictions: Predictions, hit: set[int]) -> None:
        for keep, drop in lifecycle.duplicates(branch.ledger, predictions, hit, self.policy):
            if keep in branch.ledger and drop in branch.ledger:
                self.unite(branch, keep, drop)

    def unite(self, branch: Branch, keep: int, drop: int) -> None:
        """Two stones of a branch become one; the survivor inherits hits and companions."""
        branch.belief = self.estimator.merge(branch.belief, keep, drop)
        self._united(branch, keep, drop)

    def _united(self, branch: Branch, keep: int, drop: int) -> None:
        lifecycle.inherit(branch.ledger, keep, drop)
        branch.events = (branch.events, "merged", drop, keep, self.index)

    def _record(self, t: float, serials: Ids, clock: tuple[float, float, float], info: dict[str, Any]) -> StepRecord:
        best = self.branches[0]
        estimate = self.estimator.pose(best.belief)
        for branch in self.branches:
            if not len(serials):
                branch.ids = branch.paired = np.empty(0, np.int64)
            branch.history = (
                branch.history,
                branch.ids,
                estimate[0] if branch is best else self.estimator.pose(branch.belief)[0],
                self.scan,
            )
        stats = self.estimator.stats(best.belief) if len(serials) else {"nis": 0.0, "dof": 0}
        begin, predicted, spent = clock
        end = perf_counter()
        seconds = (predicted - begin, spent, end - predicted - spent, 0.0)
        stone = (best.paired >= 0) & ~among(best.paired, best.crumbs)
        return StepRecord(
            self.index, t, *estimate, serials, best.ids, best.paired >= 0, stone, seconds,
            float(stats.get("nis", 0.0)), int(stats.get("dof", 0)), len(best.ledger), info,
        )  # fmt: skip


def _spent(answer: Association) -> dict[str, Any]:
    """What the record of a step tells of an answer: what was spent and proven, and how sure each decision is."""
    return dict(answer.info) if answer.confidence is None else {**answer.info, "confidence": answer.confidence}


def _pair_distances(predictions: Predictions, seen: Observations, match: Ids, rows: Ids, flags: Mask) -> list[float]:
    """d2 of each pairing at the prior."""
    if not len(rows):
        return []
    d2: Array = paired_distances(seen.z, seen.R, predictions.z_hat, predictions.cov, rows, match[rows], flags)
    return [float(value) for value in d2]
