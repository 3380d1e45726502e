"""The commands as users call them: exit codes, JSON alone on stdout, one line for bad input."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

GRID = """
seeds = 2
[[scenario]]
use = "cloister"
[[associator]]
use = "nn"
[[associator]]
use = "jcbb"
"""


def tomthumb(*arguments: object, home: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from tomthumb.cli.main import main; main()", *map(str, arguments)]
    path = ":".join(sys.path)
    environment = {"PYTHONPATH": path, "PATH": "/usr/bin:/bin", "HOME": str(home)}
    return subprocess.run(command, capture_output=True, text=True, cwd=home, env=environment, check=False)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("home")
    (folder / "g.toml").write_text(GRID)
    first = tomthumb("bench", "g.toml", "-o", "out", "--workers", 2, "--json", "--keep", "then.csv", home=folder)
    assert first.returncode == 0, first.stderr
    told = json.loads(first.stdout)
    assert (told["planned"], told["rows"], told["new"], told["failed"]) == (4, 4, 4, 0)
    return folder


def test_continued_and_watched(home: Path) -> None:
    again = tomthumb("bench", "g.toml", "-o", "out", "--json", "--against", "then.csv", home=home)
    assert again.returncode == 0
    told = json.loads(again.stdout)
    assert (told["new"], told["against"]["shared"], told["against"]["worse"]) == (0, 4, False)


def test_something_worse_ends_with_one(home: Path) -> None:
    text = (home / "then.csv").read_text().replace("done", "error")
    (home / "better.csv").write_text((home / "then.csv").read_text())
    (home / "broken.csv").write_text(text)
    assert tomthumb("bench", "g.toml", "-o", "out", "--against", "broken.csv", home=home).returncode == 0
    script = (
        "import sys; from pathlib import Path; from tomthumb.bench.journal import writing\n"
        "with writing(Path(sys.argv[1])) as j, j.base: "
        "j.base.execute(\"UPDATE runs SET status = 'error', reason = 'broke' WHERE key = "
        '(SELECT key FROM plan WHERE position = 1)")'
    )
    environment = {"PYTHONPATH": ":".join(sys.path)}
    subprocess.run([sys.executable, "-c", script, home / "out" / "journal.sqlite"], env=environment, check=True)
    end = tomthumb("bench", "g.toml", "-o", "out", "--against", "better.csv", home=home)
    assert end.returncode == 1
    assert "fails now: cloister: jcbb, seed 0: error: broke" in end.stdout
    assert tomthumb("bench", "g.toml", "-o", "out", "--retry", home=home).returncode == 0


def test_report(home: Path) -> None:
    end = tomthumb("report", "out", "--pages", 1, home=home)
    assert end.returncode == 0, end.stderr
    assert end.stdout.strip() == "out/report/index.html"
    assert (home / "out" / "report" / "index.html").exists()


def test_dry_run_by_options(home: Path) -> None:
    end = tomthumb(
        "bench", "--associator", "nn", "--seeds", 5, "--set", "laps=[1, 2]", "--dry-run", "--json", home=home
    )
    told = json.loads(end.stdout)
    assert told["runs"] == 10
    assert told["seconds"] > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.toml"], "nowhere.toml"),
        (["g.toml", "--associator", "nn"], "cannot be added to a grid file"),
        (["g.toml", "--shard", "5/4"], "k/n"),
        (["g.toml", "--against", "nowhere.csv"], "no such file"),
        (["--associator", "jcb"], "did you mean 'jcbb'"),
        (["g.toml", "--merge", "-o", "empty"], "no journals of shards"),
    ],
)
def test_bad_input_is_one_line(home: Path, arguments: list[str], said: str) -> None:
    end = tomthumb("bench", *arguments, home=home)
    assert end.returncode == 2
    assert said in end.stderr
    assert end.stderr.count("\n") == 1
    assert end.stdout == ""


def test_shards_by_command(home: Path) -> None:
    for k in (1, 2):
        assert tomthumb("bench", "g.toml", "-o", "parts", "--shard", f"{k}/2", "--json", home=home).returncode == 0
    end = tomthumb("bench", "g.toml", "-o", "parts", "--merge", "--json", home=home)
    assert json.loads(end.stdout)["rows"] == 4
