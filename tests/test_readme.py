"""The README is true: its commands, its code, its table, its links."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
COMMANDS = re.findall(r"^\| `tomthumb ([^`]*)`", TEXT, re.MULTILINE)


def test_it_starts_with_two_commands_that_do_all_the_set_up():
    block = re.search(r"```sh\n(.*?)```", TEXT, re.DOTALL)
    assert block is not None
    assert TEXT.index("```sh") < 200
    main, tests = block[1].strip().splitlines()
    setup = 'python3 -m venv .venv && .venv/bin/pip install -c constraints.txt -e ".[dev]" && '
    assert main == setup + ".venv/bin/tomthumb demo"
    assert tests == setup + ".venv/bin/python -m pytest -n auto"


def test_the_python_in_it_runs():
    namespace: dict[str, object] = {}
    for code in PYTHON:
        exec(compile(code, "README.md", "exec"), namespace)
    assert len(PYTHON) >= 3


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("run cloister --associator")])
def test_the_commands_in_it_run(command, tmp_path):
    call = [sys.executable, "-c", "from tomthumb.cli.main import main; main()", *command.split()]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_command_in_it_exists():
    from tomthumb.cli.main import COMMANDS as KNOWN

    assert {command.split()[0] for command in COMMANDS} <= set(KNOWN)


def test_its_table_is_what_the_demo_gives():
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "readme_table.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "page", sorted(p.relative_to(ROOT).as_posix() for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", (ROOT / page).read_text("utf-8")):
        if not target.startswith(("http://", "https://")):
            assert ((ROOT / page).parent / target).exists(), f"{page}: {target}"
