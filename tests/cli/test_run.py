"""tomthumb run, plot and list."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tomthumb.known_map import FIRST
from tomthumb.storage import load_lessons, load_run

KEYS = ["match_rate", "precision", "recall", "wrong_ids", "purity", "idf1", "duplicates", "ate_m", "rmse_x_m"]
KEYS += ["rmse_y_m", "nees", "map_rmse_m", "landmarks", "steps", "step_ms_p50", "associate_us_p50"]
KEYS += ["associate_us_p99", "failure"]


def test_json_is_one_object_with_the_promised_keys(tomthumb):
    said = tomthumb("run", "cloister", "--associator", "oracle", "--json")
    assert said.code == 0
    assert set(KEYS) <= set(said.json)
    assert said.json["match_rate"] == 1.0
    assert said.json["steps"] == 168
    assert said.err == ""


def test_the_default_seed_is_0_and_seeds_differ(tomthumb):
    runs = {
        s: tomthumb("run", "cloister", "-a", "nn", "--json", *s).json["ate_m"] for s in ((), ("-s", "0"), ("-s", "1"))
    }
    assert runs[()] == runs["-s", "0"] != runs["-s", "1"]


def test_settings_reach_world_and_parts(tomthumb):
    said = tomthumb(
        "run", "cloister", "--json", "--associator", "jcbb",
        "--set", "laps=2", "--set", "teach=1", "--set", "associator.gate=0.9999",
    )  # fmt: skip
    assert said.json["steps"] == 336
    assert said.json["scored"] < 1500  # the taught lap is not scored
    assert said.json["settings"] == {"scenario": {"laps": 2, "teach": 1}, "associator": {"gate": 0.9999}}


def test_a_file_of_settings_does_the_same(tomthumb, tmp_path):
    file = tmp_path / "two.toml"
    file.write_text("[scenario]\nlaps = 3\nteach = 1\n[associator]\ngate = 0.99\n")
    said = tomthumb("run", "cloister", "-a", "nn", "--json", "--config", file, "--set", "laps=2")
    assert said.json["steps"] == 336


def test_out_writes_everything_and_plot_draws_it_again(tomthumb, tmp_path):
    folder = tmp_path / "out"
    said = tomthumb("run", "cloister", "-a", "jcbb", "-o", folder)
    assert said.code == 0
    assert "match %" in said.out
    figures = [f"{name}.{kind}" for name in ("map", "error", "consistency") for kind in ("png", "svg")]
    assert {f.name for f in folder.iterdir()} == {*figures, "trajectory.tum", "map.csv", "trace.npz", "report.html"}
    assert np.loadtxt(folder / "trajectory.tum").shape == (168, 8)
    assert load_run(folder).about["associator"] == "jcbb"
    before = (folder / "map.svg").read_bytes()
    (folder / "map.svg").unlink()
    assert tomthumb("plot", folder).code == 0
    assert (folder / "map.svg").read_bytes() == before
    assert tomthumb("plot", folder, "-f", "trail", "-o", tmp_path / "more").code == 0
    assert (tmp_path / "more" / "trail.png").is_file()


def test_a_saved_map_can_be_started_in(tomthumb, tmp_path):
    tomthumb("run", "cloister", "-a", "jcbb", "-o", tmp_path / "one", "--json")
    for saved, sets in ((tmp_path / "one", ()), (tmp_path / "one" / "map.csv", ("--set", "slam.frozen=true"))):
        row = tomthumb("run", "cloister", "-a", "jcbb", "-s", 5, "--map", saved, "--json", *sets).json
        assert row["wrong_ids"] == 0
        assert row["match_rate"] > 0.98
        assert row["landmarks"] == 88


def test_what_was_learned_is_saved_with_the_map_and_taken_up_again(tomthumb, tmp_path):
    learn = ("-a", "stt", "--set", "associator.memory=true", "--json", "-o")
    tomthumb("run", "cloister", *learn, tmp_path / "one")
    first = load_lessons(tmp_path / "one")
    assert len(first.ids) == 88
    tomthumb("run", "cloister", "-s", 5, "--map", tmp_path / "one", *learn, tmp_path / "two")
    second = load_lessons(tmp_path / "two")
    assert set(second.ids.tolist()) == {FIRST + k for k in range(88)}
    assert second.total > 1.8 * first.total
    assert second.sightings.min() > first.sightings.min()


def test_list_names_parts_and_their_parameters(tomthumb):
    found = tomthumb("list", "--json").json
    assert {"oracle", "nn", "gnn", "jcbb", "stt"} <= {entry["name"] for entry in found["associators"]}
    assert "cloister" in {entry["name"] for entry in found["scenarios"]}
    jcbb = next(entry for entry in found["associators"] if entry["name"] == "jcbb")
    assert jcbb["parameters"]["gate"] == 0.99
    said = tomthumb("list", "estimators")
    assert "ekf" in said.out
    assert "jcbb" not in said.out


WRONG = [
    (["run", "cloistre"], "did you mean 'cloister'"),
    (["run", "no/such/folder"], "no such file or folder"),
    (["run", "cloister", "-a", "jcb"], "did you mean 'jcbb'"),
    (["run", "cloister", "-e", "ekff"], "did you mean 'ekf'"),
    (["run", "cloister", "-a", "./nowhere.py:Mine"], "no such file"),
    (["run", "cloister", "--set", "lap=2"], "did you mean 'laps'"),
    (["run", "cloister", "--set", "laps=0"], "laps=0"),
    (["run", "cloister", "--set", "laps"], "key=value"),
    (["run", "cloister", "--set", "associatr.gate=1"], "did you mean 'associator'"),
    (["run", "cloister", "-a", "jcbb", "--set", "associator.gat=1"], "did you mean 'gate'"),
    (["run", "cloister", "-a", "jcbb", "--set", "associator.gate=wide"], "associator.gate must be a number"),
    (["run", "cloister", "--set", "slam.widht=2"], "did you mean 'width'"),
    (["run", "cloister", "--set", "slam.hits=x"], "slam.hits must be a whole number"),
    (["run", "cloister", "--set", "slam.king=maybe"], "slam.king must be true or false, got 'maybe'"),
    (["run", "cloister", "--set", "slam.loops=5"], "slam.loops must be true or false, got 5"),
    (["run", "cloister", "--set", "slam.frozen=7"], "slam.frozen must be true or false"),
    (["run", "cloister", "--set", "slam.lost=true"], "slam.lost=true needs a map"),
    (["run", "cloister", "--set", "slam.revision=abc"], "slam.revision must be a whole number, got 'abc'"),
    (["run", "cloister", "--set", "slam.revision=nan"], "slam.revision must be a whole number"),
    (["run", "cloister", "--set", "slam.revision=-3"], "slam.revision=-3"),
    (["run", "cloister", "--set", "slam.width=0"], "slam.width=0"),
    (["run", "cloister", "--set", "slam.width=many"], "slam.width must be a whole number"),
    (["run", "cloister", "--set", "slam.confusion=nan"], "slam.confusion within [0, 1)"),
    (["run", "cloister", "--set", "kidnap=5"], "kidnap=5: two steps are wanted"),
    (["run", "cloister", "--set", "kidnap=5:²"], "two steps are wanted"),
    (["run", "cloister", "--set", f"kidnap=5:{'9' * 5000}"], "two steps are wanted"),
    (["run", "cloister", "--set", "kidnap=5:-1"], "kidnap 5:-1: steps from 0 to 167 are there"),
    (["run", "cloister", "--set", "kidnap=5:168"], "kidnap 5:168: steps from 0 to 167 are there"),
    (["run", "cloister", "--set", "slam.signature=perhaps"], "valid: off, gate, ratio"),
    (["run", "cloister", "--config", "nowhere.toml"], "nowhere.toml"),
    (["run", "cloister", "--map", "nowhere.csv"], "nowhere.csv"),
    (["run", "cloister", "-a", "nn", "--out", "/dev/null/x"], "cannot be written"),
    (["plot", "nowhere"], "nowhere"),
    (["list", "associator"], "did you mean 'associators'"),
    (["rum", "cloister"], "did you mean 'run'"),
    (["run"], "Missing argument"),
    (["run", "cloister", "--sed", "1"], "--sed"),
    (["run", "cloister", "--seed", "-1"], "--seed"),
    (["explain", "cloister", "--step", "-1"], "Invalid value for '--step'"),
    (["explain", "cloister", "--step", "some"], "Invalid value for '--step'"),
    (["explain", "cloister", "--step", "1", "--observation", "-1"], "Invalid value for '--observation'"),
    (["explain", "out/nowhere", "--step", "1"], "no such file or folder"),
    (["bench", "--patience", "0"], "Invalid value for '--patience'"),
    (["bench", "--patience", "nan"], "--patience"),
    (["run", "cloister", "--set", "associator.listed=nan"], "associator.listed="),
    (["run", "cloister", "--set", "associator.patience=-3"], "associator.patience="),
    (["run", "cloister", "--set", "slam.chance=-1"], "slam.chance="),
    (["run", "cloister", "--set", "slam.still=1.5"], "slam.still=1.5: a number from 0 to 1"),
    (["run", "cloister", "--set", "slam.chance=nan"], "slam.chance="),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG, ids=lambda case: " ".join(case)[-40:] if case else "")
def test_bad_input_is_one_line_and_exit_code_2(tomthumb, arguments, message):
    said = tomthumb(*arguments)
    assert said.code == 2
    assert said.out == ""
    assert said.err.count("\n") == 1, said.err
    assert said.err.startswith("error: ")
    assert message in said.err


def test_a_mistake_in_a_foreign_file_keeps_its_traceback(tomthumb, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("class Mine:\n    def associate(self, problem, rng):\n        return [1 / 0]\n")
    with pytest.raises(ZeroDivisionError):
        tomthumb("run", "cloister", "-a", f"{file}:Mine")


def test_known_logs_are_recognised_by_their_folder(tomthumb, data_dir: Path):
    said = tomthumb("run", data_dir / "car_park", "-a", "oracle", "--json")
    assert said.code == 0, said.err
    assert said.json["steps"] > 1000
    assert said.json["match_rate"] == 1.0


@pytest.mark.parametrize("name", ["s1_x1_GT", "s1_x1_NN", "s1_x1_JCBB", "s1_x2_GT", "s1_x2_JCBB"])
def test_golden_traces_agree(tomthumb, data_dir: Path, name):
    associator = {"GT": "oracle", "NN": "nn", "JCBB": "jcbb"}[name.split("_")[-1]]
    file = data_dir / "neira_cloister" / f"{name}.mat"
    row = tomthumb("run", f"golden:{file}", "-a", associator, "--set", "faithful=true", "--json").json
    assert row["golden_agree"] == row["golden_of"] == 1390
    assert row["golden_state_error"] < 1e-8
