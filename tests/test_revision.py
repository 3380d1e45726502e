"""The past gone through again: the same scans, the same numbers, and kept only if it explains them better."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.errors import Diverged
from tomthumb.metrics.evaluation import evaluate
from tomthumb.revision import Checkpoint, Moment, twin_of
from tomthumb.runner import collect, prepare
from tomthumb.scenarios.cloister import cloister


def begun(steps: int, revision: int = 0, **options):
    """A loop after some steps, and those to come."""
    scenario = cloister(np.random.default_rng(3), **options)
    slam = prepare(scenario, associator="jcbb", settings={"slam": {"revision": revision, "king": True}})
    for step in scenario.steps[:steps]:
        slam.step(step.t, step.control, step.observations)
    return slam, scenario.steps[steps:]


ONE_HISTORY = {"width": 1, "present": False}


def run(seed: int, window: int, bent: float = 1.0, alone: bool = False, **options):
    scenario = cloister(np.random.default_rng(seed), **options)
    settings = {"slam": {"revision": window} | (ONE_HISTORY if alone else {}), "associator": {"bent": bent}}
    slam = prepare(scenario, associator="stt", seed=seed, settings=settings)
    trace = collect(scenario.name, slam, list(slam.stream(scenario.steps)))
    return trace, slam, evaluate(trace, scenario)


@pytest.mark.parametrize("estimator", ["iekf", "fastslam"])
def test_a_twin_goes_on_as_the_loop_would_have(estimator):
    scenario = cloister(np.random.default_rng(3))
    slam = prepare(scenario, associator="jcbb", estimator=estimator)
    steps = list(scenario.steps)
    for step in steps[:60]:
        slam.step(step.t, step.control, step.observations)
    twin = twin_of(slam)
    ours = [slam.step(s.t, s.control, s.observations) for s in steps[60:80]]
    theirs = [twin.step(s.t, s.control, s.observations) for s in steps[60:80]]
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_allclose(a.pose, b.pose, atol=1e-12)


def test_where_all_is_well_nothing_is_revised():
    with_it, slam, _ = run(1, 20)
    without, _, _ = run(1, 0)
    assert slam.revision.revised == 0
    np.testing.assert_array_equal(with_it.ids, without.ids)
    np.testing.assert_array_equal(with_it.pose, without.pose)


def test_a_turn_of_the_evidence_is_followed_back():
    """Odometry eight times as noisy as in the reference, all scans linearised, and no brothers: some of the first choices are
    wrong and are taken back.
    """
    options = {"odometry_noise": 8.0, "laps": 2, "bent": 1e9, "alone": True}
    trace, slam, row = run(2, 20, **options)
    _, _, before = run(2, 0, **options)
    assert slam.revision.revised > 0
    assert row["match_rate"] >= before["match_rate"]
    assert len(trace.final_ids) == len(trace.ids)


def test_what_a_twin_goes_through_leaves_no_trace_in_the_loop():
    slam, coming = begun(20, classes=3, diameter_std=0.02)
    twin = twin_of(slam)
    before = [repr(what) for what in (slam.crowd, slam.clutter, slam.surprise, slam.branches[0].ledger)]
    for step in coming[:10]:
        twin.step(step.t, step.control, step.observations)
    assert twin.crowd.all.count > slam.crowd.all.count
    assert [repr(what) for what in (slam.crowd, slam.clutter, slam.surprise, slam.branches[0].ledger)] == before


def test_a_past_in_which_the_filter_diverges_is_no_better_one():
    slam, coming = begun(20, revision=20)
    point = Checkpoint(twin_of(slam))
    point.note(Moment(coming[0].t, coming[0].control, coming[0].observations))

    def lost(*_):
        raise Diverged("the pose is not finite")

    point.twin.step = lost
    slam.revision.newest, slam.revision.older = point, None
    slam.revision.good = True
    slam.court.watch.peak = 100.0
    kept = slam.branches[0]
    slam.revision.after(slam)
    assert slam.revision.newest is None  # it was tried
    assert slam.branches[0] is kept


def test_no_past_outlives_an_exile():
    slam, coming = begun(20, revision=20)
    assert slam.revision.newest is not None
    slam.court.lose_the_way(slam, slam.branches[0])
    for step in coming[:3]:
        slam.step(step.t, step.control, step.observations)
        assert slam.revision.newest is slam.revision.older is None


def test_what_lies_between_two_scans_does_not_age_a_checkpoint():
    slam, _ = begun(4, revision=20)
    point = slam.revision.newest
    assert (point.scans, len(point.since)) == (4, 4)
    for k in range(40):
        slam.step(3.0 + 0.01 * (k + 1), None, None)
    assert slam.revision.newest is point
    assert (point.scans, len(point.since)) == (4, 44)
