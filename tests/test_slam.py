"""The loop: its online form, its errors, its failures, and what runs on known worlds must show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import tomthumb
from tomthumb.associators.jcbb import JointCompatibility
from tomthumb.errors import Diverged, TomThumbError
from tomthumb.estimators.ekf import EKF, InvariantEKF
from tomthumb.models.motion import OdometryIncrement, Velocity
from tomthumb.models.sensor import Cartesian, RangeBearing
from tomthumb.runner import prepare
from tomthumb.slam import Slam
from tomthumb.types import Control, Observations, Prior, Step, Truth


def world(motion=None, sensor=None, cov=None):
    motion, sensor = motion or Velocity(), sensor or RangeBearing(max_range=10.0)
    prior = Prior(np.zeros(3), np.zeros((3, 3)) if cov is None else cov)
    return Slam(motion, sensor, prior, JointCompatibility(), EKF(motion, sensor))


def scan(*z):
    return Observations(np.array(z, float).reshape(-1, 2), np.tile(np.diag([0.01, 0.001]), (len(z), 1, 1)))


def test_a_scan_between_two_readings_is_predicted_to_its_time():
    slam, straight = world(), np.array([1.0, 0.0])
    slam.step(1.0, Control(straight, 1.0), None)
    early = slam.step(1.25, None, scan())
    assert_allclose(early.pose[:2], [1.25, 0.0])
    late = slam.step(2.0, Control(straight, 1.0), None)
    assert_allclose(late.pose[:2], [2.0, 0.0], atol=1e-12)


def test_an_increment_is_not_extrapolated():
    slam = world(OdometryIncrement())
    slam.step(1.0, Control(np.array([1.0, 0, 0]), 1.0), None)
    assert_allclose(slam.step(1.5, None, scan()).pose[:2], [1.0, 0.0])


def test_the_stream_is_the_step_in_a_loop():
    one, other = (tomthumb.load("cloister", seed=5) for _ in range(2))
    trace = tomthumb.run(one, associator="jcbb", seed=5)
    slam = Slam(other.motion, other.sensor, other.prior, JointCompatibility(), InvariantEKF(other.motion, other.sensor))
    poses = [slam.step(s.t, s.control, s.observations).pose for s in other.steps]
    assert_allclose(trace.pose, poses, atol=1e-12)


@pytest.mark.parametrize(
    ("t", "control", "seen", "says"),
    [
        (0.5, None, None, "time runs back"),
        (np.nan, None, None, "time is nan"),
        (2.0, Control(np.array([np.inf, 0]), 1.0), None, "finite"),
        (2.0, Control(np.zeros(2), -1.0), None, "not negative"),
        (2.0, Control(np.zeros(2), 1.0, -np.eye(2)), None, "not positive semi-definite"),
        (2.0, None, Observations(np.array([[np.nan, 0.0]]), np.eye(2)[None]), "observation 0 is not finite"),
        (2.0, None, Observations(np.zeros((1, 2)), -np.eye(2)[None]), "not positive definite"),
        (2.0, None, Observations(np.zeros((1, 3)), np.eye(2)[None]), "must be"),
    ],
)
def test_what_cannot_be_is_one_clear_line(t, control, seen, says):
    slam = world()
    slam.step(1.0, None, scan())
    with pytest.raises(TomThumbError, match=says) as caught:
        slam.step(t, control, seen)
    assert "\n" not in str(caught.value)


def test_a_lost_filter_is_a_named_failure_and_keeps_what_it_had(monkeypatch):
    scenario = tomthumb.load("cloister", seed=1)
    calls = iter(range(1000))
    update = EKF.update

    def breaks(self, belief, observations, ids, rng):
        if next(calls) == 20:
            raise Diverged("the innovation covariance is not positive definite")
        return update(self, belief, observations, ids, rng)

    monkeypatch.setattr(EKF, "update", breaks)
    trace = tomthumb.run(scenario, associator="nn")
    assert "not positive definite at step 20" in trace.failure
    assert len(trace.t) == 20
    row = tomthumb.evaluate(trace, scenario)
    assert row["failure"] == trace.failure
    assert row["match_rate"] is not None


def test_empty_scans_and_no_scans_are_steps_too():
    slam = world()
    record = slam.step(0.0, None, scan())
    assert len(record.ids) == 0
    assert slam.step(1.0, Control(np.array([1.0, 0.1]), 1.0), None).landmarks == 0


def test_nominal_cloister_is_named_without_error():
    for seed in range(2):
        scenario = tomthumb.load("cloister", seed=seed)
        rows = {
            a: tomthumb.evaluate(tomthumb.run(scenario, associator=a, seed=seed), scenario) for a in ("stt", "jcbb")
        }
        assert rows["stt"]["match_rate"] >= 0.999
        assert rows["jcbb"]["match_rate"] >= 0.995
        assert [row["wrong_ids"] for row in rows.values()] == [0, 0]


def test_taught_for_a_lap_stt_makes_no_mistake_on_the_next():
    scenario = tomthumb.load("cloister", seed=3, laps=2, teach=1)
    assert tomthumb.evaluate(tomthumb.run(scenario, associator="stt", seed=3), scenario)["match_rate"] == 1.0


@pytest.mark.parametrize("associator", ["stt", "jcbb"])
def test_a_crowd_is_kept_out_of_the_map(associator):
    scenario = tomthumb.load("cloister", seed=2, people=30)
    row = tomthumb.evaluate(tomthumb.run(scenario, associator=associator, seed=2), scenario)
    assert row["match_rate"] >= 0.985
    assert row["ghosts"] <= 6


def test_same_seed_same_answer_and_separate_streams():
    scenario = tomthumb.load("cloister", seed=1, clutter=5, detect=0.8)
    one, two = (tomthumb.run(scenario, associator="stt", seed=1) for _ in range(2))
    assert np.array_equal(one.ids, two.ids)
    assert np.array_equal(one.pose, two.pose)


def test_the_associator_never_sees_the_truth():
    class Spy(JointCompatibility):
        def associate(self, problem, rng):
            assert not any(isinstance(v, Truth) for v in vars(problem).values())
            return JointCompatibility.associate(self, problem, rng)

    scenario = tomthumb.load("cloister", seed=1)
    assert tomthumb.run(scenario, associator=Spy()).failure is None


def test_a_sensor_that_repeats_its_errors_adds_little_at_rest():
    def spread(memory):
        sensor = Cartesian(max_range=9.0, std=(0.1, 0.1), memory=memory)
        motion = OdometryIncrement(std=(1e-3, 1e-3, 1e-3))
        slam = world(motion, sensor, cov=np.diag([1e-2, 1e-2, 1e-2]))
        seen = Observations(np.array([[2.0, 1.0], [3.0, -1.0], [4.0, 2.0]]), np.tile(0.01 * np.eye(2), (3, 1, 1)))
        for t in range(40):
            slam.step(float(t), Control(np.zeros(3), 1.0), seen)
        estimate = slam.estimate()
        return np.trace(estimate.covs[0])

    assert spread((3.0, 3.0)) > 1.05 * spread((0.0, 0.0))


@pytest.mark.parametrize(
    "settings", [{"slam": {"width": 8}, "associator": {"brothers": 8}}, {"slam": {"revision": 20}}]
)
def test_steps_without_a_scan_leave_nothing_in_the_history_of_any_branch(settings):
    """Of whichever branch or past is the best in the end: as many ids as there were observations."""
    world = tomthumb.load("cloister", seed=2, odometry_noise=8.0)
    rest = Control(np.zeros(3), 0.01, 1e-12 * np.eye(3))
    steps = [s for step in world.steps for s in (Step(step.t - 0.5, rest, None), step)]
    rested = replace(world, steps=steps[1:])
    traces = [tomthumb.run(w, associator="stt", settings=settings) for w in (world, rested)]
    np.testing.assert_array_equal(traces[1].final_ids, traces[0].final_ids)
    assert len(traces[1].final_pose) == len(steps) - 1
    assert tomthumb.evaluate(traces[1], rested)["match_rate"] == tomthumb.evaluate(traces[0], world)["match_rate"]


def test_the_record_tells_how_sure_each_decision_was():
    world = tomthumb.load("cloister", seed=1)
    slam = prepare(world, associator="stt")
    for step in world.steps[:30]:
        record = slam.step(step.t, step.control, step.observations)
    sure = record.info["confidence"]
    assert sure.shape == record.ids.shape
    assert ((sure > 0.5) & (sure <= 1.0)).all()
    assert "confidence" not in prepare(world, associator="nn").step(0.0, None, world.steps[0].observations).info
