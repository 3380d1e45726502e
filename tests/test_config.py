"""--set and TOML: from text to keyword arguments."""

from __future__ import annotations

import math

import pytest

from tomthumb.config import join, parse_sets, parse_value, read_file
from tomthumb.errors import BrokenFile, TomThumbError, UnknownName


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2),
        ("0.9999", 0.9999),
        ("1e3", 1000.0),
        ("true", True),
        ("none", "none"),
        ("[1, 2]", [1, 2]),
        ('"2"', "2"),
        ("2020-01-01", "2020-01-01"),
        ("a\nb = 3", "a\nb = 3"),
        ("{a = 1}", "{a = 1}"),
        ("", ""),
    ],
)
def test_values_are_toml_scalars_and_lists_or_words(text, value):
    found = parse_value(text)
    assert found == value
    assert type(found) is type(value)


def test_bare_keys_are_the_scenarios_and_prefixes_the_parts():
    sets = ["laps=2", "associator.gate=0.999", "estimator.iterations=4", "slam.width=8", "scenario.teach=1"]
    assert parse_sets(sets) == {
        "scenario": {"laps": 2, "teach": 1},
        "associator": {"gate": 0.999},
        "estimator": {"iterations": 4},
        "slam": {"width": 8},
    }


def test_faithful_goes_to_every_part_but_a_prefixed_one_to_its_own():
    assert all(part == {"faithful": True} for part in parse_sets(["faithful=true"]).values())
    assert parse_sets(["associator.faithful=true"])["slam"] == {}


def test_degrees_become_radians():
    assert parse_sets(["fov_deg=180"])["scenario"] == {"fov": pytest.approx(math.pi)}
    assert parse_sets(["mount_deg=[90, 0]"])["scenario"] == {"mount": [pytest.approx(math.pi / 2), 0.0]}
    with pytest.raises(TomThumbError, match="number of degrees"):
        parse_sets(["fov_deg=wide"])


@pytest.mark.parametrize("text", ["laps", "=3", " =3"])
def test_a_setting_needs_a_key_and_a_value(text):
    with pytest.raises(TomThumbError, match="write key=value"):
        parse_sets([text])


def test_a_wrong_part_gets_a_suggestion():
    with pytest.raises(UnknownName, match="did you mean 'associator'"):
        parse_sets(["asociator.gate=0.9"])


def test_files_and_sets_join_with_the_later_winning(tmp_path):
    file = tmp_path / "hard.toml"
    file.write_text("people = 30\n[associator]\ngate = 0.99\n[slam]\nwidth = 8\n")
    settings = join(read_file(file), parse_sets(["associator.gate=0.95"]))
    assert settings["scenario"] == {"people": 30}
    assert settings["associator"] == {"gate": 0.95}
    assert settings["slam"] == {"width": 8}


@pytest.mark.parametrize("content", [b"people = ", b"\xff\xfe", None])
def test_a_file_that_is_no_toml_is_named(tmp_path, content):
    file = tmp_path / "bad.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(BrokenFile, match=r"bad\.toml"):
        read_file(file)
