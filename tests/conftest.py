"""What the tests share. Tests that need a log ask for `data_dir` and skip, with a reason, where there is none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def find_data() -> Path | None:
    """The folder of logs: TOMTHUMB_DATA, or shared/data beside the checkout."""
    named = os.environ.get("TOMTHUMB_DATA")
    places = [Path(named)] if named else [above / "shared" / "data" for above in Path(__file__).resolve().parents[2:]]
    return next((place for place in places if place.is_dir()), None)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of logs; the test is skipped where it is absent."""
    folder = find_data()
    if folder is None:
        pytest.skip("no data: set TOMTHUMB_DATA or put shared/data beside the checkout")
    return folder
