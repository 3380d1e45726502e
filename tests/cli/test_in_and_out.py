"""tomthumb info, export and fetch: logs on their way in, results on their way out."""

from __future__ import annotations

import json

import numpy as np


def test_info_tells_what_a_world_holds(tomthumb):
    row = tomthumb("info", "cloister", "--json").json
    assert (row["steps"], row["observations"], row["landmarks"]) == (168, 1402, 88)
    assert "suggested" in tomthumb("info", "cloister", "--suggest", "--json").json
    said = tomthumb("info", "cloister", "--set", "laps=2")
    assert "336" in said.out


def test_a_saved_run_goes_out_again(tomthumb, tmp_path):
    folder = tmp_path / "run"
    assert tomthumb("run", "cloister", "-a", "oracle", "-o", folder, "--json").code == 0
    assert tomthumb("export", folder, tmp_path / "run.tum").code == 0
    assert np.loadtxt(tmp_path / "run.tum").shape == (168, 8)
    assert tomthumb("export", folder / "trace.npz", tmp_path / "run.g2o").code == 0
    assert "EDGE_SE2_XY" in (tmp_path / "run.g2o").read_text()
    assert tomthumb("export", folder, tmp_path / "out.txt", "--format", "json").code == 0
    json.loads((tmp_path / "out.txt").read_text())
    said = tomthumb("export", folder, tmp_path / "run.tumm")
    assert said.code == 2
    assert "did you mean" in said.err or "Valid" in said.err


def test_fetch_lists_what_there_is_and_names_what_there_is_not(tomthumb, tmp_path):
    known = tomthumb("fetch", "--json").json
    assert all(row["megabytes"] > 0 and row["licence"] for row in known.values())
    assert "car_park" in tomthumb("fetch").out
    said = tomthumb("fetch", "car_parc", "-o", tmp_path)
    assert said.code == 2
    assert "did you mean 'car_park'" in said.err
