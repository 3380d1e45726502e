"""STDP: closed forms, fixed point, bounds, the taught ring, and the log-probability memory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomthumb.associators.tom_thumb import TomThumb
from tomthumb.errors import TomThumbError
from tomthumb.tale.stdp import LogMemory, PairMemory, Plasticity, fixed_point, log_rule

P = Plasticity()


def test_one_pair_potentiates_and_depresses_by_the_closed_form() -> None:
    memory = PairMemory(2)
    memory.w[:] = 0.4
    memory.spike([0], 0.0)  # pre 0, then post 1 after 2 steps
    memory.spike([1], 2.0)
    assert memory.w[1, 0] == pytest.approx(0.4 + 0.1 * (1 - 0.4) * math.exp(-2 / 3))
    assert memory.w[0, 1] == pytest.approx(0.4 - 0.105 * 0.4 * math.exp(-2 / 3))


def test_traces_add_up() -> None:
    memory = PairMemory(2)
    for t in (0.0, 1.0, 4.0):
        memory.spike([0], t)
    memory.spike([1], 5.0)
    x = math.exp(-5 / 3) + math.exp(-4 / 3) + math.exp(-1 / 3)
    assert memory.w[1, 0] == pytest.approx(0.1 * x)


@pytest.mark.parametrize("mu", [0.0, 0.5, 1.0, 2.0])
def test_soft_bounds_exponent(mu: float) -> None:
    memory = PairMemory(2, Plasticity(mu=mu))
    memory.w[:] = 0.3
    memory.spike([0], 0.0)
    memory.spike([1], 1.0)
    assert memory.w[1, 0] == pytest.approx(0.3 + 0.1 * 0.7**mu * math.exp(-1 / 3))
    assert memory.w[0, 1] == pytest.approx(0.3 - 0.105 * 0.3**mu * math.exp(-1 / 3))


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_fixed_point(share: float) -> None:
    rng = np.random.default_rng(1)
    p = Plasticity(a_plus=0.01, a_minus=0.0105)
    memory, values = PairMemory(2, p), []
    for k in range(6000):
        first = 0 if rng.random() < share else 1  # far apart, so only this pair of spikes counts
        memory.spike([first], 100.0 * k)
        memory.spike([1 - first], 100.0 * k + 1)
        values.append(memory.w[1, 0])
    assert np.mean(values[2000:]) == pytest.approx(fixed_point(p, share), abs=0.02)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 4.0)), max_size=80), st.floats(0.0, 1.0), st.floats(0.0, 3.0)
)
def test_weights_stay_within_their_bounds(spikes, a: float, mu: float) -> None:  # type: ignore[no-untyped-def]
    memory, t = PairMemory(4, Plasticity(a_plus=a, a_minus=a, mu=mu)), 0.0
    for neuron, dt in spikes:
        t += dt
        memory.spike([neuron], t)
    assert memory.w.min() >= 0.0
    assert memory.w.max() <= 1.0


def test_three_laps_of_a_ring_teach_the_successor_everywhere() -> None:
    memory = PairMemory(20)
    for t in range(60):
        memory.spike([t % 20], float(t))
    assert memory.w.argmax(axis=0).tolist() == [(j + 1) % 20 for j in range(20)]


def test_same_moment_teaches_nothing_and_order_does_not_matter() -> None:
    one, other = PairMemory(3), PairMemory(3)
    one.spike([0, 1], 0.0)
    other.spike([1, 0], 0.0)
    assert not one.w.any()
    one.spike([2], 1.0)
    other.spike([2], 1.0)
    assert (one.w == other.w).all()


def test_log_memory_is_exact_counting() -> None:
    memory = LogMemory(window=1.0)
    rng = np.random.default_rng(3)
    hits, seen = 0, 0
    memory.learn([7, 8], 0.0)
    for k in range(1, 200):
        t = 10.0 * k
        company = rng.random() < 0.3
        if company:
            memory.learn([8], t)
        memory.learn([7], t + 0.5)
        hits, seen = hits + company, seen + 1
    assert memory.probability(8, 7) == pytest.approx((hits + 0.5) / (seen + 1 + 1))


def test_log_rule_converges_to_the_log_probability() -> None:
    rng = np.random.default_rng(3)
    w, trace = math.log(0.5), []
    for _ in range(40_000):
        w = log_rule(w, bool(rng.random() < 0.3), 0.005)
        trace.append(w)
    assert np.mean(trace[5000:]) == pytest.approx(math.log(0.3), abs=0.03)


def test_log_rule_is_to_first_order_the_exact_step() -> None:
    for v, hit in [(0.2, True), (0.2, False), (0.9, True)]:
        exact = [math.log(v + eta * (hit - v)) - math.log(v) for eta in (1e-3, 1e-4)]
        rule = [log_rule(math.log(v), hit, eta) - math.log(v) for eta in (1e-3, 1e-4)]
        assert abs(exact[1] - rule[1]) < abs(exact[0] - rule[0]) / 50  # error is second order


def ring_memory(laps: int = 5, rate: float | None = None) -> tuple[LogMemory, float]:
    memory = LogMemory(window=2.5, rate=rate)
    for t in range(laps * 20):
        memory.learn([t % 20], float(t))
    return memory, float(laps * 20)


@pytest.mark.parametrize("rate", [None, 0.2])
def test_prior_favours_the_successor_and_is_clipped(rate: float | None) -> None:
    memory, t = ring_memory(rate=rate)
    assert memory.recent(t).tolist() == [18, 19]
    prior = memory.prior(np.arange(20), t)
    assert prior[0] == prior.max()
    assert np.abs(prior).max() <= 2.0
    assert (prior[1:18] < 0.0).sum() >= 15
    assert memory.prior([99], t).tolist() == [0.0]
    assert memory.prior([0], t + 100.0).tolist() == [0.0]


def test_forget_closes_the_gap_and_leaves_the_others_as_they_were() -> None:
    memory, t = ring_memory()
    twin = memory.fork()
    twin.forget([3, 4, 19, 19, 77])
    assert len(twin) == 17
    for i in (0, 7, 18):
        for j in (0, 5, 18):
            assert twin.probability(j, i) == memory.probability(j, i)
    assert twin.probability(3, 5) == 0.5
    twin.learn([3], t)
    assert twin.prior([3], t)[0] != memory.prior([3], t)[0]
    assert len(memory) == 20


def test_memory_grows_past_its_first_block() -> None:
    memory = LogMemory()
    memory.learn(np.arange(300), 0.0)
    memory.learn([-1, 299], 1.0)
    assert memory.probability(0, 299) == pytest.approx((1 + 0.5) / (2 + 1))
    assert len(memory) == 300


def test_late_comers_were_never_company() -> None:
    for rate in (None, 0.1):
        early, late = LogMemory(rate=rate), LogMemory(rate=rate)
        early.learn([5], -1e9)  # known from the start, then never seen again
        for t in range(10):
            early.learn([1], float(t))
            late.learn([1], float(t))
        late.learn([5], 1e9)
        assert late.probability(5, 1) == pytest.approx(early.probability(5, 1))


def test_bad_input_is_one_clear_line() -> None:
    memory = PairMemory(2)
    memory.spike([0], 5.0)
    for wrong in (
        lambda: memory.spike([0], 4.0),
        lambda: memory.spike([2], 6.0),
        lambda: Plasticity(tau_plus=0.0),
        lambda: Plasticity(a_plus=2.0),
        lambda: LogMemory(rate=1.0),
    ):
        with pytest.raises(TomThumbError, match=r"^[^\n]+$"):
            wrong()


def filled(size: int, laps: int = 3, landmarks: int = 12) -> LogMemory:
    """A ring of landmarks walked round, a pair at a time."""
    memory = LogMemory(window=1.0, size=size)
    for t in range(laps * landmarks):
        memory.learn([t % landmarks, (t + 1) % landmarks], float(t))
    return memory


def test_the_memory_is_bounded_whatever_is_seen() -> None:
    rng, memory = np.random.default_rng(0), LogMemory(size=20)
    for t in range(500):
        memory.learn(rng.integers(0, 1000, 7), float(t))
        assert len(memory) <= 20
    assert memory.recall(np.arange(1000)).together.shape == (20, 20)
    memory.learn(np.arange(50), 501.0)  # more at once than there is room for
    assert len(memory) == 20


def test_crumbs_fade_and_stones_stay() -> None:
    memory = LogMemory(window=1.0, size=10)
    for t in range(30):
        memory.learn([0, 1, 2], float(t))  # stones
    for t in range(30, 90):
        memory.learn([t], float(t))  # passers-by, each seen once
    kept = set(memory.recall(np.arange(100)).ids.tolist())
    assert {0, 1, 2} <= kept
    assert {88, 89} <= kept  # whoever is new gets a chance


def test_room_enough_changes_nothing() -> None:
    free, tight = filled(1000), filled(12)
    np.testing.assert_array_equal(free.recall(range(12)).together, tight.recall(range(12)).together)


def test_what_is_left_after_forgetting_is_what_it_was() -> None:
    memory = filled(100)
    before = {(j, i): memory.probability(j, i) for i in range(3, 12) for j in range(3, 12)}
    memory.forget([0, 7, 2])
    for (j, i), value in before.items():
        assert memory.probability(j, i) == (0.5 if 7 in (i, j) else value)


def test_lessons_go_from_one_memory_to_another_under_new_names() -> None:
    teacher, pupil = filled(100), LogMemory(window=1.0)
    names = {i: 100 + i for i in range(12) if i != 5}
    pupil.remind(teacher.recall(range(12)).renamed(names))
    assert pupil.probability(105, 104) == 0.5  # not taken along
    assert pupil.probability(104, 103) == teacher.probability(4, 3)
    assert pupil.recent(1e6).size == 0
    pupil.learn([103], 0.0)
    twin = teacher.fork()
    twin.learn([3], 1e6)  # nobody seen lately there either
    assert pupil.probability(104, 103) == twin.probability(4, 3)
    assert pupil.prior([104, 109], 0.0)[0] > pupil.prior([104, 109], 0.0)[1]


def test_of_too_many_lessons_the_best_known_stay() -> None:
    many = LogMemory()
    for t in range(20):
        many.learn(np.arange(t + 1), float(t))
    few = LogMemory(size=5)
    few.remind(many.recall(np.arange(20)))
    assert few.recall(np.arange(20)).ids.tolist() == [0, 1, 2, 3, 4]


def test_another_associator_with_other_settings_keeps_the_lessons() -> None:
    one = TomThumb(memory=True, size=50)
    one.learn(np.array([1, 2, 3]), 0.0)
    other = replace(one, brothers=8)
    assert set(other.recall(np.arange(5)).ids.tolist()) == {1, 2, 3}
    assert TomThumb(memory=True).lessons is not TomThumb(memory=True).lessons
