"""The examples run and do what they say."""

from __future__ import annotations

import runpy
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_associate_behind_a_filter_of_ones_own():
    rate, error = runpy.run_path(str(EXAMPLES / "own_filter.py"))["main"]()
    assert rate > 0.98
    assert error < 0.1
