import json
import math

import numpy as np
import pytest

from tomthumb.scenarios import info, load, suggest
from tomthumb.types import Prior, Scenario


def test_info_of_the_cloister():
    found = info(load("cloister"))
    assert found["steps"] == found["scans"] == 168
    assert found["observations"] == 1402
    assert found["landmarks"] == found["observed_landmarks"] == 88
    assert found["spacing_m"]["min"] == pytest.approx(0.25)
    assert found["fov_deg"] == pytest.approx(180, abs=2)
    assert found["truth"] == {"poses": 1.0, "labelled": 1.0}
    assert found["clutter_share"] == 0.0
    assert found["dead_reckoning_m"]["max"] > 0.1
    json.dumps(found, allow_nan=False)


def test_info_of_an_empty_scenario():
    nothing = load("random", steps=1, landmarks=0)
    empty = Scenario("empty", nothing.motion, nothing.sensor, Prior(np.zeros(3), np.zeros((3, 3))), [])
    assert info(empty)["observations"] == 0
    json.dumps([info(empty), suggest(empty)], allow_nan=False)
    assert len(suggest(empty)["notes"]) == 3


def test_suggest_finds_what_the_world_was_made_with():
    world = load("random", 3, landmarks=400, steps=1500, detect=0.7, clutter=3.0, range_std=0.08, max_range=9.0)
    found = suggest(world)
    assert found["sensor_std"]["robust"][0] == pytest.approx(0.08, rel=0.1)
    assert found["sensor_std"]["plain"][1] == pytest.approx(math.radians(0.5), rel=0.1)
    assert found["r_scale"] == pytest.approx(1.0, abs=0.07)
    assert found["q_scale"] == pytest.approx(1.0, abs=0.1)
    assert found["detect"] == pytest.approx(0.7, abs=0.02)
    assert found["clutter"] == pytest.approx(3.0 / (math.pi / 2 * 81), rel=0.1)
    assert found["max_range_m"] == pytest.approx(9.0, rel=0.05)
    assert found["settings"]["sensor"]["detect"] == found["detect"]
    assert found["notes"] == []


def test_the_cloister_filter_is_told_twice_the_variance():
    assert suggest(load("cloister", laps=10))["q_scale"] == pytest.approx(1 / math.sqrt(2), rel=0.1)


@pytest.mark.data
@pytest.mark.parametrize("name", ["car_park", "freiburg_slam_course", "fs_driverless_prom_ntua"])
def test_real_logs_are_inspected_whatever_they_lack(data, name):
    scenario = load(str(data(name)))
    found = suggest(scenario)
    assert (found["sensor_std"] is None) == (name != "car_park")
    json.dumps([info(scenario), found], allow_nan=False)
