"""Graves, those who return, and twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtri

from tomthumb import lifecycle
from tomthumb.branches import Branch
from tomthumb.graves import WIDER, Grave, Graveyard
from tomthumb.lifecycle import Life, LifeCycle
from tomthumb.models.sensor import Cartesian
from tomthumb.returns import chance, look_back
from tomthumb.sensing import DetectionMap
from tomthumb.twins import NEVER, PAIRS, record_apart
from tomthumb.types import Observations, Predictions

POLICY = LifeCycle()
HERE = (np.zeros(3), 1e-6 * np.eye(3))


def grave(x, y, static=4, returned=0, visits=(0,)):
    return Grave(np.array([x, y], float), 0.01 * np.eye(2), static, returned, visits)


def scan(*z):
    z = np.array(z, float)
    return Observations(z, np.tile(0.01 * np.eye(2), (len(z), 1, 1)))


def test_graves_within_the_gate_and_visits_around_as_brute_force_finds_them():
    rng = np.random.default_rng(0)
    dead = [grave(*rng.normal(0.0, 1.0, 2), visits=tuple(range(int(rng.integers(1, 4))))) for _ in range(40)]
    yard = Graveyard().and_buried(dead[:25]).and_buried(dead[25:])
    places = rng.normal(0.0, 1.0, (30, 2))
    spread = np.einsum("nij,nkj->nik", *[rng.normal(0.0, 0.1, (30, 2, 2))] * 2) + 1e-4 * np.eye(2)
    gate2 = float(chdtri(2, 0.01))
    d2 = np.array(
        [
            [(g.place - p) @ np.linalg.solve(g.cov + S, g.place - p) for g in dead]
            for p, S in zip(places, spread, strict=True)
        ]
    )
    found = yard.at(places, spread, gate2)
    assert len({n for what in found for n in what.there.tolist()}) == (d2.min(0) < gate2).sum() > 5
    for k, what in enumerate(found):
        np.testing.assert_array_equal(what.there, np.flatnonzero((d2[k] < gate2) & (d2.argmin(0) == k)))
        near = (d2[k] >= gate2) & (d2[k] < WIDER**2 * gate2)
        assert what.around == sum(len(g.visits) for g, inside in zip(dead, near, strict=True) if inside)


def test_an_emptied_grave_is_not_found_again_and_the_others_keep_their_places():
    yard = Graveyard().and_buried([grave(0, 0), grave(5, 0), grave(9, 0, static=7)]).without(np.array([1]))
    found = yard.at(np.array([[5.0, 0.0], [9.0, 0.0]]), np.tile(0.01 * np.eye(2), (2, 1, 1)), 9.0)
    assert [what.there.tolist() for what in found] == [[], [1]]
    assert yard.graves[1].static == 7


def test_how_many_places_of_so_many_visits_chance_gives_is_what_a_simulation_gives():
    """Visits thrown at random, 0.5 in the gate on average: how often the founder of one finds two others there."""
    rng, ring, trials = np.random.default_rng(1), WIDER**2 - 1.0, 20000
    mean = 0.5
    there = [grave(0, 0, visits=(0,)), grave(0, 0, visits=(500,))]
    told = chance(there, int(mean * ring) - 1, 1, 1000, POLICY.patience)
    assert told == pytest.approx(np.mean(rng.poisson(mean, trials) >= 2), abs=0.005)
    assert chance([], 0, 10, 1000, POLICY.patience) == math.inf


def test_visits_soon_after_one_another_are_one():
    once = chance([grave(0, 0, visits=(0, 60, 120))], 10, 100, 300, 100)
    assert once == chance([grave(0, 0, visits=(120,))], 10, 100, 300, 100)
    assert chance([grave(0, 0, visits=(0, 120))], 10, 100, 300, 100) < once / 10.0
    assert chance([grave(0, 0, visits=(0, 120))], 10, 100, 200, 100) == once  # the last of them goes on
    assert chance([grave(0, 0, visits=(250,))], 10, 100, 300, 100) == math.inf


def test_what_is_founded_at_a_grave_has_come_back_and_needs_two_sightings_more():
    branch = Branch(None, {7: Life(3), 8: Life(3)}, {7, 8}, Graveyard().and_buried([grave(2, 0), grave(50, 50)]))
    look_back(branch, HERE, Cartesian(), scan([2.0, 0.0], [4.0, 4.0]), np.array([7, 8]), np.array([True, True]), POLICY)
    assert (branch.ledger[7].static, branch.ledger[7].returned) == (POLICY.hits - POLICY.few + 1, 1)
    assert (branch.ledger[8].static, branch.ledger[8].returned) == (1, None)
    assert len(branch.graves.graves) == 1
    np.testing.assert_allclose(branch.ledger[8].place[0], [4.0, 4.0])
    for count in range(1, POLICY.few + 1):
        ready = lifecycle.promotions(branch.ledger, [7], 9, False, POLICY)[0].tolist()
        assert ready == ([7] if count == POLICY.few else [])
        lifecycle.record_hits(branch.ledger, [7], [1.0], 4, POLICY)


def test_two_single_sightings_do_not_add_up():
    risen = lifecycle.risen(Life(0), [grave(0, 0, static=1)], 1.0, POLICY)
    assert (risen.static, risen.returned) == (1, 1)


def test_single_sightings_add_up_where_chance_gives_no_such_place():
    there = [grave(0, 0, static=1, returned=2, visits=(0, 200, 400))]
    assert lifecycle.risen(Life(600), there, POLICY.chance, POLICY).static == 1
    risen = lifecycle.risen(Life(600), there, POLICY.chance / 2.0, POLICY)
    assert (risen.static, risen.returned, risen.visits) == (4, 3, (0, 200, 400))


def test_all_graves_at_a_place_are_of_what_is_founded_there():
    there = [grave(0, 0, static=2, visits=(10,)), grave(0, 0, static=3, visits=(5,))]
    risen = lifecycle.risen(Life(600), there, 1.0, POLICY)
    assert (risen.static, risen.returned, risen.visits) == (1 + 1 + 2, 1 + 3, (5, 10))
    assert lifecycle.risen(Life(600), [], math.inf, POLICY) == Life(600)


def test_who_came_back_from_an_absence_outlives_who_did_not():
    ledger = {1: Life(0), 2: Life(0)}
    lifecycle.record_hits(ledger, [1, 2], [1.0, 1.0], 0, POLICY)
    lifecycle.record_misses(ledger, np.array([1]), np.array([POLICY.trial]))
    for k in range(POLICY.proof):
        lifecycle.record_hits(ledger, [1, 2], [1.0, 1.0], 1 + k, POLICY)
    lifecycle.record_misses(ledger, np.array([1, 2]), np.array([40.0, 40.0]))
    assert ledger[1].exist < ledger[2].exist < POLICY.purge
    assert lifecycle.deaths(ledger, [1, 2], [], 50, POLICY).tolist() == [2]


def test_a_crumb_that_is_proven_is_spared_but_not_for_ever():
    ledger = {i: Life(0, hits=1.0, chances=9.0, returned=back) for i, back in ((1, POLICY.proof), (2, 1))}
    assert lifecycle.deaths(ledger, [], [1, 2], 50, POLICY).tolist() == [2]
    assert lifecycle.deaths(ledger, [], [1], POLICY.patience + 1, POLICY).tolist() == [1]


def test_the_lesser_of_two_that_are_one_leaves_its_proof_to_the_other():
    ledger = {1: Life(0, hits=9.0), 2: Life(0, hits=4.0, returned=5), 3: Life(0, hits=2.0)}
    ledger[2].apart = {1: 1.0, 3: 1.0}
    lifecycle.bequeath(ledger, np.array([2]))
    assert [ledger[i].returned for i in (1, 2, 3)] == [5, 5, None]


def test_of_two_beside_each_other_the_lesser_is_not_spared():
    ledger = {i: Life(0, hits=hits, chances=90.0, returned=9) for i, hits in ((1, 20.0), (2, 10.0), (3, 10.0))}
    ledger[1].apart = {2: 1.0, 3: 1.0}
    ledger[2].apart, ledger[3].apart = {1: 1.0}, {1: 1.0}
    lifecycle.record_companions(ledger, [1, 3])  # seen together once: two things
    assert lifecycle.deaths(ledger, [1, 2, 3], [], 50, POLICY).tolist() == [2]


def beside(gap):
    points = np.array([[5.0, 0.0], [5.0, gap], [9.0, 4.0], [9.0, -4.0]])
    return Predictions(
        np.arange(4), points, 1e-4 * np.eye(8), visible=np.full(4, 0.95), stone=np.ones(4, bool), points=points
    )


def test_two_that_are_never_seen_together_are_one_after_so_many_chances():
    def rounds(gap, companions=False):
        ledger = {i: Life(0, hits=30.0, chances=30.0) for i in range(4)}
        ledger[1].hits = 29.0
        if companions:
            lifecycle.record_companions(ledger, [0, 1])
        for k in range(50):
            found = record_apart(ledger, beside(gap), {k % 2, 2}, DetectionMap(0.95), scan([5.0, 0.0]), POLICY)
            if found:
                return k + 1, found
        return 50, []

    count, found = rounds(0.2)
    assert found == [(0, 1)]
    few = math.log(1.0 / PAIRS)  # nats that two stand so near
    assert NEVER - few <= count <= NEVER - few + 2  # the chance of both is 0.94 in each of these scans
    assert count < rounds(0.7)[0] <= NEVER + 2  # a quarter of the usual distance is less strange
    assert rounds(0.2, companions=True)[1] == []
    assert rounds(3.0)[1] == []
