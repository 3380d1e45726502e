"""Lost robots: the watch calls, the king carries home, and where nobody can know he waits."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tomthumb
from tomthumb.branches import told as branches_told
from tomthumb.constellation import Fit
from tomthumb.errors import TomThumbError
from tomthumb.geometry import inverse, to_world
from tomthumb.king import Exile, King, Small, expected, small, way_home
from tomthumb.lifecycle import Life
from tomthumb.lookout import Keeping
from tomthumb.metrics.evaluation import evaluate
from tomthumb.models.sensor import RangeBearing
from tomthumb.places import Guess, thinned
from tomthumb.runner import collect, prepare
from tomthumb.scenarios.cloister import cloister
from tomthumb.scenarios.kidnap import kidnapped
from tomthumb.scout import Scouting
from tomthumb.sensing import DetectionMap
from tomthumb.types import Control, Estimate, Step
from tomthumb.watch import Consistency, Watch

KING = {"slam": {"king": True}}


def jittered(seed: int, at: int, to: int):
    return kidnapped(cloister(np.random.default_rng(seed), laps=3, jitter=0.2), at, to)


def told(scenario, associator: str = "stt", steps: int | None = None, **settings):
    """The run's trace, and what was told of the king: (step, word)."""
    slam = prepare(scenario, associator=associator, settings=settings or KING)
    records = []
    for step in list(scenario.steps)[:steps]:
        records.append(slam.step(step.t, step.control, step.observations))
    words = [(r.index, r.info["king"]) for r in records if "king" in r.info]
    return collect(scenario.name, slam, records), words, slam


@pytest.mark.parametrize(("seed", "at", "to"), [(0, 222, 313), (1, 234, 376), (2, 200, 241), (10, 203, 295)])
def test_a_kidnapped_robot_comes_home_and_all_names_are_right_again(seed, at, to):
    scenario = jittered(seed, at, to)
    trace, words, _ = told(scenario)
    home = [k for k, word in words if word == "home"]
    assert len(home) == 1
    assert at < home[0] <= at + 20
    gap = np.hypot(*(trace.pose[-1, :2] - scenario.steps[-1].truth.pose[:2]))
    assert gap < 0.15
    row = evaluate(trace, scenario)
    assert row["duplicates"] == 0
    assert row["match_rate"] > 0.97


def with_rests(scenario, count: int):
    """The same, with steps at rest, without a scan, before each of the others."""
    rest = Control(np.zeros(3), 0.01, 1e-12 * np.eye(3))
    steps = []
    for step in scenario.steps:
        steps += [Step(step.t - 0.9 + 0.1 * k, rest, None) for k in range(count if step.control is not None else 0)]
        steps.append(step)
    return replace(scenario, steps=steps)


@pytest.mark.parametrize(("seed", "at", "to"), [(3, 230, 300), (44, 200, 263)])
def test_all_poses_of_the_time_away_come_home_however_many_steps_lie_between_scans(seed, at, to):
    wrong = []
    for rests in (0, 3):
        scenario = with_rests(jittered(seed, at, to), rests)
        trace, words, _ = told(scenario, steps=(at + 30) * (1 + rests))
        assert words[-1][1] == "home"
        truth = [step.truth.pose[:2] if step.truth else [np.nan] * 2 for step in scenario.steps[: len(trace.t)]]
        gaps = np.hypot(*(trace.final_pose[:, :2] - truth).T)
        wrong.append(np.count_nonzero(gaps > 1.0))
    assert wrong[0] == wrong[1] <= 1


@pytest.mark.parametrize("associator", ["nn", "jcbb"])
def test_the_king_serves_every_associator(associator):
    _, words, _ = told(jittered(1, 234, 376), associator, steps=260)
    assert "home" in [word for _, word in words]


