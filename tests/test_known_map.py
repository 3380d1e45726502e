"""Starting in a saved map: the robot is found in it, and it grows or not as told."""

from __future__ import annotations

import numpy as np
import pytest

import tomthumb
from tomthumb.errors import TomThumbError
from tomthumb.known_map import FIRST
from tomthumb.storage import load_map, save_map
from tomthumb.types import Estimate, Prior, Scenario


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Estimate:
    """The map of one lap, through a file."""
    file = tmp_path_factory.mktemp("map") / "map.csv"
    save_map(file, tomthumb.run(tomthumb.load("cloister", seed=1), associator="jcbb").final)
    return load_map(file)


def localise(known: Estimate, estimator: str = "ekf", seed: int = 2, **slam: object):
    scenario = tomthumb.load("cloister", seed=seed)
    settings = {"slam": slam}
    trace = tomthumb.run(scenario, associator="jcbb", estimator=estimator, settings=settings, start_map=known)
    return trace, tomthumb.evaluate(trace, scenario)


@pytest.mark.parametrize("estimator", ["ekf", "iekf"])
def test_every_landmark_is_known_from_the_first_scan_on(saved, estimator):
    trace, row = localise(saved, estimator)
    assert trace.paired[: trace.offsets[1]].all()
    assert (trace.ids[trace.paired] >= FIRST).mean() > 0.98
    assert row["match_rate"] > 0.98
    assert row["wrong_ids"] == 0
    assert row["ate_raw_m"] < 0.1


def test_a_frozen_map_stays_as_it_was(saved):
    trace, row = localise(saved, frozen=True)
    stone = trace.final.stone
    assert stone.sum() == saved.stone.sum() == len(trace.final.ids[trace.final.ids >= FIRST])
    np.testing.assert_allclose(trace.final.landmarks[stone], saved.landmarks[saved.stone], atol=1e-4)
    assert row["wrong_ids"] == 0


def test_part_of_a_map_goes_on_growing(saved):
    half = np.arange(len(saved.ids)) % 2 == 0
    part = Estimate(
        saved.pose, saved.pose_cov, saved.ids[half], saved.landmarks[half], saved.covs[half], saved.stone[half]
    )
    trace, row = localise(part)
    assert trace.final.stone.sum() > 1.8 * half.sum()
    assert row["wrong_ids"] == 0


def test_an_uncertain_start_is_made_certain_by_the_map(saved):
    world = tomthumb.load("cloister", seed=3)
    wrong = Prior(np.array([0.05, -0.05, 0.03]), np.diag([0.1, 0.1, 0.05]) ** 2)
    scenario = Scenario(world.name, world.motion, world.sensor, wrong, world.steps, world.landmarks)
    trace = tomthumb.run(scenario, associator="jcbb", start_map=saved)
    assert np.hypot(*trace.pose[0, :2]) < 0.03
    assert np.trace(trace.pose_cov[0, :2, :2]) < 0.1 * np.trace(wrong.cov[:2, :2])


def test_the_oracle_cannot_name_what_was_founded_elsewhere(saved):
    with pytest.raises(TomThumbError, match="oracle"):
        tomthumb.run(tomthumb.load("cloister"), associator="oracle", start_map=saved)
