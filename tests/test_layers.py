"""Who may import whom (CONTRIBUTING.md): read from the source, without importing it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "tomthumb"

# part: the parts of ours that it may import besides itself
BASE = {"errors", "geometry", "types", "protocols", "kernels"}
MAY = {
    "errors": set(),
    "geometry": set(),
    "kernels": set(),
    "types": {"protocols", "kernels"},  # the protocols for their types only
    "protocols": {"types"},
    "models": BASE,
    "estimators": BASE | {"models"},  # for the sensitivity to calibration states only
    "gains": BASE,
    "associators": BASE | {"gains", "tale"},
    "appearance": BASE,
    "graves": BASE,
    "stillness": BASE,
    "lifecycle": BASE | {"appearance", "graves", "stillness"},
    "sensing": BASE,
    "twins": BASE | {"lifecycle", "sensing"},
    "doubt": BASE | {"lifecycle"},
    "returns": BASE | {"branches", "graves", "lifecycle"},
    "copies": BASE | {"branches", "gains", "slam"},  # the loop for its type only
    "slam": BASE
    | {
        "appearance",
        "branches",
        "checks",
        "copies",
        "court",
        "doubt",
        "king",
        "lifecycle",
        "returns",
        "revision",
        "sensing",
        "stillness",
        "twins",
        "watch",
    },
    "metrics": BASE,
}


def imports(file: Path) -> set[str]:
    """The parts of tomthumb that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
        if isinstance(node, ast.ImportFrom) and node.module == "tomthumb":
            names = [f"tomthumb.{alias.name}" for alias in node.names]
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        found |= {name.split(".")[1] for name in names if name.startswith("tomthumb.")}
    return found


def files(part: str) -> list[Path]:
    single = SOURCE / f"{part}.py"
    return [single] if single.is_file() else sorted((SOURCE / part).rglob("*.py"))


@pytest.mark.parametrize("part", MAY)
def test_a_part_imports_only_what_it_may(part):
    assert files(part)
    for file in files(part):
        beyond = imports(file) - MAY[part] - {part}
        assert not beyond, f"{file.relative_to(SOURCE)} imports {', '.join(sorted(beyond))}"


def test_nobody_imports_the_command_line():
    for file in SOURCE.rglob("*.py"):
        if file.relative_to(SOURCE).parts[0] != "cli":
            assert "cli" not in imports(file), file