def test_a_robot_that_believes_to_walk_where_nothing_is_known_comes_home():
    """The robot believes to walk into the open, where nothing old can be missed."""
    scenario = jittered(44, 200, 263)
    trace, words, _ = told(scenario, steps=230)
    assert [word for _, word in words] == ["home"]
    assert np.hypot(*(trace.pose[-1, :2] - scenario.steps[229].truth.pose[:2])) < 0.1


@pytest.mark.parametrize(("seed", "at", "to"), [(5, 230, 355), (8, 215, 339), (19, 224, 268)])
def test_in_a_world_that_turns_into_itself_no_place_is_accepted(seed, at, to):
    scenario = kidnapped(cloister(np.random.default_rng(seed), laps=3), at, to)
    trace, words, slam = told(scenario, steps=at + 60)
    assert words
    assert {word for _, word in words} == {"away"}
    assert slam.court.exile is not None
    assert len(trace.final.ids) > len(slam.court.exile.old.ids)  # the old map is not lost


@pytest.mark.parametrize("options", [{}, {"people": 30}, {"odometry_noise": 4.0}, {"detect": 0.5, "clutter": 5.0}])
def test_who_is_not_lost_does_not_flee(options):
    scenario = cloister(np.random.default_rng(7), laps=2, **options)
    with_king, words, _ = told(scenario)
    without, _, _ = told(scenario, slam={"king": False})
    assert not words
    np.testing.assert_array_equal(with_king.ids, without.ids)


@pytest.mark.parametrize("frozen", [True, False])
def test_a_start_anywhere_in_a_known_map(frozen):
    world = cloister(np.random.default_rng(4), jitter=0.2)
    known = tomthumb.run(world, associator="jcbb").final
    steps = list(world.steps)[57:]
    steps[0] = replace(steps[0], control=None)
    scenario = replace(world, steps=steps)
    slam = prepare(scenario, associator="stt", settings={"slam": {"lost": True, "frozen": frozen}}, start_map=known)
    for step in steps[:20]:
        record = slam.step(step.t, step.control, step.observations)
    assert slam.court.exile is None
    assert np.hypot(*(record.pose[:2] - steps[19].truth.pose[:2])) < 0.15
    if frozen:
        assert slam.estimate().stone.sum() == known.stone.sum()


@pytest.mark.parametrize("count", [1, 39, 40, 79, 80, 1000])
def test_a_long_trail_is_thinned_and_keeps_its_end(count):
    poses = [np.array([k, 0.0, 0.0]) for k in range(count)]
    some = [int(pose[0]) for pose in thinned(poses, 40)]
    assert some[-1] == count - 1
    assert min(count, 40) <= len(some) < 80
    assert len(set(np.diff(some))) <= 1
    assert count >= 80 or some == list(range(count))


def test_what_was_seen_once_is_part_of_the_small_map():
    rows = np.arange(4)
    here = Estimate(np.zeros(3), np.eye(3), rows, np.zeros((4, 2)), np.tile(np.eye(2), (4, 1, 1)), np.ones(4, bool))
    ledger = {i: Life(seen=seen, hits=hits) for i, seen, hits in ((0, 3, 9.0), (1, 9, 1.0), (2, 10, 4.0), (3, 4, 1.0))}
    mine = small(here, ledger, scan=10)
    assert mine.part.ids.tolist() == [0, 1, 2, 3]
    assert mine.lately.tolist() == [False, True, True, False]


def test_to_be_lost_needs_a_map():
    with pytest.raises(TomThumbError, match="needs a map to be lost in"):
        prepare(cloister(np.random.default_rng(0)), settings={"slam": {"lost": True}})


def test_the_particle_filter_is_carried_home_too():
    scenario = jittered(1, 234, 376)
    slam = prepare(scenario, associator="jcbb", estimator="fastslam", settings={**KING, "estimator": {"particles": 50}})
    for step in list(scenario.steps)[:250]:
        record = slam.step(step.t, step.control, step.observations)
    assert slam.court.exile is None
    assert np.hypot(*(record.pose[:2] - scenario.steps[249].truth.pose[:2])) < 0.3


