"""New land that may be a copy of the old: what counts for both of two branches, and when there are brothers at all."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tomthumb.branches import Branch, Child, Scan
from tomthumb.copies import NOWHERE, level
from tomthumb.doubt import Trials, mostly_stands
from tomthumb.lifecycle import LifeCycle
from tomthumb.metrics import evaluate
from tomthumb.models.sensor import RangeBearing
from tomthumb.runner import prepare, run
from tomthumb.scenarios.cloister import cloister
from tomthumb.types import Array, Observations, Predictions

SENSOR = RangeBearing(std=(0.05, 0.02), max_range=4.0, fov=math.pi)


def predictions(**other: Any) -> Predictions:
    some: dict[str, Any] = {"ids": np.array([3, 5, 8]), "z_hat": np.zeros((3, 2)), "cov": np.eye(6)}
    return Predictions(**(some | other))


def trail(*poses: tuple[float, float, float]) -> Any:
    history = None
    for k, pose in enumerate(poses):
        history = (history, np.empty(0, np.int64), np.array(pose), k)
    return history


def test_land_is_new_where_no_pose_has_looked() -> None:
    """Held against every pose by itself, over several blocks of them, with the sensor's half plane ahead."""
    way = [(0.5 * k, 0.0, 0.0) for k in range(200)]
    land, rng = NOWHERE.until(trail(*way), 200, 0.2), np.random.default_rng(0)
    points = rng.uniform((-10.0, -8.0), (110.0, 8.0), (300, 2))
    seen = np.zeros(300, bool)
    for pose in way:
        seen |= SENSOR.in_view(SENSOR.expect(np.array(pose), points)[0], np.full((300, 2), 1e-4)) > 0.5
    assert 50 < seen.sum() < 250
    np.testing.assert_array_equal(land.is_new(points, SENSOR), ~seen)


def test_land_goes_on_from_where_it_was_asked_last_and_begins_anew_where_history_is_rewritten() -> None:
    way = [(0.1 * k, 0.0, 0.0) for k in range(50)]
    first = trail(*way[:30])
    land = NOWHERE.until(first, 30, 0.25)
    longer = first
    for k in range(30, 50):
        longer = (longer, np.empty(0, np.int64), np.array(way[k]), k)
    np.testing.assert_allclose(land.until(longer, 50, 0.25).poses, NOWHERE.until(longer, 50, 0.25).poses)
    assert len(land.poses) < 30  # thinned
    moved = trail(*[(x, 7.0, 0.0) for x, _, _ in way])
    np.testing.assert_allclose(land.until(moved, 50, 0.25).poses[:, 1], 7.0)
    assert NOWHERE.until(None, 0, 0.25).is_new(np.zeros((2, 2)), SENSOR).all()


def test_a_pose_without_a_scan_has_not_looked_and_one_that_has_only_turned_has() -> None:
    still, counted = (
        np.empty(0, np.int64),
        [0, 1, 1, 1],
    )  # scans before: the first step has one, then two controls, then one
    history = None
    for x, scans in zip((0.0, 10.0, 20.0, 30.0), counted, strict=True):
        history = (history, still, np.array([x, 0.0, 0.0]), scans)
    assert NOWHERE.until(history, 2, 0.25).poses[:, 0].tolist() == [0.0, 30.0]
    assert NOWHERE.until(history, 1, 0.25).poses[:, 0].tolist() == [0.0]  # the last one had no scan either
    behind = np.array([[-2.0, 0.0]])
    assert NOWHERE.until(trail((0, 0, 0)), 1, 0.25).is_new(behind, SENSOR).all()
    assert not NOWHERE.until(trail((0, 0, 0), (0, 0, math.pi)), 2, 0.25).is_new(behind, SENSOR).any()


def turned_back(pose: Array, seen: Array) -> Child:
    """A branch at `pose` that has stood at the origin, and what it makes of the scan: nothing."""
    slam = prepare(cloister(np.random.default_rng(0)))
    branch = Branch(slam.estimator.init(pose, 1e-6 * np.eye(3), np.random.default_rng(0)), {}, history=trail((0, 0, 0)))
    return branch, [predictions()], [np.full(len(seen), -1)], {}


