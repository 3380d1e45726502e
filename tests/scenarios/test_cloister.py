import math

import numpy as np
import pytest

from tomthumb.errors import TomThumbError
from tomthumb.geometry import between, compose, to_frame
from tomthumb.scenarios.cloister import LAP, MOVE_STD, MOVES, SIDE, TURN_STD, TURNS, cloister, posts, walk


def world(seed=0, **options):
    return cloister(np.random.default_rng(seed), **options)


def test_first_lap_is_the_references():
    scenario = world()
    assert len(scenario.steps) == 168
    assert scenario.landmarks.shape == (88, 2)
    counts = [len(step.observations) for step in scenario.steps[1:]]
    assert sum(counts) == 1390
    assert (min(counts), max(counts)) == (4, 13)
    np.testing.assert_allclose(scenario.steps[-1].truth.pose, [0, 0, math.radians(-9)], atol=1e-12)
    assert scenario.steps[0].control is None
    assert scenario.score_from == 1


def test_posts_are_pairs_a_quarter_metre_apart():
    from scipy.spatial import cKDTree

    nearest = cKDTree(posts()).query(posts(), 2)[0][:, 1]
    assert nearest.min() == pytest.approx(0.25)
    np.testing.assert_allclose(
        posts()[[0, 6, 12, 17, 22]], [[0, -0.6], [0, -0.35], [1, 0.35], [1, 0.6], [10.6, 0]], atol=1e-12
    )


def test_noise_has_the_stated_size():
    scenario = world(3, laps=60)
    moves, turns = [], []
    for before, step in zip(scenario.steps, scenario.steps[1:], strict=False):
        motion = between(before.truth.pose, step.truth.pose)
        (moves if motion[0] > 0.1 else turns).append(step.control.u - motion)
    np.testing.assert_allclose(np.std(moves, axis=0), MOVE_STD, rtol=0.03)
    np.testing.assert_allclose(np.std(turns, axis=0), TURN_STD, rtol=0.05)
    np.testing.assert_allclose(MOVE_STD, [7.48e-3, 7.48e-3, math.radians(1.495)], rtol=1e-3)
    np.testing.assert_allclose(scenario.steps[1].control.cov, 2 * np.diag(MOVE_STD**2))


def test_observation_errors_fit_their_covariances():
    scenario = world(1, laps=20, sensor_noise=2.0)
    d2 = []
    for step in scenario.steps:
        true = to_frame(step.truth.pose, scenario.landmarks[step.truth.ids])
        nu = step.observations.z - true
        d2.append(np.einsum("mi,mij,mj->m", nu, np.linalg.inv(step.observations.R), nu))
    d2 = np.concatenate(d2)
    assert d2.mean() == pytest.approx(2.0, abs=5 * 2 / math.sqrt(len(d2)))


def test_laps_repeat_the_path_and_the_taught_ones_are_not_scored():
    two, one = world(5, laps=2, teach=1), world(5)
    assert len(two.steps) == 2 * LAP
    assert two.score_from == two.teach_steps == LAP
    np.testing.assert_allclose(two.steps[LAP].truth.pose, np.zeros(3), atol=1e-9)
    np.testing.assert_array_equal(two.steps[100].observations.z, one.steps[100].observations.z)
    np.testing.assert_array_equal(two.steps[167].control.u, one.steps[167].control.u)


@pytest.mark.parametrize(
    "option",
    [{"people": 10}, {"clutter": 5.0}, {"detect": 0.8}, {"odometry_noise": 4.0}, {"occlusion": True}, {"people": 3}],
)
def test_an_option_leaves_all_other_noise_as_it_was(option):
    plain, other = world(7), world(7, **option)
    for a, b in zip(plain.steps, other.steps, strict=True):
        common = np.intersect1d(a.truth.ids, b.truth.ids[b.truth.ids >= 0])
        rows_a, rows_b = (np.flatnonzero(np.isin(s.truth.ids, common)) for s in (a, b))
        np.testing.assert_array_equal(a.observations.z[rows_a], b.observations.z[rows_b])
        if a.control is not None and "odometry_noise" not in option:
            np.testing.assert_array_equal(a.control.u, b.control.u)


def test_odometry_noise_scales_the_same_draws():
    one, four = world(2), world(2, odometry_noise=4.0)
    truth = between(one.steps[3].truth.pose, one.steps[4].truth.pose)
    np.testing.assert_allclose(4 * (one.steps[4].control.u - truth), four.steps[4].control.u - truth)
    np.testing.assert_allclose(16 * one.steps[4].control.cov, four.steps[4].control.cov)


def test_without_odometry_the_reading_is_zero():
    step = world(odometry="none", odometry_noise=2.0).steps[9]
    np.testing.assert_array_equal(step.control.u, np.zeros(3))
    np.testing.assert_allclose(np.sqrt(np.diag(step.control.cov)), [0.5, 0.2, math.radians(10)])


def test_clutter_and_missed_detections_have_the_stated_rates():
    scenario = world(11, laps=10, clutter=5.0, detect=0.8)
    ids = scenario.true_ids()
    steps = len(scenario.steps)
    assert (ids == -1).sum() / steps == pytest.approx(5.0, abs=4 * math.sqrt(5 / steps))
    full = (world(11, laps=10).true_ids() >= 0).sum()
    assert (ids >= 0).sum() / full == pytest.approx(0.8, abs=4 * 0.4 / math.sqrt(full))
    assert scenario.sensor.detect == 0.8
    assert scenario.sensor.clutter == pytest.approx(5.0 / (math.pi * 3.5**2 / 2))


