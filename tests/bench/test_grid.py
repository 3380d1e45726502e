"""A grid is refused before anything runs, with one line that says what is valid; and its runs have stable names."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from tomthumb.bench import dry_run, from_options, read_grid
from tomthumb.bench.grid import from_table
from tomthumb.bench.spec import Part, RunSpec, digest
from tomthumb.bench.validate import validate
from tomthumb.errors import TomThumbError

MINE = """
from tomthumb.associators.nearest import NearestNeighbour

class Mine(NearestNeighbour):
    pass
"""


def table(**more: object) -> dict[str, object]:
    return {"seeds": 3, "scenario": {"use": "cloister"}, "associator": [{"use": "nn"}, {"use": "jcbb"}], **more}


def grid(home: Path = Path(), **more: object):  # type: ignore[no-untyped-def]
    return from_table(table(**more), home)


def test_every_combination_once_and_worlds_together() -> None:
    found = grid(
        scenario=[{"use": "cloister", "people": [0, 10]}, {"use": "cloister", "label": "far", "laps": 2}],
        associator=[{"use": "nn"}, {"use": "jcbb", "gate": [0.9, 0.99]}],
        slam=[{"hits": 5}, {"hits": 1, "label": "at once"}],
    )
    runs = found.runs()
    assert len(runs) == len({run.key for run in runs}) == 3 * 3 * 3 * 2
    worlds = [run.world for run in runs]
    assert sum(a != b for a, b in itertools.pairwise(worlds)) == 3 * 3 - 1
    assert [part.label for part in found.scenarios] == ["cloister people=0", "cloister people=10", "far"]
    assert "jcbb gate=0.99 / at once" in found.methods()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"sceanrio": 1}, "unknown key of a grid 'sceanrio'; did you mean 'scenario'"),
        ({"associator": []}, r"\[\[associator\]\] is missing"),
        ({"associator": [{"gate": 0.9}]}, "'use' must name one"),
        ({"associator": [{"use": "nn"}, {"use": "nn"}]}, "'nn' occurs twice"),
        ({"seeds": 0}, "seeds"),
        ({"seeds": [1, 1]}, "seeds"),
        ({"seeds": [-1]}, "seeds"),
        ({"seeds": 2.5}, "seeds"),
        ({"seeds": "a..b"}, "'a' is not a whole number"),
        ({"baseline": "jcb"}, "unknown baseline 'jcb'; did you mean 'jcbb'"),
        ({"measures": ["match"]}, "unknown measure 'match'; did you mean 'match_rate'"),
        ({"level": 2.0}, "level = 2.0"),
        ({"limits": {"minutes": 1}}, "unknown key of .limits. 'minutes'"),
        ({"limits": {"seconds": -1}}, "limits.seconds = -1"),
        ({"claim": [{"text": "x"}]}, "needs text and method"),
        ({"claim": [{"text": "x", "method": "nn"}]}, "exactly one of"),
        ({"claim": [{"text": "x", "method": "stt", "at_least": 1.0}]}, "unknown method of a claim 'stt'"),
        ({"report": {"pages": -1}}, "report.pages"),
        ({"report": {"page": 1}}, "unknown key of .report. 'page'; did you mean 'pages'"),
        ({"scenario": {"use": "./nowhere"}}, "no such file or folder"),
        ({"scenario": {"use": "$NO_SUCH_VARIABLE/log"}}, "NO_SUCH_VARIABLE is not set"),
    ],
)
def test_refused(more: dict[str, object], said: str) -> None:
    with pytest.raises(TomThumbError, match=said) as caught:
        grid(**more)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"associator": [{"use": "jcb"}]}, "unknown associator 'jcb'; did you mean 'jcbb'"),
        ({"associator": [{"use": "nn", "gat": 0.9}]}, "'gat'; did you mean 'gate'"),
        ({"estimator": [{"use": "ekg"}]}, "unknown estimator 'ekg'"),
        ({"scenario": {"use": "cloister", "lap": 1}}, "'lap'; did you mean 'laps'"),
        ({"scenario": {"use": "cloister", "laps": [1, 0]}}, "laps=0"),
        ({"slam": [{"hit": 1}]}, "'hit'; did you mean 'hits'"),
    ],
)
def test_parts_that_do_not_exist_are_found_before_anything_runs(more: dict[str, object], said: str) -> None:
    with pytest.raises(TomThumbError, match=said):
        validate(grid(**more))


def test_broken_toml_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "g.toml").write_text("seeds = = 3")
    with pytest.raises(TomThumbError, match=r"g\.toml"):
        read_grid(tmp_path / "g.toml")


def test_a_plug_in_counts_by_what_it_says_not_by_where_it_lies(tmp_path: Path) -> None:
    keys = []
    for folder, text in (("a", MINE), ("b", MINE), ("c", MINE + "# changed\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(text)
        keys.append(grid(tmp_path / folder, associator=[{"use": "./mine.py:Mine"}]).runs()[0].key)
    assert keys[0] == keys[1] != keys[2]


def test_key_depends_on_all_that_counts_and_on_nothing_else() -> None:
    part = Part("cloister", {"laps": 1, "people": 0}, "a label")
    base = RunSpec(part, Part("ekf"), Part("nn"), Part("slam"), 1, "1.0")
    same = Part("cloister", {"people": 0.0, "laps": 1}, "another label")
    assert base.key == RunSpec(same, Part("ekf"), Part("nn"), Part("slam"), 1, "1.0").key
    others = [
        RunSpec(Part("cloister", {"laps": 2, "people": 0}), Part("ekf"), Part("nn"), Part("slam"), 1, "1.0"),
        RunSpec(part, Part("ekf", {"iterations": 1}), Part("nn"), Part("slam"), 1, "1.0"),
        RunSpec(part, Part("ekf"), Part("gnn"), Part("slam"), 1, "1.0"),
        RunSpec(part, Part("ekf"), Part("nn"), Part("slam", {"hits": 1}), 1, "1.0"),
        RunSpec(part, Part("ekf"), Part("nn"), Part("slam"), 2, "1.0"),
        RunSpec(part, Part("ekf"), Part("nn"), Part("slam"), 1, "1.1"),
    ]
    assert len({run.key for run in [base, *others]}) == 7
    assert base.case == others[-1].case == others[-2].case


def test_digest_tells_a_text_from_a_number_and_takes_infinity() -> None:
    assert digest({"a": 1}) != digest({"a": "1"})
    assert digest({"a": float("inf")}) != digest({"a": float("-inf")})


def test_options_are_a_grid_too() -> None:
    found = from_options(["cloister"], [], ["nn", "jcbb"], ["laps=2", "associator.gate=[0.9, 0.99]"], "5..7")
    assert found.seeds == (5, 6, 7)
    assert len(found.runs()) == 3 * 4
    assert found.scenarios[0].params == {"laps": 2}


def test_degrees_become_radians() -> None:
    part = grid(associator=[{"use": "nn", "tilt_deg": 180.0}]).associators[0]
    assert part.params == {"tilt": pytest.approx(3.14159265)}


def test_dry_run_counts_and_writes_nothing(tmp_path: Path) -> None:
    found = dry_run(grid(), tmp_path / "out")
    assert found.runs == 6
    assert found.seconds > 0
    assert found.measured == 1.0
    assert not (tmp_path / "out").exists()