def test_kidnapping_leaves_steps_out_and_time_goes_on():
    world = cloister(np.random.default_rng(0))
    taken = kidnapped(world, 10, 50)
    assert len(taken.steps) == len(world.steps) - 39
    assert taken.steps[11].observations is world.steps[50].observations
    t = np.array([step.t for step in taken.steps])
    assert (np.diff(t) > 0).all()
    back = kidnapped(world, 100, 20)
    assert (np.diff([step.t for step in back.steps]) > 0).all()
    with pytest.raises(TomThumbError, match="kidnap 500:3"):
        kidnapped(world, 500, 3)


def test_the_watch_needs_both_what_is_missing_and_what_is_strange():
    chance, none = np.full(6, 0.95), np.zeros(6, bool)
    blind, abroad, lost = Watch(), Watch(), Watch()
    for scan in range(10):
        blind.look(chance, none, 0, scan)
        abroad.look(chance[:0], none[:0], 8, scan)
        lost.look(chance, none, 6, scan)
    assert not blind.lost
    assert not abroad.lost
    assert lost.lost


def test_the_watch_weighs_by_log_ratios_and_remembers_since_when():
    watch = Watch()
    watch.look(np.array([0.9]), np.array([True]), 0, 3)
    assert (watch.level, watch.since) == (0.0, 3)
    watch.look(np.array([0.9]), np.array([False]), 1, 4)
    assert watch.level == pytest.approx(np.log((1 - 0.3 * 0.9) / (1 - 0.9)))
    assert watch.since == 3


def test_nis_is_tested_on_both_sides():
    rng = np.random.default_rng(0)
    right, loud, quiet = Consistency(), Consistency(), Consistency()
    for _ in range(10):
        nis = rng.chisquare(12)
        right.record(nis, 12)
        loud.record(2.0 * nis, 12)
        quiet.record(0.3 * nis, 12)
    assert [c.verdict for c in (right, loud, quiet)] == ["fine", "surprised", "timid"]
    assert Consistency().verdict == "fine"


def test_any_scenario_can_be_told_to_kidnap():
    taken = tomthumb.load("cloister", laps=3, kidnap="200:300")
    assert taken.info["kidnapped"] == (200, 300)
    with pytest.raises(TomThumbError, match="two steps are wanted"):
        tomthumb.load("cloister", kidnap="200")


def test_after_a_recall_what_became_of_landmarks_fits_those_that_are_there():
    scenario = kidnapped(
        cloister(np.random.default_rng(6), jitter=0.2, laps=3, people=30, clutter=2.0, detect=0.7), 222, 313
    )
    trace, words, slam = told(scenario)
    assert any(word == "home" for _, word in words)
    ended = [one for _, one, *_ in branches_told(slam.branches[0])]
    live = set(slam.estimate().ids.tolist())
    assert not live & set(ended)
    named = set(trace.final_ids[trace.final_ids >= 0].tolist())
    assert named <= live | set(trace.died[:, 0].tolist())


def test_in_a_map_that_was_loaded_all_is_old_and_nobody_sets_out():
    world = cloister(np.random.default_rng(3), jitter=0.2, laps=2)
    first = tomthumb.run(world)
    slam = prepare(world, settings={"slam": {"king": True}}, start_map=first.final)
    out = []
    for step in list(world.steps)[:40]:
        slam.step(step.t, step.control, step.observations)
        out.append(len(slam.court.lookout.walkers))
    assert max(out) <= 1


@pytest.mark.parametrize(
    ("part", "wrong"),
    [
        (King, {"rare": 40.0}),
        (King, {"every": 0}),
        (Keeping, {"every": 0}),
        (Keeping, {"content": -0.5}),
        (Scouting, {"sizes": 9}),
    ],
)
def test_rules_that_mean_nothing_are_refused_in_a_line(part, wrong):
    with pytest.raises(TomThumbError, match=next(iter(wrong))):
        part(**wrong)