def test_clutter_is_uniform_over_the_view():
    scenario = world(4, laps=10, clutter=8.0)
    z = np.vstack([s.observations.z[s.truth.ids < 0] for s in scenario.steps])
    inner = (np.hypot(z[:, 0], z[:, 1]) < 3.5 / math.sqrt(2)).mean()
    assert inner == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(len(z)))
    assert (z[:, 1] > 0).mean() == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(len(z)))


def test_people_stay_in_the_square_and_do_not_run():
    places = walk(50, 400, np.random.default_rng(0))
    assert places.min() >= 0.0
    assert places.max() <= 10.0
    assert np.hypot(*np.moveaxis(np.diff(places, axis=0), -1, 0)).max() <= 0.15 + 1e-12
    assert (world(people=30).true_ids() == -1).any()


def test_occlusion_hides_what_is_behind_a_nearer_post():
    plain, hidden = world(6), world(6, occlusion=True)
    assert 0 < len(hidden.true_ids()) < len(plain.true_ids())
    for a, b in zip(plain.steps, hidden.steps, strict=True):
        missing = np.setdiff1d(a.truth.ids, b.truth.ids)
        for j in missing:
            assert _line_is_blocked(a.truth.pose, plain.landmarks, int(j))


def _line_is_blocked(pose, landmarks, j):
    target = to_frame(pose, landmarks[j : j + 1])[0]
    others = np.delete(to_frame(pose, landmarks), j, axis=0)
    r = np.linalg.norm(target)
    along, across = others @ target / r, np.abs(others[:, 0] * target[1] - others[:, 1] * target[0]) / r
    return bool(((along > 0) & (np.linalg.norm(others, axis=1) < r) & (across < 0.05 + 1e-9)).any())


def test_spacing_changes_the_density_and_keeps_the_pairs():
    assert len(posts(1.0)) == 4 * (2 * 11 + 2 * 10)
    assert len(posts(2.0)) == 88
    assert np.linalg.norm(np.diff(posts(1.0)[[0, 11]], axis=0)) == pytest.approx(0.25)


def test_dead_reckoning_drifts_within_what_the_filter_is_told():
    ends = []
    for seed in range(40):
        pose = np.zeros(3)
        for step in world(seed).steps[1:]:
            pose = compose(pose, step.control.u)
        ends.append(pose[2] - math.radians(-9))
    expected = math.sqrt(128 * MOVE_STD[2] ** 2 + 39 * TURN_STD[2] ** 2)
    assert np.std(np.mod(np.array(ends) + math.pi, 2 * math.pi) - math.pi) == pytest.approx(expected, rel=0.4)


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ({"laps": 0}, "laps"),
        ({"teach": 1}, "teach"),
        ({"people": -1}, "people"),
        ({"detect": 1.5}, "detect"),
        ({"detect": math.nan}, "detect"),
        ({"odometry": "gps"}, "odometry"),
        ({"sensor_noise": 0.0}, "sensor_noise"),
        ({"clutter": -1.0}, "clutter"),
        ({"spacing": 0.0}, "spacing"),
        ({"jitter": -0.1}, "jitter"),
    ],
)
def test_values_out_of_range_are_named(option, word):
    with pytest.raises(TomThumbError, match=word):
        world(**option)


def test_other_routes_begin_after_the_taught_laps_and_keep_to_the_path():
    usual, back, shuttle = (
        cloister(np.random.default_rng(1), laps=3, teach=1, route=r) for r in ("round", "reversed", "shuttle")
    )
    poses = [np.array([s.truth.pose for s in world.steps]) for world in (usual, back, shuttle)]
    assert [len(p) for p in poses] == [3 * LAP, 3 * LAP + TURNS, LAP + 2 * (4 * MOVES + 6 * TURNS)]
    for taken in poses[1:]:
        np.testing.assert_allclose(taken[:LAP], poses[0][:LAP], atol=1e-12)
        on_path = np.abs(taken[:, :2] - np.clip(taken[:, :2], 0.0, SIDE)) < 1e-9
        assert on_path.all()
        assert (np.minimum(np.abs(taken[:, :2]), np.abs(taken[:, :2] - SIDE)).min(1) < 1e-9).all()
    assert poses[1][-1, 2] == pytest.approx(math.pi / 2 + math.pi / 2 / TURNS)  # one turn short of where it set off
    assert set(map(tuple, poses[2][LAP:, :2].round(6))) < set(map(tuple, poses[0][:LAP, :2].round(6)))


def test_posts_are_dressed_without_changing_anything_else():
    plain = cloister(np.random.default_rng(2), people=3, clutter=1.0)
    worn = cloister(np.random.default_rng(2), people=3, clutter=1.0, classes=3, confusion=0.2, diameter_std=0.05)
    labels, widths, ids = [], [], []
    for a, b in zip(plain.steps, worn.steps, strict=True):
        np.testing.assert_array_equal(a.observations.z, b.observations.z)
        labels.append(b.observations.labels)
        widths.append(b.observations.signature)
        ids.append(b.truth.ids)
    label, width, who = map(np.concatenate, (labels, widths, ids))
    wrong, spread = [], []
    for post in np.unique(who[who >= 0]):
        mine = label[who == post]
        wrong.append((mine != np.bincount(mine).argmax()).mean())
        spread.append(width[who == post].std(ddof=1) ** 2)
    assert np.mean(wrong) == pytest.approx(0.2 * 2 / 3, abs=0.03)
    assert np.sqrt(np.mean(spread)) == pytest.approx(0.05, rel=0.1)
