"""tomthumb check: the newcomer's file passes, a faulty one is told why."""

from __future__ import annotations

from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_associator.py"


def test_the_example_passes(tomthumb):
    assert len(EXAMPLE.read_text().splitlines()) < 40
    said = tomthumb("check", f"{EXAMPLE}:Mine")
    assert said.code == 0
    assert "12 of 12 checks passed" in said.out


def test_parameters_can_be_given(tomthumb):
    assert tomthumb("check", f"{EXAMPLE}:Mine", "--set", "gate=0.9999", "--json").json["passed"]
    assert "did you mean 'gate'" in tomthumb("check", f"{EXAMPLE}:Mine", "--set", "gat=1").err


def test_an_estimator_is_recognised(tomthumb):
    said = tomthumb("check", "ekf", "--json")
    assert said.json["passed"], said.json
    assert "forks_do_not_share" in {each["check"] for each in said.json["checks"]}


def test_a_fault_is_exit_code_1_with_the_reason(tomthumb, tmp_path):
    file = tmp_path / "bad.py"
    text = EXAMPLE.read_text().replace("claimant[j] == i and ", "")
    file.write_text(text)
    said = tomthumb("check", f"{file}:Mine")
    assert said.code == 1
    assert "a landmark is given twice" in said.out.replace("\n", " ")
