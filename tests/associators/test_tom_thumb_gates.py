"""The two gates: the first chooses the pose basin, the second completes it."""

from __future__ import annotations

import numpy as np

import tomthumb


def along_a_row(shift):
    """Three of a row of landmarks 1 m apart seen at `shift`, one more expected ahead; only the pose (.2 m) is uncertain."""
    row = np.column_stack([np.arange(4.0), np.zeros(4)])
    common = np.kron(np.ones((4, 4)), np.diag([0.04, 1e-4]))
    cov = common + 1e-4 * np.eye(8)
    return row[:3] + np.array([shift, 0.0]), row, cov, 1e-4 * np.eye(2)


def named(shift, **settings):
    z, row, cov, R = along_a_row(shift)
    return tomthumb.associate(
        z, row, cov, R, method="stt", angles=(), clutter=1e-3, hard=99.0, **settings
    ).match.tolist()


def test_a_pair_outside_the_first_gate_is_kept_when_its_basin_is_the_only_one():
    two = (0.99, 1.0 - 1e-6)
    assert named(0.0, gates=two) == named(0.0) == [0, 1, 2]
    assert named(0.45, gates=two) == named(0.45) == [0, 1, 2]


def test_a_far_basin_that_explains_more_loses_to_one_within_the_first_gate():
    row = np.column_stack([np.arange(4.0), np.zeros(4)])
    z = row + np.array(
        [1.0, 0.0]
    )  # true: 1, 2, 3 and one beyond; a pose 5 sigma away explains all four (joint d2 25, gate 20.1)
    cov = np.kron(np.ones((4, 4)), np.diag([0.04, 1e-4])) + 1e-4 * np.eye(8)
    args = (z, row, cov, 1e-4 * np.eye(2))
    given = {"method": "stt", "angles": (), "clutter": 1e-6, "hard": 99.0}
    narrow = tomthumb.associate(*args, gates=(0.99, 1.0 - 1e-6), **given)
    assert narrow.match.tolist() == [1, 2, 3, -1]
    wide = tomthumb.associate(*args, **given)
    assert wide.match.tolist() == [0, 1, 2, 3]
