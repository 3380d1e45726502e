"""Contract tests for associators and estimators: ours, and those that others bring (``tomthumb check``).

Every check is a function that takes a way to build the part and raises AssertionError with what is wrong. They are
plain functions, so that a test suite can run them one by one (a part takes of the keywords given what it needs):

    @pytest.mark.parametrize("contract", tomthumb.testing.ASSOCIATOR_CHECKS)
    def test_contract(contract):
        contract(lambda **given: Mine(gate=0.99))
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tomthumb import registry
from tomthumb.errors import TomThumbError
from tomthumb.testing.associators import ASSOCIATOR_CHECKS, Build
from tomthumb.testing.estimators import ESTIMATOR_CHECKS

__all__ = ["ASSOCIATOR_CHECKS", "ESTIMATOR_CHECKS", "Result", "check"]


@dataclass(frozen=True)
class Result:
    """One check by name, and what was wrong, or None."""

    name: str
    problem: str | None


def check(name: str, settings: Mapping[str, Mapping[str, Any]]) -> list[Result]:
    """Every check of the contract that the named part has to keep.

    `settings` as from `config.parse_sets`; bare keys are the part's own. Raises TomThumbError for a name that leads
    nowhere or to something that is neither an associator nor an estimator.
    """
    kind = _kind(name)
    parameters = {**settings.get("scenario", {}), **settings.get(kind, {})}

    def build(**given: Any) -> Any:
        return registry.build(kind, name, parameters, **given)

    checks = ASSOCIATOR_CHECKS if kind == "associator" else ESTIMATOR_CHECKS
    return [_result(contract, build) for contract in checks]


def _kind(name: str) -> str:
    for kind in ("associator", "estimator"):
        if name in registry.names(kind):
            return kind
    found = registry.find("associator", name)
    for kind, method in (("associator", "associate"), ("estimator", "predict")):
        if hasattr(found, method):
            return kind
    raise TomThumbError(f"{name} is neither an associator (method associate) nor an estimator (method predict)")


def _result(contract: Callable[[Build], None], build: Build) -> Result:
    try:
        contract(build)
    except TomThumbError:
        raise  # wrong parameters: nothing was checked
    except Exception as problem:  # whatever the foreign part throws is the finding
        where = traceback.extract_tb(problem.__traceback__)[-1]
        place = "" if isinstance(problem, AssertionError) else f" ({where.filename}:{where.lineno})"
        return Result(contract.__name__, f"{type(problem).__name__}: {problem}{place}")
    return Result(contract.__name__, None)
