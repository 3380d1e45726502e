"""An explanation says what dense evaluation of the joint posterior says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri

from associators.brute import matches, random_problem, tabulate
from tomthumb.associators.explain import explain
from tomthumb.associators.jcbb import JointCompatibility
from tomthumb.errors import TomThumbError
from tomthumb.gains import base_gains


def looked_up(problem):
    own, odds = base_gains(problem, None)
    table = tabulate(problem, 0.99)
    dense = table.posterior(own[:, None] + odds[None])
    return {tuple(a): (v, d2) for a, v, d2 in zip(table.matches, dense, table.d2, strict=True)}


def with_partner(match, i, j):
    return (*match[:i], j, *match[i + 1 :])


def test_every_figure_is_the_dense_one():
    rng = np.random.default_rng(1)
    for _ in range(60):
        m, n = (int(v) for v in rng.integers(1, 5, 2))
        problem = random_problem(rng, m, n)
        table = looked_up(problem)
        match = tuple(int(j) for j in matches(m, n)[rng.integers(len(matches(m, n)))])
        i = int(rng.integers(m))
        told = explain(problem, np.array(match), i)
        bare, rest_d2 = table[with_partner(match, i, -1)]
        value, d2 = table[match]
        assert told.joint_d2 == pytest.approx(d2, abs=1e-7)
        assert told.gain == pytest.approx(value - bare, abs=1e-7)
        others = {j: table[with_partner(match, i, j)][0] - bare for j in range(n) if j not in match}
        others |= {-1: 0.0} if match[i] >= 0 else {}
        assert told.runner_up_gain == pytest.approx(max(others.values(), default=0.0), abs=1e-7)
        if match[i] >= 0:
            assert told.conditional_d2 == pytest.approx(d2 - rest_d2, abs=1e-7)
            assert told.d2 == pytest.approx(table[with_partner((-1,) * m, i, match[i])][1], abs=1e-8)
            assert chdtri(2, 1 - told.gate) == pytest.approx(told.d2, rel=1e-6)


def test_the_gates_are_those_that_just_let_it_through():
    problem = random_problem(np.random.default_rng(3), 4, 4, spread=3.0)
    found = JointCompatibility(0.999).associate(problem, np.random.default_rng(0))[0]
    told = [explain(problem, found, i) for i in range(4)]
    assert all(e.joint_gate < 0.999 for e in told)
    assert all(e.gate < 0.999 for e in told if e.landmark >= 0)
    paired = [e for e in told if e.landmark >= 0]
    assert chdtri(2 * len(paired), 1 - paired[0].joint_gate) == pytest.approx(found.info["joint_d2"], rel=1e-6)


def test_it_reads_as_a_sentence():
    problem = random_problem(np.random.default_rng(4), 2, 3, spread=6.0)
    assert str(explain(problem, np.array([0, -1]), 0)).startswith("observation 0 is landmark 0: gain ")
    assert str(explain(problem, np.array([0, -1]), 1)).startswith("observation 1 is unpaired; next comes landmark")


def test_classes_exclude_a_runner_up():
    problem = random_problem(np.random.default_rng(5), 3, 4, labels=True)
    for i in range(3):
        second = explain(problem, np.full(3, -1), i).runner_up
        assert second < 0 or problem.allowed[i, second]


def test_what_is_not_of_this_problem_is_refused():
    problem = random_problem(np.random.default_rng(6), 3, 4)
    with pytest.raises(TomThumbError, match="observation 3 does not exist; valid: 0 to 2"):
        explain(problem, np.full(3, -1), 3)
    with pytest.raises(TomThumbError, match="the problem is 3 x 4"):
        explain(problem, np.array([0, 1, 4]), 0)
