"""Opening the package and the help costs next to nothing."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

HEAVY = ("numpy", "scipy", "numba", "matplotlib", "rich.progress")


@pytest.mark.parametrize(
    "code", ["import tomthumb", "import tomthumb.cli.main as m; m.app(['--help'], standalone_mode=False)"]
)
def test_nothing_heavy_is_imported(code):
    script = f"{code}\nimport sys\nprint('HEAVY', [name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_help_takes_little_more_cpu_than_python_and_typer():
    def cpu(code: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    base = min(cpu("import typer, rich.console, rich.table, rich.panel") for _ in range(3))
    ours = min(
        cpu("import sys; sys.argv = ['tomthumb', '--help']; from tomthumb.cli.main import main; main()")
        for _ in range(3)
    )
    assert ours < 3.0 * base + 0.1


def test_every_public_name_is_there():
    import tomthumb

    for name in tomthumb.__all__:
        assert getattr(tomthumb, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        tomthumb.nothing  # noqa: B018


def test_version(tomthumb):
    import tomthumb as package

    said = tomthumb("--version")
    assert said.out.strip() == f"tomthumb {package.__version__}"
