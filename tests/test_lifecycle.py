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
    ledger = {0: Life(0, hits=10, chances=20, silence=2.9), 1: Life(0, hits=10, chances=20, silence=3.0)}
    share, two = ledger[0].exist, [[0, 0], [5, 0]]
    told = [lifecycle.with_existence(expected(two), ledger, p).exist for p in (False, True)]
    assert [t.tolist() for t in told] == [[share, share], [lifecycle.SURE, share]]
    crumbs = lifecycle.with_existence(expected(two, stone=False), ledger, True)
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


def at(x):
    return np.array([x, 0.0]), np.eye(2)


def test_what_two_were_one_is_after_they_are_united():
    old = Life(
        50, hits=15, chances=20, static=14, born=0, silence=2.0, place=at(0.0), visits=(9,), apart={2: 1.5, 3: 0.5}
    )
    young = Life(
        90, hits=6, chances=7, static=5, born=80, silence=4.0, returned=3, place=at(1.0), apart={1: 1.5, 3: 0.25}
    )
    third = Life(90, companions={2, 3}, apart={1: 0.5, 2: 0.25})
    for keep, drop in ((1, 2), (2, 1)):
        ledger = lifecycle.copy_ledger({1: old, 2: young, 3: third})
        lifecycle.inherit(ledger, keep, drop)
        one, beside = ledger[keep], ledger[3]
        assert sorted(ledger) == sorted([keep, 3])
        assert (one.hits, one.static, one.returned) == (21, 19, 3)
        assert (one.born, one.seen, one.silence) == (0, 90, 4.0)  # missed four times since the last sighting of either
        assert one.place[0][0] == 1.0
        assert one.visits == (9, 50)
        assert one.apart == {3: 0.75}
        assert beside.apart == {keep: 0.75}
        assert keep in beside.companions
        assert drop not in beside.companions
        assert (third.companions, third.apart) == ({2, 3}, {1: 0.5, 2: 0.25})  # that of another branch


def test_of_two_that_were_seen_together_last_the_silence_is_the_shorter_one():
    ledger = {1: Life(7, silence=3.0), 2: Life(7, silence=0.5)}
    lifecycle.inherit(ledger, 1, 2)
    assert ledger[1].silence == 0.5


def test_united_when_either_is_seen_is_seen_as_one_landmark_would_be():
    """Sightings taken in turns by two, then united, leave what one has that took them all (misses beside each other apart)."""
    both, one = {1: Life(0), 2: Life(1, born=1)}, {1: Life(0)}
    lifecycle.record_hits(one, [1], [0.5], 1, POLICY)
    for scan in range(2, 12):
        lifecycle.record_hits(both, [1 + scan % 2], [0.5], scan, POLICY)
        lifecycle.record_hits(one, [1], [0.5], scan, POLICY)
        lifecycle.record_misses(both, np.array([2 - scan % 2]), np.array([0.8]))
    lifecycle.record_misses(both, np.array([1, 2]), np.array([0.8, 0.8]))
    lifecycle.record_misses(one, np.array([1]), np.array([0.8]))
    lifecycle.inherit(both, 1, 2)
    for what in ("seen", "hits", "static", "silence", "born", "returned"):
        assert getattr(both[1], what) == getattr(one[1], what)


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
