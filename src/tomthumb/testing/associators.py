"""The contract of an associator, one function for each clause."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from tomthumb.testing.problems import Trial, small_world, trial, trials
from tomthumb.types import Array, Association, AssociationProblem

Build = Callable[..., Any]


def _ask(build: Build, given: Trial, seed: int = 0) -> Sequence[Association]:
    """Hypotheses for a trial. Only a teacher takes the truth, by serial: of the landmarks, then of the observations."""
    n = len(given.problem.predictions)
    teacher: Any = build(truth=np.concatenate([np.arange(n), given.truth]))
    hypotheses: Sequence[Association] = teacher.associate(given.problem, np.random.default_rng(seed))
    return hypotheses


def returns_hypotheses_of_the_right_shape(build: Build) -> None:
    """A sequence of `Association`, at least one, each match (m,) of integers within the columns or -1."""
    for given in trials():
        m, n = given.problem.shape
        hypotheses = _ask(build, given)
        assert len(hypotheses) >= 1, "no hypothesis was returned; pairing nothing is one as well"
        for hypothesis in hypotheses:
            match = hypothesis.match
            assert isinstance(match, np.ndarray), f"match is a {type(match).__name__}, not an array"
            assert match.shape == (m,), f"match has shape {match.shape}, the scan has {m} observations"
            assert np.issubdtype(match.dtype, np.integer), f"match is of {match.dtype}, not of integers"
            assert ((match >= -1) & (match < n)).all(), f"match {match} goes beyond -1 to {n - 1}"


def pairs_one_to_one(build: Build) -> None:
    """No landmark is given to two observations of one scan."""
    for given in trials():
        for hypothesis in _ask(build, given):
            paired = hypothesis.match[hypothesis.match >= 0]
            assert len(np.unique(paired)) == len(paired), f"a landmark is given twice: {hypothesis.match}"


def names_an_easy_scan_rightly(build: Build) -> None:
    """Landmarks metres apart, noise of centimetres: all pairs are found, and nothing that is far away is paired."""
    rng, right, total = np.random.default_rng(12), 0, 0
    for _ in range(10):
        given = trial(rng, 6, 5, spread=10.0)
        right += int((_ask(build, given)[0].match == given.truth).sum())
        total += len(given.truth)
    assert right >= 0.9 * total, f"only {right} of {total} observations of easy scans were named rightly"


def takes_empty_scans(build: Build) -> None:
    """Nothing observed, nothing expected, or neither."""
    rng = np.random.default_rng(13)
    for m, n in ((0, 3), (3, 0), (0, 0)):
        for hypothesis in _ask(build, trial(rng, m, n)):
            assert hypothesis.match.shape == (m,), f"{m} observations, {n} landmarks: match {hypothesis.match.shape}"
            assert (hypothesis.match == -1).all(), f"{m} observations, {n} landmarks: something was paired"


def gives_the_same_answer_to_the_same_random_stream(build: Build) -> None:
    """Same problem, same state of the generator, a fresh associator: the same hypotheses."""
    for given in trials():
        one, two = _ask(build, given, seed=5), _ask(build, given, seed=5)
        assert len(one) == len(two), "another number of hypotheses the second time"
        for a, b in zip(one, two, strict=True):
            assert np.array_equal(a.match, b.match), f"{a.match}, then {b.match}"
            assert a.log_weight == b.log_weight, f"weight {a.log_weight}, then {b.log_weight}"


def leaves_its_input_as_it_was(build: Build) -> None:
    """No array of the problem is written to."""
    for given in trials():
        before = _arrays(given.problem)
        copies = {name: array.copy() for name, array in before.items()}
        _ask(build, given)
        for name, array in before.items():
            assert np.array_equal(array, copies[name]), f"{name} was changed in place"


def _arrays(problem: AssociationProblem) -> dict[str, Array]:
    parts = {f"problem.{f.name}": getattr(problem, f.name) for f in fields(problem)}
    parts |= {f"predictions.{f.name}": getattr(problem.predictions, f.name) for f in fields(problem.predictions)}
    return {name: value for name, value in parts.items() if isinstance(value, np.ndarray)}


def respects_labels(build: Build) -> None:
    """Where both classes are known and differ, the pairing does not happen (`AssociationProblem.allowed`)."""
    rng = np.random.default_rng(14)
    for _ in range(10):
        given = trial(rng, 8, 8, spread=0.15, labels=True)
        allowed = given.problem.allowed
        assert allowed is not None
        for hypothesis in _ask(build, given):
            rows = np.flatnonzero(hypothesis.match >= 0)
            assert allowed[rows, hypothesis.match[rows]].all(), (
                "observation and landmark of different classes were paired"
            )


def respects_the_gate_of_signatures(build: Build) -> None:
    """What `AssociationProblem.barred` excludes is not paired: `d2` is infinite there. True pairs are not barred here."""
    rng = np.random.default_rng(17)
    for _ in range(10):
        given = trial(rng, 6, 6, spread=0.15)
        barred = rng.random(given.problem.shape) < 0.5
        barred[np.arange(6), given.truth] = False
        asked = Trial(replace(given.problem, barred=barred), given.truth)
        for hypothesis in _ask(build, asked):
            rows = np.flatnonzero(hypothesis.match >= 0)
            assert not barred[rows, hypothesis.match[rows]].any(), "a pairing that the signatures exclude was made"


def weighs_hypotheses_best_first(build: Build) -> None:
    """Log weights are finite and never rise."""
    for given in trials():
        weights = [hypothesis.log_weight for hypothesis in _ask(build, given)]
        assert np.isfinite(weights).all(), f"log weights {weights}"
        assert all(a >= b for a, b in pairwise(weights)), f"log weights rise: {weights}"


def needs_only_the_predictions_that_are_always_there(build: Build) -> None:
    """`pose_cov`, `cross`, `points`, `exist`, `visible` and `stone` may be None."""
    rng = np.random.default_rng(15)
    given = trial(rng, 5, 6, bare=True)
    assert _ask(build, given)[0].match.shape == (5,)


def learns_without_complaint(build: Build) -> None:
    """`learn` is called after every scan, an empty one too."""
    part = build(truth=np.empty(0, np.int64))
    part.learn(np.array([3, -1, 5]), 1.0)
    part.learn(np.empty(0, np.int64), 2.0)


def runs_in_the_loop(build: Build) -> None:
    """A short run in a small world ends without failure."""
    from tomthumb.runner import run

    scenario = small_world()
    trace = run(scenario, associator=build(truth=scenario.true_ids()))
    assert trace.failure is None, trace.failure
    assert len(trace.t) == len(scenario.steps), f"{len(trace.t)} of {len(scenario.steps)} steps"


ASSOCIATOR_CHECKS: tuple[Callable[[Build], None], ...] = (
    returns_hypotheses_of_the_right_shape,
    pairs_one_to_one,
    names_an_easy_scan_rightly,
    takes_empty_scans,
    gives_the_same_answer_to_the_same_random_stream,
    leaves_its_input_as_it_was,
    respects_labels,
    respects_the_gate_of_signatures,
    weighs_hypotheses_best_first,
    needs_only_the_predictions_that_are_always_there,
    learns_without_complaint,
    runs_in_the_loop,
)