def asked_at(believed, std: float, true_pose, seed: int = 0):
    """The way home of a robot that stands at `true_pose` in a wood and believes otherwise."""
    rng = np.random.default_rng(seed)
    sensor = RangeBearing(max_range=6.0, fov=2.0 * np.pi, std=(0.05, 0.01), detect=0.95)
    points = 40.0 * rng.random((320, 2))
    q = to_world(inverse(true_pose), points)
    q = q[np.hypot(*q.T) < sensor.max_range]
    q = q + 0.03 * rng.standard_normal(q.shape)
    old = Estimate(np.array(believed), std**2 * np.eye(3), np.arange(320), points, None, np.ones(320, bool))
    part = Estimate(
        np.zeros(3), 1e-6 * np.eye(3), np.arange(len(q)), q, np.tile(0.03**2 * np.eye(2), (len(q), 1, 1)),
        np.ones(len(q), bool),
    )  # fmt: skip
    away = Exile(None, old, np.full(320, 0.95), trail=[np.zeros(3)])
    guess = Guess(old.pose, old.pose_cov, 1.0 - np.exp(-King().rare))
    return way_home(King(), away, Small(part, np.ones(len(q), bool)), guess, sensor, DetectionMap(0.95))


TRUE = np.array([20.0, 17.0, 2.0])


@pytest.mark.parametrize("seed", range(3))
def test_new_land_may_look_like_old_but_known_land_may_not(seed):
    assert asked_at([90.0, 90.0, 0.0], 0.05, TRUE, seed) is None  # all of it lies where nothing is known
    way = asked_at([28.0, 25.0, 0.0], 0.05, TRUE, seed)  # here other stones ought to be seen
    assert way is not None
    np.testing.assert_allclose(way.fit.motion, TRUE, atol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_a_place_near_the_believed_one_is_another_one_if_its_pairs_are(seed):
    way = asked_at(TRUE + np.array([0.5, -0.4, 0.2]), 0.1, TRUE, seed)
    assert way is not None
    assert not way.expected
    stays = asked_at(TRUE + np.array([0.02, 0.0, 0.0]), 0.3, TRUE, seed)
    assert stays is None or stays.expected


def place_asked(gap, beside=()):
    """A fit that turns the new map by 90 deg, for a robot that the new map knows to 1 m along its x, and to 1 cm along y."""
    match = np.array([4, 5, 6, -1])
    fit = Fit(np.array([3.0, 2.0, np.pi / 2]), 1e-6 * np.eye(3), match, 3, 9.0)
    part = Estimate(np.zeros(3), np.diag([1.0, 1e-4, 1e-4]), np.arange(4), np.zeros((4, 2)), None, np.ones(4, bool))
    guess = Guess(np.array([3.0, 2.0, np.pi / 2]) + np.append(gap, 0.0), 1e-6 * np.eye(3), 0.9)
    local = SimpleNamespace(pose=np.zeros(3))
    return fit, SimpleNamespace(local=local, here=Small(part, np.ones(4, bool)), guess=guess, beside=list(beside))


def test_how_far_a_place_may_lie_off_is_by_the_old_maps_axes():
    assert expected(*place_asked([0.0, 1.5]))  # the new map's x is the old one's y
    assert not expected(*place_asked([1.5, 0.0]))


def test_a_place_is_the_believed_one_by_most_of_its_pairs():
    elsewhere = [1.5, 0.0]
    fit, _ = place_asked(elsewhere)
    two, one = (replace(fit, match=np.array(m)) for m in ([4, 5, 9, -1], [4, 8, 9, -1]))
    assert expected(*place_asked(elsewhere, [two]))
    assert not expected(*place_asked(elsewhere, [one]))


@pytest.mark.parametrize("seed", range(3))
def test_within_the_gate_of_its_pose_nobody_is_carried(seed):
    way = asked_at(TRUE + np.array([0.15, -0.15, 0.0]), 0.08, TRUE, seed)
    assert way is None or way.expected
