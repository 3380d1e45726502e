"""The example on docs/csv-layout.md is a log that loads and runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import tomthumb

PAGE = (Path(__file__).parents[1] / "docs" / "csv-layout.md").read_text("utf-8")


def test_the_example_is_a_log(tmp_path):
    blocks = re.findall(r"`(\S+\.(?:toml|csv))`[^`]*:\n\n```\w+\n(.*?)```", PAGE, re.DOTALL)
    assert [name for name, _ in blocks] == ["scenario.toml", "odometry.csv", "observations.csv"]
    for name, text in blocks:
        (tmp_path / name).write_text(text)
    scenario = tomthumb.load(str(tmp_path))
    assert scenario.name == "yard"
    assert [len(step.observations) for step in scenario.steps if step.observations is not None] == [2, 1, 0]
    trace = tomthumb.run(scenario, associator="jcbb")
    assert trace.ids.tolist() == [0, 1, 0]
    assert trace.pose[-1, 0] == pytest.approx(1.5, abs=0.1)
    assert tomthumb.evaluate(trace, scenario)["ate_m"] is None
