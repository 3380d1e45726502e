"""Points in cells: each in its own, all of them once, and never more cells than memory is meant for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tomthumb
from tomthumb.kernels.grid import MOST, fill_grid


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 40),
    least=st.floats(1e-12, 10.0),
    sides=st.tuples(st.floats(0.0, 1e6), st.floats(0.0, 1e6)),
)
@settings(max_examples=100, deadline=None)
def test_every_point_is_listed_once_in_the_cell_that_holds_it(seed, n, least, sides):
    points = np.random.default_rng(seed).random((n, 2)) * sides
    cell, low, shape, start, index = fill_grid(points, least)
    assert cell >= least
    assert len(start) - 1 == shape[0] * shape[1] <= 4 * MOST
    assert sorted(index.tolist()) == list(range(n))
    for c in np.flatnonzero(np.diff(start)):
        corner = low + cell * np.array(divmod(int(c), int(shape[1])))
        inside = points[index[start[c] : start[c + 1]]] - corner
        assert (inside >= -1e-9 * (1.0 + np.abs(corner))).all()
        assert (inside <= cell + 1e-9 * (1.0 + np.abs(corner))).all()


def test_the_side_is_as_asked_for_where_there_is_room():
    points = np.array([[0.0, 0.0], [10.0, 5.0], [2.5, 2.4]])
    cell, low, shape, *_ = fill_grid(points, 0.5)
    assert (cell, *low, *shape) == (0.5, 0.0, 0.0, 21, 11)


@pytest.mark.parametrize("noise", [1e-4, 1e-5])
def test_a_sensor_of_microns_needs_no_terabytes(noise):
    """The cells are as wide as a vote reaches, which is next to nothing here."""
    world = tomthumb.load("cloister", sensor_noise=noise, odometry="none")
    trace = tomthumb.run(world, associator="stt")
    assert len(trace.t) == len(world.steps) or trace.failure
