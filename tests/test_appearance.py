"""Looks as evidence: running moments, the ratio against densities written out, gates, and that they decide in the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tomthumb
from tomthumb import registry
from tomthumb.appearance import Crowd, Looks, Moments, Weight, class_ratio, weigh, with_looks
from tomthumb.associators.oracle import Oracle
from tomthumb.errors import TomThumbError
from tomthumb.kernels.gates import innovations
from tomthumb.lifecycle import Life, copy_ledger, record_looks
from tomthumb.types import AssociationProblem, Observations, Predictions

values = st.lists(st.floats(-100, 100), max_size=20)


@given(values, values)
def test_moments_are_those_of_the_sample_however_it_is_put_together(first, second):
    one, other = Moments(), Moments()
    for value in first:
        one = one.and_one(value)
    for value in second:
        other = other.and_one(value)
    whole, sample = one.and_all(other), np.array(first + second)
    assert whole.count == len(sample)
    if len(sample) > 1:
        assert whole.mean == pytest.approx(sample.mean(), abs=1e-9)
        assert whole.variance == pytest.approx(sample.var(ddof=1), abs=1e-7)


def test_what_is_not_known_changes_nothing():
    known = Moments().and_one(0.4)
    assert known.and_one(np.nan) is known
    looks = Looks().and_seen(Observations(np.zeros((1, 2)), np.zeros((1, 2, 2)), np.array([-1]), np.array([np.nan])), 0)
    assert looks.label == -1
    assert looks.signature.count == 0


def scan(labels=None, signature=None):
    m = len(labels if labels is not None else signature)
    as_labels = None if labels is None else np.array(labels)
    return Observations(
        np.zeros((m, 2)), np.tile(np.eye(2), (m, 1, 1)), as_labels, None if signature is None else np.array(signature)
    )


def test_a_class_is_the_one_with_most_votes():
    looks = Looks()
    for label in (2, 1, 1, -1, 2, 1):
        looks = looks.and_seen(scan(labels=[label]), 0)
    assert looks.label == 1
    assert looks.and_also(Looks({2: 5})).label == 2


def gaussian(x, mean, var):
    return np.exp(-0.5 * (x - mean) ** 2 / var) / np.sqrt(2 * np.pi * var)


def crowd_of(widths, within=0.01, freedom=50.0):
    crowd = Crowd(within=within * freedom, freedom=freedom)
    crowd.record(scan(signature=widths))
    return crowd


def test_the_ratio_is_that_of_the_densities_written_out():
    rng = np.random.default_rng(1)
    crowd = crowd_of(rng.normal(0.5, 0.2, 200))
    own = Moments(3.0, 0.7, 0.02)
    predictions = with_looks(expected(2), [Looks(signature=own), Looks()], crowd)
    assert np.isnan(predictions.signature[1])
    s = np.array([0.65, 0.2, np.nan])
    found = weigh(scan(signature=s), predictions, crowd, Weight("ratio", stray=0.05))
    var = crowd.spread(own)
    for i in range(2):
        same, any_one = gaussian(s[i], 0.7, var), gaussian(s[i], crowd.all.mean, crowd.all.variance)
        assert found.ratio[i, 0] == pytest.approx(np.log(0.95 * same / any_one + 0.05), abs=1e-9)
    assert (found.ratio[:, 1] == 0).all()
    assert (found.ratio[2] == 0).all()
    assert (found.ratio >= np.log(0.05) - 1e-12).all()


def expected(n):
    return Predictions(np.arange(n), np.zeros((n, 2)), np.eye(2 * n))


def test_the_spread_goes_from_everybodys_to_ones_own():
    crowd = crowd_of(np.random.default_rng(2).normal(0.5, 0.2, 500), within=0.01, freedom=1e6)
    assert crowd.spread(Moments(1.0, 0.5, 0.0)) == pytest.approx(0.02, rel=1e-3)  # 0.01 and the mean's own error
    many = Moments(1001.0, 0.5, 1000 * 0.0004)
    assert crowd.spread(many) == pytest.approx(0.0004, rel=0.15)


def test_deviations_from_ones_own_mean_estimate_the_spread_within():
    rng, crowd = np.random.default_rng(3), Crowd()
    ledger = {i: Life(0) for i in range(100)}
    widths = rng.normal(0.5, 0.2, 100)
    for _ in range(20):
        seen = scan(signature=widths + 0.05 * rng.standard_normal(100))
        crowd.record(seen)
        record_looks(ledger, range(100), seen, np.arange(100), crowd)
    assert crowd.freedom == 1900
    assert np.sqrt(crowd.within / crowd.freedom) == pytest.approx(0.05, rel=0.1)
    assert np.sqrt(crowd.all.variance) == pytest.approx(np.hypot(0.2, 0.05), rel=0.2)


def test_a_gate_lets_its_share_through_and_bars_the_rest_for_everybody():
    rng = np.random.default_rng(4)
    crowd = crowd_of(rng.normal(0.5, 0.2, 5000), within=0.01, freedom=1e9)
    predictions = with_looks(expected(1), [Looks(signature=Moments(1e9, 0.5, 1e7))], crowd)
    s = 0.5 + 0.1 * rng.standard_normal(4000)
    barred = weigh(scan(signature=s), predictions, crowd, Weight("gate", gate=0.95)).barred
    assert barred.mean() == pytest.approx(0.05, abs=0.015)
    assert weigh(scan(signature=s), predictions, crowd, Weight("off")).barred is None


def test_classes_as_a_ratio_of_what_was_counted():
    crowd = Crowd(classes={0: 60, 1: 30, 2: 9})
    mine, theirs = np.array([0, 1, 2, -1]), np.array([0, 1, -1])
    found = class_ratio(mine, theirs, crowd, 0.1)
    share = np.array([61, 31, 10]) / 103
    assert found[0, 0] == pytest.approx(np.log(0.9 / share[0] + 0.1))
    assert found[1, 0] == pytest.approx(np.log(0.1))
    assert (found[:, 2] == 0).all()
    assert (found[3] == 0).all()
    # weighed by how often each class is read for a landmark of class 0, the ratios have mean 1: they lose nothing
    probability = 0.9 * np.array([1, 0, 0]) + 0.1 * share
    assert (share * np.exp(found[:3, 0])).sum() == pytest.approx(probability.sum(), abs=0.02)


@pytest.mark.parametrize("value", [{"signature": "perhaps"}, {"stray": 0.0}, {"confusion": 1.0}, {"gate": 1.0}])
def test_what_cannot_be_is_refused(value):
    with pytest.raises(TomThumbError):
        Weight(**value)


def test_branches_share_looks_without_seeing_each_others():
    ledger = {1: Life(0)}
    twin = copy_ledger(ledger)
    record_looks(twin, [1], scan(labels=[3], signature=[0.5]), np.array([0]), None)
    assert ledger[1].looks.label == -1
    assert twin[1].looks.label == 3


def twins(evidence, barred):
    """Four observations exactly between two landmarks each; the odd one of each pair looks right."""
    middle = np.array([[3.0, 0.0], [0.0, 4.0], [-3.0, 1.0], [1.0, -4.0]])
    z_hat = np.repeat(middle, 2, axis=0) + np.tile([[0.02, 0.0], [-0.02, 0.0]], (4, 1))
    sign = np.kron(np.ones((4, 4)), [[-3.0, 3.0]])
    nu = innovations(middle, z_hat, np.zeros(2, bool))
    predictions = Predictions(np.arange(8), z_hat, 0.01 * np.eye(16))
    return AssociationProblem(
        middle, np.tile(0.01 * np.eye(2), (4, 1, 1)), nu, predictions, np.full(4, 0.05), np.arange(4),
        evidence=sign if evidence else None, barred=sign < 0 if barred else None,
    )  # fmt: skip


@pytest.mark.parametrize("name", [name for name in registry.names("associator") if name != "oracle"])
def test_every_associator_heeds_the_gate(name):
    found = registry.build("associator", name).associate(twins(False, True), np.random.default_rng(0))[0]
    assert found.match.tolist() == [1, 3, 5, 7]


@pytest.mark.parametrize(
    ("name", "rest"), [("stt", {}), ("stt", {"hard": 0.5}), ("map", {}), ("gnn", {"cost": "likelihood"})]
)
def test_those_who_weigh_gains_weigh_looks(name, rest):
    for barred in (False, True):
        found = registry.build("associator", name, rest).associate(twins(True, barred), np.random.default_rng(0))[0]
        assert found.match.tolist() == [1, 3, 5, 7]


def test_a_ratio_opens_the_gate_for_those_who_weigh_it():
    problem = twins(True, True)
    assert np.isinf(problem.d2[:, ::2]).all()
    assert np.isfinite(problem.weighed_d2).all()
    assert np.isinf(twins(False, True).weighed_d2[:, ::2]).all()


def test_soft_classes_do_not_open_the_gate_of_signatures():
    """`signature=gate` is a gate for everybody; what classes weigh says nothing of it."""
    rng = np.random.default_rng(4)
    crowd = replace(crowd_of(rng.normal(0.5, 0.2, 500)), classes={0: 5, 1: 5})
    predictions = with_looks(expected(1), [Looks({0: 3}, Moments(50.0, 0.5, 0.5))], crowd)
    seen = scan(labels=[0, 0], signature=[0.5, 3.0])
    for way, gated in (("gate", True), ("ratio", False), ("off", True)):
        found = weigh(seen, predictions, crowd, Weight(way, confusion=0.1))
        assert found.gated == gated
        problem = replace(twins(True, True), gated=found.gated)
        assert np.isinf(problem.weighed_d2[:, ::2]).all() == gated
    found = weigh(seen, predictions, crowd, Weight("gate", confusion=0.1))
    assert found.barred.ravel().tolist() == [False, True]
    for name in ("stt", "map"):
        asked = replace(twins(True, True), evidence=np.full((4, 8), 1.0), gated=True)
        match = registry.build("associator", name).associate(asked, np.random.default_rng(0))[0].match
        assert match.tolist() == [1, 3, 5, 7]


def test_the_teacher_knows_better_than_any_gate():
    problem = twins(False, True)
    truth = np.array([7, 8, 9, 10, -1, -1, -1, -1])
    founded = replace(problem.predictions, ids=np.array([0, 4, 1, 5, 2, 6, 3, 7]))
    found = Oracle(truth).associate(replace(problem, predictions=founded), np.random.default_rng(0))[0]
    assert found.match.tolist() == [0, 2, 4, 6]


def rate(associator, world, seed, **slam):
    scenario = tomthumb.load("cloister", seed=seed, **world)
    trace = tomthumb.run(scenario, associator=associator, settings={"slam": slam})
    return tomthumb.evaluate(trace, scenario)["match_rate"]


def test_diameters_help_where_places_alone_do_not_tell():
    hard = {"odometry_noise": 12.0, "jitter": 0.4, "spacing": 1.0, "diameter_std": 0.02}
    gain = [rate("jcbb", hard, seed, signature="gate") - rate("jcbb", hard, seed) for seed in range(1, 6)]
    assert np.mean(gain) > 0.01


def test_confused_classes_hurt_less_when_they_are_weighed():
    world, seeds = {"odometry_noise": 8.0, "classes": 4, "confusion": 0.1}, (1, 2, 3)
    gain = [rate("stt", world, seed, confusion=0.1) - rate("stt", world, seed) for seed in seeds]
    assert np.mean(gain) > 0.03
