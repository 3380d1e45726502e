import os
from pathlib import Path

import numpy as np
import pytest


def data_root() -> Path | None:
    given = os.environ.get("TOMTHUMB_DATA")
    candidates = [Path(given)] if given else [p / "shared" / "data" for p in Path(__file__).resolve().parents]
    return next((p for p in candidates if p.is_dir()), None)


@pytest.fixture
def data():
    """A function from the name of a log's folder to its path; skips the test where the log is not there."""

    def find(name: str) -> Path:
        root = data_root()
        if root is None or not (root / name).exists():
            pytest.skip(f"the log {name} is not at TOMTHUMB_DATA nor in shared/data beside the checkout")
        return root / name

    return find


@pytest.fixture
def same():
    """A function that asserts that two scenarios are equal, steps and all."""
    return assert_same


def assert_same(a, b):
    assert a.name == b.name
    assert a.motion == b.motion
    assert a.sensor == b.sensor
    assert (a.score_from, a.teach_steps) == (b.score_from, b.teach_steps)
    np.testing.assert_array_equal(a.prior.pose, b.prior.pose)
    np.testing.assert_array_equal(a.prior.cov, b.prior.cov)
    _equal(a.landmarks, b.landmarks)
    assert len(a.steps) == len(b.steps)
    for one, two in zip(a.steps, b.steps, strict=True):
        _same_step(one, two)


def _same_step(one, two):
    assert one.t == two.t
    for part in ("control", "observations", "truth"):
        x, y = getattr(one, part), getattr(two, part)
        assert (x is None) == (y is None)
        for name in () if x is None else x.__slots__:
            _equal(getattr(x, name), getattr(y, name))


def _equal(x, y):
    if x is None or y is None:
        assert x is y
    else:
        np.testing.assert_array_equal(x, y)
