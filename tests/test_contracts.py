"""Every registered associator and estimator keeps the contract that `tomthumb check` holds foreign ones to."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tomthumb import registry, testing
from tomthumb.errors import TomThumbError
from tomthumb.types import Association

CASES = [
    *itertools.product(["associator"], registry.names("associator"), testing.ASSOCIATOR_CHECKS),
    *itertools.product(["estimator"], registry.names("estimator"), testing.ESTIMATOR_CHECKS),
]


@pytest.mark.parametrize(("kind", "name", "contract"), CASES, ids=lambda case: getattr(case, "__name__", case))
def test_contract(kind: str, name: str, contract: Callable[..., None]) -> None:
    contract(lambda **given: registry.build(kind, name, {}, **given))


class Wrong:
    """Breaks one clause at a time, to see that the check notices."""

    def __init__(self, fault: str) -> None:
        self.fault = fault

    def associate(self, problem: Any, rng: np.random.Generator) -> list[Association]:
        m, n = problem.shape
        match = np.full(m, -1, np.int64)
        if self.fault == "nothing":
            return []
        if self.fault == "floats":
            match = match.astype(float)
        if self.fault == "twice" and n:
            match[:] = 0
        if self.fault == "beyond":
            match[:] = n
        if self.fault == "short" and m:
            match = match[1:]
        if self.fault == "writes":
            problem.z[:] = 0.0
        if self.fault == "moody" and n and m:
            match[0] = np.random.default_rng().integers(-1, n)  # a random stream of its own
        if self.fault == "rising":
            return [Association(match, 0.0), Association(match, 1.0)]
        if self.fault == "infinite":
            return [Association(match, -np.inf)]
        return [Association(match)]

    def learn(self, ids: Any, t: float) -> None:
        if self.fault == "learn":
            raise RuntimeError("no")


FAULTS = {
    "nothing": "returns_hypotheses_of_the_right_shape",
    "floats": "returns_hypotheses_of_the_right_shape",
    "short": "returns_hypotheses_of_the_right_shape",
    "beyond": "returns_hypotheses_of_the_right_shape",
    "twice": "pairs_one_to_one",
    "lazy": "names_an_easy_scan_rightly",
    "writes": "leaves_its_input_as_it_was",
    "moody": "gives_the_same_answer_to_the_same_random_stream",
    "rising": "weighs_hypotheses_best_first",
    "infinite": "weighs_hypotheses_best_first",
    "learn": "learns_without_complaint",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_noticed(fault: str) -> None:
    contract = next(c for c in testing.ASSOCIATOR_CHECKS if c.__name__ == FAULTS[fault])
    with pytest.raises((AssertionError, RuntimeError)):
        contract(lambda **given: Wrong(fault))


def test_check_tells_what_is_wrong_and_where() -> None:
    results = {r.name: r.problem for r in testing.check(f"{__file__}:Wrong", {"scenario": {"fault": "learn"}})}
    problem = results["learns_without_complaint"]
    assert problem is not None
    assert "RuntimeError: no" in problem
    assert "test_contracts.py" in problem
    assert results["pairs_one_to_one"] is None


def test_check_refuses_what_is_no_part() -> None:
    with pytest.raises(TomThumbError, match="neither an associator"):
        testing.check("tomthumb.types:Trace", {})
