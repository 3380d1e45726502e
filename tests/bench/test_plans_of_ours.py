"""The plans of ablation and sensitivity: every row is a grid that holds together, and every row means something."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tomthumb.bench.grid import from_table
from tomthumb.bench.validate import validate

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def scripts():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import ablation
        import paired
        import sensitivity

        yield ablation, sensitivity, paired
    finally:
        sys.path.remove(str(BENCHMARKS))


def plan(name: str):
    return tomllib.loads((BENCHMARKS / "plans" / f"{name}.toml").read_text("utf-8"))


def test_every_row_of_the_ablation_is_run_once_a_cell_and_seed(scripts):
    ablation, _, _ = scripts
    chosen = plan("ablation")
    grids = [from_table(table, BENCHMARKS) for table in ablation.grids(chosen, chosen["row"]).values()]
    for grid in grids:
        validate(grid)
    runs = [run for grid in grids for run in grid.runs()]
    assert len({run.key for run in runs}) == len(runs) == len(chosen["row"]) * len(chosen["cell"]) * len(grids[0].seeds)
    assert chosen["row"][0]["label"] == ablation.WHOLE


def test_every_value_of_the_sensitivity_is_a_method_and_the_default_is_one(scripts):
    _, sensitivity, _ = scripts
    chosen = plan("sensitivity")
    for parameter in chosen["parameter"]:
        grid = from_table(sensitivity.grid(chosen, parameter), BENCHMARKS)
        assert len(grid.methods()) == len(parameter["values"])
        assert parameter["default"] in parameter["values"]
        for value in parameter["values"]:
            wanted = sensitivity.label(value)
            assert sum(sensitivity._is(method, wanted) for method in grid.methods()) == 1


def test_defaults_of_the_plan_are_those_of_the_code(scripts):
    from tomthumb.associators.tom_thumb import TomThumb
    from tomthumb.lifecycle import LifeCycle

    for parameter in plan("sensitivity")["parameter"]:
        owner = LifeCycle() if parameter.get("part") == "slam" else TomThumb()
        np.testing.assert_allclose(getattr(owner, parameter["key"]), parameter["default"], err_msg=parameter["key"])


def row(method, seed, rate):
    return {"scenario": "w", "method": method, "seed": seed, "status": "done", "match_rate": rate}


def test_differences_are_taken_within_a_world(scripts):
    *_, paired = scripts
    rng = np.random.default_rng(0)
    base = rng.normal(0.9, 0.05, 30)
    rows = [row("a", k, v) for k, v in enumerate(base)]
    rows += [row("b", k, v + 0.01) for k, v in enumerate(base)] + [row("b", 99, 0.0)]
    found = paired.differences(rows, "match_rate", "a")
    assert list(found) == [("w", "b")]
    assert found["w", "b"].mean == pytest.approx(0.01)
    assert found["w", "b"].n == 30
    assert paired.points(found["w", "b"]) == "**+1.00 [+1.00, +1.00]**"
    assert paired.points(paired.differences([*rows[:30], row("c", 0, base[0])], "match_rate", "a")["w", "c"]) == "0"


def test_a_table_goes_between_its_marks_and_nowhere_else(scripts, tmp_path):
    *_, paired = scripts
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- one: by x -->\nold\n<!-- end of one -->\nafter\n")
    paired.write(page, "one", "new")
    paired.write(page, "one", "newer")
    assert page.read_text() == "before\n<!-- one: by x -->\n\nnewer\n\n<!-- end of one -->\nafter\n"
