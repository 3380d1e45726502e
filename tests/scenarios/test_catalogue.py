import math

import numpy as np
import pytest

from tomthumb.errors import BrokenFile, TomThumbError, UnknownName
from tomthumb.scenarios import entries, load, parameters
from tomthumb.types import Scenario


def test_every_builtin_entry_leads_to_a_function():
    for name in entries():
        assert isinstance(parameters(name), dict)


@pytest.mark.parametrize("name", [n for n, e in entries().items() if not e.needs])
def test_simulators_repeat_themselves_with_a_seed_and_differ_without(name, same):
    same(load(name, 3), load(name, 3))
    one, other = load(name, 3), load(name, 4)
    assert not np.array_equal(one.steps[1].control.u, other.steps[1].control.u)


def test_parameters_come_from_the_spec_and_are_overridden_by_keywords():
    scenario = load("cloister?laps=2&people=3&occlusion=true", teach="1", people=0)
    assert scenario.teach_steps == 168
    assert scenario.info["people"] == 0


def test_degrees_become_radians():
    assert load("random?fov_deg=90&steps=3&landmarks=4").sensor.fov == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("cloyster", "did you mean 'cloister'"),
        ("cloister?lap=2", "did you mean 'laps'"),
        ("cloister?laps=two", "whole number"),
        ("cloister?laps=2.5", "whole number"),
        ("cloister?detect=nan", "not a number"),
        ("cloister?odometry=gps", "one of wheels, none"),
        ("cloister?occlusion=maybe", "true or false"),
        ("cloister?laps", "not key=value"),
        ("car_park", "needs"),
        ("cloister:somewhere", "takes no path"),
        ("./nowhere/log.jsonl", "no such file"),
        ("no_module_here:world", "no module 'no_module_here'"),
        ("tomthumb.geometry:wrong", "unknown function"),
        ("./nowhere.py:world", "no such file"),
        ("car_park:/nowhere", "no such file"),
    ],
)
def test_mistakes_are_one_clear_line(spec, words):
    with pytest.raises(TomThumbError, match=words) as caught:
        load(spec)
    assert "\n" not in str(caught.value)


def test_unknown_name_is_its_own_error():
    with pytest.raises(UnknownName):
        load("nonsense")


def test_a_function_in_a_file(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "from tomthumb.scenarios.cloister import cloister\n"
        "@dataclass\nclass Mine:\n    number: int = 0\n"
        "def world(rng, *, walkers: int = 0):\n    return cloister(rng, people=walkers)\n"
        "def wrong():\n    return 3\n"
    )
    assert isinstance(load(f"{tmp_path}/mine.py:world?walkers=2"), Scenario)
    with pytest.raises(TomThumbError, match="not a Scenario"):
        load(f"{tmp_path}/mine.py:wrong")


def test_a_function_in_a_module():
    assert load("tomthumb.scenarios.worlds:random", steps=4, landmarks=3).name == "random"


def test_an_unknown_folder_names_the_kinds(tmp_path):
    with pytest.raises(TomThumbError, match="car_park"):
        load(str(tmp_path))


def test_a_broken_file_is_named(tmp_path):
    (tmp_path / "log.jsonl").write_text("not json\n")
    with pytest.raises(BrokenFile, match=r"log\.jsonl:1"):
        load(str(tmp_path / "log.jsonl"))


def test_paths_that_cannot_be_are_one_line(tmp_path):
    for spec in ("a/" + "b" * 5000, f"{tmp_path}/{'b' * 5000}.g2o", f"csv:{tmp_path}/{'b' * 5000}"):
        with pytest.raises(TomThumbError) as found:
            load(spec)
        assert "\n" not in str(found.value)
