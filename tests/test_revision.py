"""The past gone through again: the same scans, the same numbers, and kept only if it explains them better."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.metrics.evaluation import evaluate
from tomthumb.revision import twin_of
from tomthumb.runner import collect, prepare
from tomthumb.scenarios.cloister import cloister


def run(seed: int, window: int, **options):
    scenario = cloister(np.random.default_rng(seed), **options)
    slam = prepare(scenario, associator="stt", seed=seed, settings={"slam": {"revision": window}})
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
    """Odometry eight times as noisy as in the reference: some of the first choices are wrong and are taken back."""
    options = {"odometry_noise": 8.0, "laps": 2}
    trace, slam, row = run(2, 20, **options)
    _, _, before = run(2, 0, **options)
    assert slam.revision.revised > 0
    assert row["match_rate"] >= before["match_rate"]
    assert len(trace.final_ids) == len(trace.ids)
