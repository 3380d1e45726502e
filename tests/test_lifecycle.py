"""Birth, promotion, death, merging, late names: each rule by itself."""

from __future__ import annotations

import numpy as np

from tomthumb import lifecycle
from tomthumb.lifecycle import Life, LifeCycle
from tomthumb.sensing import Clutter, DetectionMap, Surprise, _quantiles
from tomthumb.types import Predictions

POLICY = LifeCycle()


def expected(z, stone=True, cov=None):
    z = np.array(z, float)
    n = len(z)
    C = 1e-4 * np.eye(2 * n) if cov is None else cov
    return Predictions(np.arange(n), z, C, visible=np.full(n, 0.95), stone=np.full(n, stone), points=z)


def test_hits_make_a_stone_and_few_do_where_the_pose_hangs_in_the_air():
    ledger = {1: Life(0, hits=2, chances=2, static=2), 2: Life(0, hits=5, chances=5, static=5)}
    assert lifecycle.promotions(ledger, [1, 2], 5, False, POLICY)[0].tolist() == [2]
    assert lifecycle.promotions(ledger, [1, 2], 0, False, POLICY)[0].tolist() == [1, 2]
    assert lifecycle.promotions({3: Life(0)}, [3], 0, True, POLICY)[0].tolist() == [3]


def test_one_that_moves_is_never_promoted():
    ledger = {1: Life(0)}
    lifecycle.record_hits(ledger, [1] * 9, [20.0] * 9, 9, POLICY)
    assert lifecycle.promotions(ledger, [1], 9, False, POLICY)[0].tolist() == []


def test_existence_rises_with_hits_and_falls_with_opportunities():
    ledger = {1: Life(0)}
    before = ledger[1].exist
    lifecycle.record_hits(ledger, [1], [1.0], 1, POLICY)
    assert ledger[1].exist > before
    risen = ledger[1].exist
    lifecycle.record_misses(ledger, np.array([1]), np.array([0.9]))
    assert ledger[1].exist < risen


def test_with_present_a_stone_is_there_until_it_is_absent_and_a_crumb_as_often_as_it_is_seen():
    ledger = {0: Life(0, hits=10, chances=20, silence=3.0), 1: Life(0, hits=10, chances=20, silence=9.0)}
    share, two = ledger[0].exist, [[0, 0], [5, 0]]
    told = [lifecycle.with_existence(expected(two), ledger, LifeCycle(present=p)).exist for p in (False, True)]
    assert [t.tolist() for t in told] == [[share, share], [lifecycle.SURE, share]]
    crumbs = lifecycle.with_existence(expected(two, stone=False), ledger, LifeCycle(present=True))
    assert crumbs.exist.tolist() == [share, share]


def test_a_stone_that_ought_to_be_seen_dies_and_a_crumb_fades():
    ledger = {1: Life(0, hits=5, chances=20), 2: Life(0, hits=5, chances=6), 3: Life(0), 4: Life(190)}
    assert lifecycle.deaths(ledger, [1, 2], [3, 4], 200, POLICY).tolist() == [1, 3]
    assert not len(lifecycle.deaths(ledger, [1], [3], 200, POLICY.faithful()))


def test_near_a_free_landmark_is_ambiguous_near_a_taken_one_is_new():
    d2 = np.array([[5.0, 900.0], [900.0, 800.0]])
    assert lifecycle.may_be_born(d2, np.array([False, False]), POLICY).tolist() == [False, True]
    assert lifecycle.may_be_born(d2, np.array([True, False]), POLICY).tolist() == [True, True]
    assert lifecycle.may_be_born(d2, np.array([True, False]), POLICY.faithful()).tolist() == [False, True]


def test_a_late_name_needs_one_stone_and_one_claimant():
    free = np.zeros(2, bool)
    two = expected([[0, 0], [5, 0]])
    assert lifecycle.named_late(np.array([[12.0, 500.0]]), free, two, POLICY).tolist() == [0]
    assert lifecycle.named_late(np.array([[12.0, 13.0]]), free, two, POLICY).tolist() == [-1]
    assert lifecycle.named_late(np.array([[12.0, 500.0], [12.0, 500.0]]), free, two, POLICY).tolist() == [-1, -1]
    assert lifecycle.named_late(np.array([[12.0, 500.0]]), ~free, two, POLICY).tolist() == [-1]
    assert lifecycle.named_late(
        np.array([[12.0, 500.0]]), free, expected([[0, 0], [5, 0]], False), POLICY
    ).tolist() == [-1]


def test_duplicates_are_merged_only_if_never_seen_together():
    near = expected([[0, 0], [0.01, 0], [9, 9]])
    ledger = {i: Life(0) for i in range(3)}
    assert lifecycle.duplicates(ledger, near, {0}, POLICY) == [(0, 1)]
    lifecycle.record_companions(ledger, [0, 1])
    assert lifecycle.duplicates(ledger, near, {0}, POLICY) == []


def test_a_landmark_buried_in_the_same_step_is_no_duplicate():
    near = expected([[0, 0], [0.01, 0], [9, 9]])
    assert lifecycle.duplicates({i: Life(0) for i in (1, 2)}, near, {0}, POLICY) == []


def test_a_gate_as_wide_as_the_world_merges_nobody():
    wide = expected([[0, 0], [0.5, 0], [1, 1]], cov=np.eye(6))
    assert lifecycle.duplicates({i: Life(0) for i in range(3)}, wide, {0}, POLICY) == []


def test_detection_is_learned_by_range_and_direction():
    sensor = DetectionMap(0.95)
    far, near = np.array([[10.0, 0.0]]), np.array([[2.5, 0.0]])
    for k in range(200):
        sensor.record(np.vstack([far, near]), np.array([k % 4 == 0, True]))
    assert abs(sensor.chance(far)[0] - 0.25) < 0.05
    assert sensor.chance(near)[0] > 0.95
    assert sensor.chance(np.array([[-10.0, 0.0]]))[0] == 0.95


def test_surprise_is_silent_for_honest_noise_and_finds_the_factor_of_dishonest():
    rng = np.random.default_rng(0)
    for factor in (1.0, 3.0):
        surprise = Surprise()
        surprise.record((factor * rng.chisquare(2, 400)).tolist())
        assert surprise.scale == 1.0 if factor == 1.0 else abs(surprise.scale - factor) < 0.75
    crowd = Surprise()
    crowd.record(np.where(rng.random(400) < 0.02, 30.0, rng.chisquare(2, 400)).tolist())
    assert crowd.scale == 1.0


def test_clutter_density_goes_from_the_prior_to_what_is_seen():
    clutter = Clutter(area=20.0)
    assert clutter.density == 0.3
    clutter.count, clutter.scans = 200.0, 1000.0
    assert abs(clutter.density - 0.01) < 0.002


def test_quantiles_are_numpys():
    rng = np.random.default_rng(5)
    for n in (1, 2, 99, 100, 400):
        values = rng.exponential(size=n).tolist()
        assert np.allclose(
            _quantiles(values, (0.0, 0.5, 0.9, 1.0)), np.quantile(values, (0.0, 0.5, 0.9, 1.0)), atol=1e-12
        )