def family(pose: Array, match: list[int]) -> tuple[Any, list[Child], Scan]:
    """The robot at `pose` sees two things 3 m ahead; a brother is 2 m behind, and pairs as told."""
    slam = prepare(cloister(np.random.default_rng(0)))
    slam.sensor, slam.scan = SENSOR, 1
    z = np.array([[3.0, -0.2], [3.0, 0.2]])
    seen = Observations(z, np.tile(np.diag([0.0025, 0.0004]), (2, 1, 1)))
    scan = Scan(seen, seen, seen, np.arange(2))
    old = predictions(z_hat=np.array([z[0], z[1], [1.0, 1.0]]), cov=1e-4 * np.eye(6), visible=np.full(3, 0.9))
    one, other = turned_back(pose, z), turned_back(pose - np.array([2.0, 0.0, 0.0]), z)
    return slam, [one, (other[0], [old], [np.array(match)], {})], scan


def test_what_is_new_here_and_old_elsewhere_counts_for_both() -> None:
    slam, children, scan = family(np.array([2.0, 0.0, 0.0]), [0, 1])
    level(slam, children, scan)
    both = children[1][0].log_weight
    pair = -math.log(2 * math.pi * math.sqrt((0.0025 + 1e-4) * (0.0004 + 1e-4))) + math.log(0.9 / 0.1)
    density = slam.problem(children[1][1][0], scan.raw, scan.serials).clutter
    assert both == pytest.approx(-(2 * pair - np.log(density).sum()), rel=1e-6)
    slam, children, scan = family(np.array([2.0, 0.0, 0.0]), [0, -1])
    level(slam, children, scan)
    assert children[1][0].log_weight == pytest.approx(both / 2)


def test_who_leads_by_finding_the_old_is_caught_up_with() -> None:
    slam, children, scan = family(np.array([2.0, 0.0, 0.0]), [0, 1])
    leader, right = children[::-1]
    level(slam, [leader, right], scan)
    assert right[0].log_weight > 5.0
    assert leader[0].log_weight == right[0].evidence == 0.0  # what is given for a copy explains nothing


def test_what_both_pair_counts_for_neither() -> None:
    slam, children, scan = family(np.array([2.0, 0.0, 0.0]), [0, 1])
    level(slam, children, scan)
    both = children[1][0].log_weight
    slam, children, scan = family(np.array([2.0, 0.0, 0.0]), [0, 1])
    children[0] = (*children[0][:2], [np.array([2, -1])], {})
    level(slam, children, scan)
    assert children[1][0].log_weight == pytest.approx(both / 2)


def test_nothing_counts_for_both_in_land_that_is_known_or_at_the_same_place() -> None:
    slam, children, scan = family(np.array([0.0, 0.0, 0.0]), [0, 1])  # both have been in view from the origin
    level(slam, children, scan)
    assert children[1][0].log_weight == 0.0
    slam, children, scan = family(np.array([2.0, 0.0, 0.0]), [0, 1])
    children[1] = (turned_back(np.array([2.0, 0.0, 0.0]), scan.raw.z)[0], *children[1][1:])  # where the other one is
    level(slam, children, scan)
    assert children[1][0].log_weight == 0.0


def test_there_are_no_brothers_where_most_new_things_do_not_stand() -> None:
    policy = LifeCycle()
    assert not mostly_stands(Trials(), policy)  # nothing is known yet
    assert mostly_stands(Trials(stood=2), policy)
    assert not mostly_stands(Trials(stood=2, faded=2), policy)
    assert mostly_stands(Trials(faded=9), replace(policy, doubt=0.0))


@pytest.mark.parametrize("seed", [905, 921])
def test_a_brother_a_period_off_does_not_win_by_finding_the_old_where_the_right_one_finds_the_new(seed: int) -> None:
    """Cloisters without odometry in which a brother one post back was believed, before copies counted for both."""
    world = cloister(np.random.default_rng(seed), odometry="none", odometry_noise=2.0)
    with_brothers = {"slam": {"present": True, "width": 8}, "associator": {"brothers": 8}}
    assert evaluate(run(world, seed=seed, settings=with_brothers), world)["match_rate"] > 0.999
