"""A robot that is carried away: the steps between two moments of a scenario are left out, and nothing tells it so."""

from __future__ import annotations

from dataclasses import replace

from tomthumb.errors import TomThumbError
from tomthumb.types import Scenario, Step


def kidnapped(scenario: Scenario, at: int, to: int) -> Scenario:
    """The scenario with step `at` followed by step `to` (its odometry included, that of the steps between lost).

    Works with any world or log, forwards and backwards; time goes on as if nothing had happened. Raises TomThumbError
    for steps that are not there.
    """
    steps = list(scenario.steps)
    if not (0 <= at < len(steps) - 1 and 0 < to < len(steps)):
        raise TomThumbError(
            f"kidnap {at}:{to}: steps from 0 to {len(steps) - 1} are there, the second not the first one"
        )
    lost = steps[at].t + _gap(steps) - steps[to].t
    after = [replace(step, t=step.t + lost) for step in steps[to:]]
    info = {**scenario.info, "kidnapped": (at, to)}
    return replace(scenario, steps=[*steps[: at + 1], *after], info=info)


def _gap(steps: list[Step]) -> float:
    """Seconds between two steps, on average."""
    return (steps[-1].t - steps[0].t) / max(len(steps) - 1, 1)


def carried_away(scenario: Scenario, text: str) -> Scenario:
    """`kidnapped` by a text "AT:TO". Raises TomThumbError."""
    try:
        at, to = map(int, text.split(":"))
    except ValueError:
        raise TomThumbError(f"kidnap={text[:40]}: two steps are wanted, AT:TO") from None
    return kidnapped(scenario, at, to)
