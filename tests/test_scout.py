"""The scout: loops that scan by scan are missed are found, the trail is gone over again, and nothing is found elsewhere."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tomthumb import court
from tomthumb.branches import Branch, followed
from tomthumb.errors import Diverged
from tomthumb.lifecycle import Life
from tomthumb.metrics.evaluation import evaluate
from tomthumb.renaming import _count, _once
from tomthumb.retrace import retraced
from tomthumb.runner import collect, prepare
from tomthumb.scenarios.cloister import cloister
from tomthumb.scenarios.kidnap import kidnapped
from tomthumb.scout import Place, Scouting, _contradict, _twins, sent_out
from tomthumb.types import Control, Observations, Scenario, Step

LOOPS = {"slam": {"loops": True}}
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


def ring(seed: int, **odometer: float) -> Scenario:
    """A ring of posts walked round with an odometer that is wrong, and sure of itself (benchmarks/worlds.py)."""
    spec = importlib.util.spec_from_file_location("worlds", BENCHMARKS / "worlds.py")
    worlds = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(worlds)
    return worlds.ring(np.random.default_rng(seed), **odometer)


def told(scenario: Scenario, settings=None, **more):
    """The trace, its metrics, and the steps in which a loop was closed."""
    slam = prepare(scenario, settings=settings, **more)
    records = list(slam.stream(scenario.steps))
    trace = collect(scenario.name, slam, records)
    return trace, evaluate(trace, scenario), [r.index for r in records if r.info.get("king") == "loop"], slam


@pytest.mark.parametrize(("associator", "seed"), [("nn", 0), ("jcbb", 1), ("stt", 0)])
def test_a_missed_loop_is_found_and_its_names_are_put_right(associator, seed):
    _, without, _, _ = told(ring(seed), associator=associator)
    trace, row, found, slam = told(ring(seed), LOOPS, associator=associator)
    assert without["duplicates"] >= 10
    assert without["idf1"] < 0.92
    assert found
    assert row["duplicates"] <= 2
    assert row["idf1"] > 0.95
    assert row["match_rate_final"] > 0.98
    best = slam.branches[0]
    assert set(slam.estimate().ids.tolist()) == set(best.ledger)
    assert np.linalg.eigvalsh(trace.pose_cov[-1]).min() > 0.0


def test_steps_without_a_scan_change_nothing():
    scenario, rest = ring(0), Control(np.zeros(3), 0.01, 1e-12 * np.eye(3))
    steps = [
        s for step in scenario.steps for s in (Step(step.t - 0.5, rest, None), Step(step.t - 0.3, rest, None), step)
    ]
    _, row, found, _ = told(replace(scenario, steps=steps[2:]), LOOPS, associator="nn")
    assert found
    assert row["duplicates"] <= 2
    assert row["idf1"] > 0.95


@pytest.mark.parametrize("world", [{"laps": 2}, {"laps": 2, "odometry_noise": 4.0}, {"people": 30}])
def test_where_no_loop_is_missed_nothing_is_found(world):
    scenario = cloister(np.random.default_rng(3), **world)
    _, without, _, _ = told(scenario)
    _, row, found, _ = told(scenario, LOOPS)
    assert found == []
    assert {k: row[k] for k in ("match_rate", "idf1", "ate_m")} == {
        k: without[k] for k in ("match_rate", "idf1", "ate_m")
    }


def test_what_stands_beside_is_a_rival_and_what_was_never_seen_beside_is_the_same_twice():
    _, _, _, slam = told(ring(0), associator="nn")
    ledger = slam.branches[0].ledger = {i: Life(9, born=i) for i in range(6)}
    here = Place(np.zeros(3), {70: 0, 71: 1, 72: 5}, 50.0, 0.1)
    beside = Place(np.array([1.0, 0.0, 0.0]), {70: 3, 71: 4, 72: 5}, 50.0, 0.2)
    assert _twins(slam, here, beside) == {3: 0, 4: 1}
    assert _twins(slam, here, replace(beside, pose=np.array([50.0, 0.0, 0.0]))) == {}
    ledger[0].companions, ledger[1].companions = {3}, {4}
    assert _twins(slam, here, beside) == {}


def test_no_landmark_is_named_twice_in_one_scan():
    ids, first = np.array([4, 7, -1, 4, 7, -1, 9]), np.array([False, True, False, True, True, False, False])
    assert _once(ids, first).tolist() == [-1, 7, -1, 4, -1, -1, 9]
    assert _once(np.empty(0, np.int64), np.empty(0, bool)).tolist() == []
    _, _, found, slam = told(ring(0), LOOPS)
    assert found
    node = slam.branches[0].history
    while node is not None:
        node, names, *_ = node
        named = names[names >= 0]
        assert len(np.unique(named)) == len(named)


def test_what_became_of_what_became_of_a_landmark():
    assert followed({1: 2, 2: 3, 7: 8}) == {1: 3, 2: 3, 7: 8}


def test_the_trail_gone_over_with_the_same_names_leads_to_the_same_place():
    scenario = ring(1, scale=1.0, turn=0.0)
    slam = prepare(scenario, associator="nn", settings=LOOPS)
    records = list(slam.stream(scenario.steps))
    best = slam.branches[0]
    names = [r.ids for r in records]
    assert slam.court.scout is not None
    again = retraced(slam, slam.court.scout.diary, names, best.ledger)
    pose, cov = slam.estimator.pose(best.belief)
    other, _ = slam.estimator.pose(again.belief)
    gap = other - pose
    assert gap @ np.linalg.solve(cov, gap) < 9.0  # not equal: a stone counts from its first sighting now
    assert set(again.ledger) == set(best.ledger)
    assert len(_walk(again)) == len(_walk(best))


def _walk(branch: Branch) -> list[int]:
    scans, node = [], branch.history
    while node is not None:
        node, _, _, scan = node
        scans.append(scan)
    return scans


def test_the_scout_forgets_what_he_has_not_seen_for_long():
    scenario = ring(0, laps=0.9)
    slam = prepare(scenario, associator="nn", settings=LOOPS)
    slam.court.scouting = Scouting(window=40)
    for _ in slam.stream(scenario.steps):
        scout = slam.court.scout
        assert scout is not None
        assert all(scout.loop.scan - life.seen <= 40 for life in scout.branch.ledger.values())
    assert 5 < len(scout.branch.ledger) < len(slam.branches[0].ledger)
    assert set(slam.estimator.estimate(scout.branch.belief).ids.tolist()) == set(scout.branch.ledger)


def test_names_that_no_filter_survives_are_not_taken(monkeypatch):
    def lost(*_):
        raise Diverged("the covariance is not finite")

    monkeypatch.setattr("tomthumb.court.put_right", lost)
    _, without, _, _ = told(ring(0), associator="nn")
    _, row, found, _ = told(ring(0), LOOPS, associator="nn")
    assert found == []
    assert row["idf1"] == without["idf1"]


def test_a_robot_that_was_carried_has_a_new_scout_and_a_new_diary():
    scenario = kidnapped(cloister(np.random.default_rng(3), jitter=0.2, laps=3), 230, 300)
    slam = prepare(scenario, settings={"slam": {"king": True, "loops": True}})
    lengths, words = [], []
    for record in slam.stream(list(scenario.steps)[:300]):
        lengths.append(len(slam.court.scout.diary.entries) if slam.court.scout else 0)
        words.append(record.info.get("king"))
    home = words.index("home")
    assert lengths[home - 1] > 200
    assert lengths[home : home + 3] == [0, 1, 2]


def test_scans_that_are_empty_and_other_filters_are_taken_as_they_come():
    scenario = ring(0, laps=1.2)
    steps = [
        Step(s.t, s.control, Observations(np.empty((0, 2)), np.empty((0, 2, 2))), None) if k % 7 == 3 else s
        for k, s in enumerate(scenario.steps)
    ]
    for estimator, settings in (("ekf", {}), ("fastslam", {"particles": 5})):
        slam = prepare(scenario, associator="nn", estimator=estimator, settings=LOOPS | {"estimator": settings})
        assert len(list(slam.stream(steps))) == len(steps)


def test_nobody_goes_along_with_the_oracle():
    assert prepare(ring(0), associator="oracle", settings=LOOPS).court.scouting is None
    assert sent_out(prepare(ring(0)), Scouting()).loop.court.king is None


def test_names_with_which_the_trail_tears_are_not_taken():
    slam = prepare(ring(1, scale=1.0, turn=0.0), associator="nn", settings=LOOPS)
    records = list(slam.stream(ring(1, scale=1.0, turn=0.0).steps))
    lives, names = slam.branches[0].ledger, [r.ids for r in records]
    diary = slam.court.scout.diary
    retraced(slam, diary, names, lives, tear=20.0)
    early, late = names[40][names[40] >= 0][0], names[150]
    late[np.flatnonzero(late >= 0)[0]] = early  # one wrong name, from the other end of the ring
    with pytest.raises(Diverged, match="tears"):
        retraced(slam, diary, names, lives, tear=20.0)
    nobodys = [np.zeros(len(ids), bool) for ids in names]
    again = retraced(slam, diary, names, lives, tear=20.0, claimed=nobodys)  # that one pair is refuted and left out
    (pose, cov), (other, _) = (slam.estimator.pose(b.belief) for b in (slam.branches[0], again))
    assert (other - pose) @ np.linalg.solve(cov, other - pose) < 9.0


def test_two_stretches_laid_on_one_contradict_each_other():
    assert _contradict({70: 0, 71: 1, 72: 2}, {70: 3, 71: 4, 73: 9})  # one stretch of his, two of the old map
    assert _contradict({70: 0, 71: 1, 72: 2}, {80: 0, 81: 1, 83: 9})  # and the other way round
    assert not _contradict({70: 0, 71: 1, 72: 2}, {80: 3, 81: 4, 82: 5})  # a map that is torn
    assert not _contradict({70: 0, 71: 1, 72: 2}, {70: 0, 71: 1, 82: 5})


@pytest.mark.parametrize("window", [300, 400])
def test_a_memory_longer_than_the_loop_finds_it_by_its_newer_part(window):
    scenario = ring(0)
    slam = prepare(scenario, associator="nn")
    slam.court.scouting = Scouting(window=window, sizes=5)
    row = evaluate(collect("ring", slam, list(slam.stream(scenario.steps))), scenario)
    assert row["idf1"] > 0.95


def test_a_refused_loop_leaves_all_as_it_was_and_is_not_tried_at_every_look(monkeypatch):
    scenario, poses, tried = ring(0), [], []
    for refusing in (False, True):
        slam = prepare(
            scenario, associator="nn", estimator="fastslam", settings=LOOPS | {"estimator": {"particles": 5}}
        )
        slam.court.scouting = Scouting(tear=1e-6) if refusing else None
        if refusing:
            monkeypatch.setattr(
                "tomthumb.court.put_right", lambda *a, _put=court.put_right: (tried.append(1), _put(*a))[1]
            )
        poses.append(np.array([slam.step(s.t, s.control, s.observations).pose for s in scenario.steps]))
    assert len(tried) >= 2
    assert len(tried) <= 4 * 4  # windows, looks
    np.testing.assert_array_equal(*poses)


def test_sightings_that_are_renamed_end_the_silence_of_who_was_expected_from_the_wrong_pose():
    lives = {1: Life(3, hits=9.0, chances=30.0, static=9, silence=9.0), 2: Life(12, hits=4.0, static=4, silence=1.0)}
    before = [
        np.array([2, 7]),
        np.array([], int),
        np.array([2]),
    ]  # newest first: scans 12, 11 and 11 (a step without one)
    after = [np.array([2, 1]), np.array([], int), np.array([1])]
    _count(lives, before, after, [12, 11, 11])
    assert (lives[1].seen, lives[1].silence, lives[1].hits, lives[1].chances, lives[1].static) == (
        12,
        0.0,
        11.0,
        32.0,
        11,
    )
    assert (lives[2].seen, lives[2].silence, lives[2].hits, lives[2].static) == (12, 1.0, 3.0, 3)
