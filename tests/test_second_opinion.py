"""The benchmark that puts one run's problems to two associators: against associators whose verdicts are known."""

import sys
from pathlib import Path

import numpy as np
import pytest

import tomthumb

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from second_opinion import SHARE, compared, shaken, told, verdicts

from tomthumb.errors import TomThumbError


def found(first: str, second: str) -> np.ndarray:
    return np.array(list(verdicts(tomthumb.load("cloister", seed=2), first, second, {})), float)


def test_the_oracle_is_right_whoever_decides() -> None:
    asked = found("nn", "oracle")
    assert asked[:, 1].all()
    assert 0.5 < asked[:, 0].mean() < 1.0
    assert (asked[:, 3] == 1.0).all()  # NN knows no confidence


def test_two_of_a_kind_never_differ() -> None:
    asked = found("jcbb", "jcbb")
    assert (asked[:, 0] == asked[:, 1]).all()
    lines = list(compared(asked, "jcbb", "jcbb"))
    assert lines[0].endswith("jcbb right, jcbb wrong: 0; the other way round: 0")


def test_a_shaken_log_is_moved_by_a_share_of_its_noise() -> None:
    still = tomthumb.load("cloister", seed=2)
    moved = shaken(still, 1)
    d2 = []
    for one, other in zip(still.steps, moved.steps, strict=True):
        if one.observations is not None and one.observations.z.size:
            away = (other.observations.z - one.observations.z)[..., None]
            d2 += (away.transpose(0, 2, 1) @ np.linalg.solve(one.observations.R, away)).ravel().tolist()
    assert np.mean(d2) == pytest.approx(2.0 * SHARE**2, rel=0.1)


def test_what_is_dropped_is_gone_with_what_is_known_of_it() -> None:
    still = tomthumb.load("cloister", seed=2)
    fewer = shaken(still, 1, dropped=0.25)
    before, after = still.true_ids(), fewer.true_ids()
    assert len(after) == sum(len(s.observations) for s in fewer.steps if s.observations is not None)
    assert len(after) == pytest.approx(0.75 * len(before), rel=0.1)


def test_what_cannot_be_judged_is_one_clear_line() -> None:
    for log, second, says in (("nosuch", "jcbb", "unknown scenario"), ("cloister", "nosuch", "unknown associator")):
        with pytest.raises(TomThumbError, match=says):
            list(told(log, "nn", second, [], 0))
    with pytest.raises(TomThumbError, match="still"):
        list(told("cloister", "stt", "nn", ["slam.still=2"], 0))
