"""The logs beside the checkout: counts equal to what their descriptions say, and residuals as small as they say."""

import math

import numpy as np
import pytest

from tomthumb.errors import TomThumbError
from tomthumb.geometry import compose
from tomthumb.scenarios import load

pytestmark = pytest.mark.data


def residuals(scenario):
    """Innovations of all observations of known landmarks at the true poses (n, 2)."""
    out = []
    for step in scenario.steps:
        if step.truth is None or step.truth.pose is None or step.truth.ids is None:
            continue
        named = step.truth.ids >= 0
        z_hat = scenario.sensor.expect(step.truth.pose, scenario.landmarks[step.truth.ids[named]])[0]
        nu = step.observations.z[named] - z_hat
        for k in scenario.sensor.angles:
            nu[:, k] = (nu[:, k] + math.pi) % (2 * math.pi) - math.pi
        out.append(nu)
    return np.vstack(out)


def dead_reckoning(scenario, until):
    """Distance from the truth after `until` s, m."""
    pose = scenario.prior.pose
    for step in scenario.steps:
        if step.control is not None:
            pose = compose(pose, scenario.motion.increment(step.control)[0])
        if step.t >= until and step.truth is not None and step.truth.pose is not None:
            return float(np.hypot(*(pose - step.truth.pose)[:2]))
    raise AssertionError("the log is shorter")


@pytest.mark.parametrize("name", ["s1_x1_GT", "s1_x1_JCBB", "s1_x1_NN", "s1_x2_GT", "s1_x2_JCBB"])
def test_golden(data, name):
    scenario = load(f"golden:{data('neira_cloister') / name}.mat", faithful="true")
    golden = scenario.info["golden"]
    assert len(scenario.steps) == 168
    assert sum(map(len, golden["matches"])) == 1390 == sum(len(s.observations) for s in scenario.steps[1:])
    assert scenario.info["faithful"] is True
    assert len(golden["state"]) == 3 + 2 * len(np.unique(golden["map_ids"][-1])) or "GT" not in name
    if golden["associator"] == "GT":
        for step, match, mapped in zip(scenario.steps[1:], golden["matches"], golden["map_ids"], strict=True):
            paired = match > 0
            np.testing.assert_array_equal(mapped[match[paired] - 1], step.truth.ids[paired])
    assert np.abs(residuals(scenario)).max() < 0.2


def test_golden_world_is_our_cloister(data):
    golden = load(f"golden:{data('neira_cloister')}/s1_x1_JCBB.mat")
    ours = load("cloister")
    np.testing.assert_allclose(golden.landmarks, ours.landmarks, atol=1e-12)
    for a, b in zip(golden.steps, ours.steps, strict=True):
        np.testing.assert_array_equal(a.truth.ids, b.truth.ids)
        np.testing.assert_allclose(a.truth.pose[:2], b.truth.pose[:2], atol=1e-9)
        if a.control is not None:
            np.testing.assert_allclose(a.control.cov, b.control.cov, atol=1e-15)


def test_lost_in_the_woods(data):
    scenario = load(str(data("utias_lost_in_the_woods")))
    assert len(scenario.steps) == 12609
    assert len(scenario.true_ids()) == 61086
    assert scenario.landmarks.shape == (17, 2)
    nu = residuals(scenario)
    np.testing.assert_allclose(nu.std(0), [0.033, math.radians(1.46)], rtol=0.1)
    assert abs(nu.mean(0)).max() < 0.02
    assert dead_reckoning(scenario, 60.0) == pytest.approx(1.3, abs=0.2)


def test_lost_in_the_woods_r_max(data):
    near = load(f"lost_in_the_woods:{data('utias_lost_in_the_woods')}?r_max=2")
    assert len(near.steps) == 12609
    assert len(near.true_ids()) / 12609 == pytest.approx(1.9, abs=0.05)
    assert max(s.observations.z[:, 0].max(initial=0) for s in near.steps) < 2.0
    with pytest.raises(TomThumbError, match="r_max"):
        load(f"lost_in_the_woods:{data('utias_lost_in_the_woods')}?r_max=0")


@pytest.mark.parametrize("detections", ["derived", "raw"])
def test_car_park(data, detections):
    scenario = load(str(data("car_park")), detections=detections)
    ids = scenario.true_ids()
    assert len(ids) == 892
    assert (ids == -1).sum() == 4
    assert scenario.landmarks.shape == (15, 2)
    nu = residuals(scenario)
    np.testing.assert_allclose(nu.std(0), [0.03, math.radians(0.55)], rtol=0.15)
    assert dead_reckoning(scenario, scenario.steps[0].t + 60.0) == pytest.approx(0.9, abs=0.2)
    assert sum(step.control.dt for step in scenario.steps[1:]) == pytest.approx(125.2, abs=0.2)
