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


@pytest.mark.parametrize("detections", ["published", "raw"])
def test_victoria_park(data, detections):
    scenario = load(f"{data('victoria_park')}?detections={detections}")
    ids = scenario.true_ids()
    assert sum(step.observations is not None for step in scenario.steps) == 7230
    assert len(np.unique(ids[ids >= 0])) == 299 == len(scenario.landmarks)
    labelled = (ids >= 0).sum()
    if detections == "published":
        assert (len(ids), labelled) == (52974, 46860)
    else:
        assert labelled > 0.99 * 46860 * 7211 / 7230  # the laser file lacks the last 19 scans
    spread = 1.4826 * np.median(np.abs(residuals(scenario)), axis=0)
    np.testing.assert_allclose(spread, [0.06, math.radians(0.19)], rtol=0.1)
    assert dead_reckoning(scenario, scenario.steps[0].t + 120.0) == pytest.approx(2.2, abs=0.3)


def test_the_other_odometry_of_victoria_park_reads_less_steering(data):
    """DRS.txt is 1.059 times aa3_dr.mat plus 0.0026 rad, at the same times."""
    readings = {}
    for record in ("drs", "aa3"):
        steps = load(f"victoria_park:{data('victoria_park')}?odometry={record}").steps
        first = [steps[k] for k in range(8000)]
        readings[record] = {round(s.t, 2): s.control.u for s in first if s.control is not None}
    both = sorted(readings["drs"].keys() & readings["aa3"].keys())
    assert len(both) > 1000
    u = {record: np.array([of[t] for t in both]) for record, of in readings.items()}
    gain, bias = np.polyfit(u["aa3"][:, 1], u["drs"][:, 1], 1)
    assert gain == pytest.approx(1.059, abs=0.01)
    assert bias == pytest.approx(0.0026, abs=0.002)
    assert np.corrcoef(u["aa3"][:, 0], u["drs"][:, 0])[0, 1] > 0.99


@pytest.mark.parametrize(("robot", "sightings"), [(1, 2578), (2, 3818), (3, 4425), (4, 1822), (5, 3424)])
def test_mrclam(data, robot, sightings):
    scenario = load(f"mrclam:{data('utias_mrclam')}?robot={robot}")
    assert len(scenario.true_ids()) == sightings
    assert scenario.landmarks.shape == (15, 2)
    assert scenario.steps[-1].t - scenario.steps[0].t == pytest.approx(15 * 60, abs=60)
    away = residuals(scenario)
    rms = np.sqrt(np.mean(away[np.abs(away[:, 0]) < 0.5] ** 2, axis=0))
    assert 0.03 < rms[0] < 0.08
    assert np.median(np.abs(away[:, 1])) < math.radians(1.0)


@pytest.mark.parametrize("robot", [1, 2, 3, 4, 5])
def test_mrclam_tells_depth_along_the_axis_not_range(data, robot):
    """What the number taken for a range lacks grows with r (1 - cos bearing); of a depth's range nothing is left of that."""

    def share(depth):
        scenario = load(f"mrclam:{data('utias_mrclam')}?robot={robot}&depth={depth}")
        away, z = residuals(scenario), np.concatenate([s.observations.z for s in scenario.steps if s.observations])
        near = np.abs(away[:, 0]) < 0.5
        lost = (z[:, 0] * (1.0 - np.cos(z[:, 1])))[near]
        return np.polyfit(lost, away[near, 0], 1)[0]

    assert share(0) == pytest.approx(-1.0, abs=0.2)
    assert abs(share(1.036)) < 0.2


def test_mrclam_has_five_robots(data):
    with pytest.raises(TomThumbError, match="robot=6"):
        load(f"mrclam:{data('utias_mrclam')}?robot=6")


@pytest.mark.parametrize(
    "wrong", ["speed=0", "speed=nan", "turn=-1", "delay=-1", "delay=1e9", "depth=-1", "depth=0.01", "depth=nan"]
)
def test_mrclam_refuses_what_cannot_be(data, wrong):
    with pytest.raises(TomThumbError, match=wrong.partition("=")[0]):
        load(f"mrclam:{data('utias_mrclam')}?{wrong}")


