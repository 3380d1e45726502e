"""`tomthumb forest` as its users see it: one JSON object, clear errors with code 2, animations with moving pictures."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

COMMAND = [sys.executable, "-c", "import sys; from tomthumb.cli.main import main; sys.exit(main())", "forest"]


def run(*arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == code, done.stderr
    return done


def test_json_is_golden() -> None:
    told = json.loads(run("--seed", "1", "--json").stdout)
    assert {k: told[k] for k in ("iterations", "moves", "distance", "ogre_visits", "award", "home")} == {
        "iterations": 2, "moves": 100, "distance": 394, "ogre_visits": 1, "award": 1.0, "home": True,
    }  # fmt: skip


def test_infinity_is_null_with_a_flag() -> None:
    told = json.loads(run("--award", "inf", "--json").stdout)
    assert told["award"] is None
    assert told["award_infinite"] is True


def test_many_runs_and_rules() -> None:
    told = json.loads(run("--runs", "3", "--set", "lam=1.5", "--set", "boots=3", "--json").stdout)
    assert [row["seed"] for row in told["runs"]] == [1, 2, 3]
    assert told["mean"]["moves"] == pytest.approx(np.mean([row["moves"] for row in told["runs"]]))


def test_a_drawn_forest_and_its_errors(tmp_path: Path) -> None:
    drawn = tmp_path / "forest.txt"
    drawn.write_text("H.......\n........\n....O...\n........\n........\n......K.\n........\n........\n")
    assert "1.0" in run("--map", str(drawn)).stdout
    drawn.write_text("H..\n..?\n...\n")
    assert "line 2, column 3" in run("--map", str(drawn), code=2).stderr
    assert "cannot be read" in run("--map", str(tmp_path / "none.txt"), code=2).stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--set", "lamb=2"], "did you mean 'lam'"),
        (["--set", "lam=abc"], "lam is a float"),
        (["--set", "lam=7"], "lambda is in (1, 3]"),
        (["--set", "lam"], "key=value"),
        (["-o", "tale.avi"], ".gif"),
        (["-o", "no/such/folder/tale.gif"], "no folder"),
        (["--size", "2"], "at least 4"),
    ],
)
def test_wrong_input_is_one_line_and_code_2(arguments: list[str], said: str) -> None:
    done = run(*arguments, code=2)
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_animation_moves(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="needs pillow")
    target = tmp_path / "tale.gif"
    told = json.loads(run("--size", "16", "--frames", "12", "-o", str(target), "--json").stdout)
    assert told["home"]
    with image.open(target) as film:
        assert film.n_frames >= 6
        pictures = []
        for k in (0, film.n_frames // 2, film.n_frames - 1):
            film.seek(k)
            pictures.append(np.asarray(film.convert("RGB")).copy())
    assert all(p.std() > 20 for p in pictures)
    assert (pictures[0] != pictures[1]).any()
    assert (pictures[1] != pictures[2]).any()


def test_html_and_png_and_mp4(tmp_path: Path) -> None:
    page, picture = tmp_path / "tale.html", tmp_path / "tale.png"
    run("--size", "16", "--frames", "4", "-o", str(page))
    assert page.read_text("utf-8").count("data:image/png") >= 4
    run("--size", "16", "-o", str(picture))
    assert picture.stat().st_size > 5000
    film = tmp_path / "tale.mp4"
    if shutil.which("ffmpeg"):
        run("--size", "16", "--frames", "4", "-o", str(film))
        assert film.stat().st_size > 1000
    else:
        assert "ffmpeg" in run("-o", str(film), code=2).stderr


def test_live_draws_the_window() -> None:
    shown = run("--size", "16", "--live", "--fps", "0").stderr
    assert "brother7" in shown
    assert "wallet" in shown


def test_watching_does_not_change_the_tale(tmp_path: Path) -> None:
    plain = run("--seed", "4", "--json").stdout
    assert run("--seed", "4", "--json", "--frames", "4", "-o", str(tmp_path / "t.png")).stdout == plain