def test_mrclam_makes_the_shares_of_the_commands_that_are_asked_for(data):
    whole, half = (load(f"mrclam:{data('utias_mrclam')}?robot=2&turn=1&speed={share}") for share in (1.0, 0.5))
    for one, other in zip(whole.steps[:2000], half.steps[:2000], strict=True):
        if one.control is not None:
            np.testing.assert_allclose(other.control.u, one.control.u * [0.5, 1.0])


def test_dlr(data):
    scenario = load(str(data("dlr_spatial_cognition")))
    ids = scenario.true_ids()
    assert len(scenario.steps) == 3297 + 1
    assert (len(ids), (ids == -2).sum(), len(np.unique(ids[ids >= 0]))) == (14745, 436, 576)
    assert np.median(np.linalg.norm(residuals(scenario), axis=1)) == pytest.approx(0.038, abs=0.003)


def test_dlr_rectified(data):
    """Without the camera's own bend, far circles no longer stand too near at the batch solution's poses."""

    def slope(camera):
        scenario = load(f"{data('dlr_spatial_cognition')}?camera={camera}")
        away, ids, ahead = residuals(scenario), scenario.true_ids(), []
        for step in scenario.steps:
            ahead += [] if step.observations is None else (-step.observations.z[:, 1]).tolist()
        far = np.array(ahead)[ids >= 0]
        good = np.abs(away[:, 1]) < 0.3
        return abs(np.polyfit(far[good], away[good, 1], 1)[0])

    assert slope("rectified") < 0.5 * slope("published")


@pytest.mark.parametrize("name", ["cityTrees10000.txt.gz", "monte_carlo/cityTrees10000_1.txt.xz"])
def test_city_trees(data, name):
    scenario = load(f"graph:{data('city_trees_10000')}/{name}")
    assert len(scenario.steps) == 9999 + 1
    assert len(scenario.true_ids()) == 4443
    assert len(scenario.landmarks) == 100
    assert scenario.info["twins"] == 8
    assert len(np.unique(scenario.true_ids())) == 92
    np.testing.assert_allclose(residuals(scenario).std(0), [0.1, 0.1], rtol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(scenario.steps[5].control.cov)), [0.02, 0.02, 0.01], rtol=1e-9)


def test_slsjf(data):
    scenario = load(str(data("slsjf_simulated")))
    assert len(scenario.steps) == 536
    assert len(scenario.true_ids()) == 850
    assert len(np.unique(scenario.true_ids())) == 28
    np.testing.assert_allclose(residuals(scenario).std(0), [0.1, math.radians(1.0)], rtol=0.1)


def test_freiburg(data):
    scenario = load(str(data("freiburg_slam_course")))
    assert len(scenario.steps) == 331 + 1
    assert len(scenario.true_ids()) == 1212
    assert scenario.landmarks.shape == (9, 2)


@pytest.mark.parametrize(
    ("log", "frames", "near"), [("Testing4_9", 497, 9.4), ("Testing4_10", 451, 8.6), ("Testing5_2", 682, 8.5)]
)
def test_cones(data, log, frames, near):
    scenario = load(str(data("fs_driverless_prom_ntua")), log=log)
    assert len({step.t for step in scenario.steps}) == frames
    assert len(scenario.true_ids()) / frames == pytest.approx(near, abs=0.15)
    labels = np.concatenate([step.observations.labels for step in scenario.steps])
    assert set(labels) <= {0, 1, 2, 3}
    assert (scenario.true_ids() == -2).all()
    way = sum(np.hypot(*step.control.u[:2]) for step in scenario.steps if step.control is not None)
    assert way == pytest.approx(245, abs=6)


def test_cones_names_the_logs_there_are(data):
    with pytest.raises(TomThumbError, match="Testing4_10"):
        load(str(data("fs_driverless_prom_ntua")), log="Testing9")
