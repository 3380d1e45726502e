import math

import numpy as np
import pytest

from tomthumb.detectors import cluster, poles, reflectors, trunks
from tomthumb.errors import TomThumbError

ANGLES = np.radians(0.5) * np.arange(361) - math.pi / 2
FAR = 81.91


def scan(*things, noise=0.0, rng=None):
    """Ranges to circles (x, y, diameter) seen from the origin."""
    ranges = np.full(len(ANGLES), FAR)
    for x, y, diameter in things:
        r, b = math.hypot(x, y), math.atan2(y, x)
        across = r * np.sin(ANGLES - b)
        hit = (np.abs(across) < diameter / 2) & (np.cos(ANGLES - b) > 0)
        depth = r * np.cos(ANGLES - b) - np.sqrt(np.maximum((diameter / 2) ** 2 - across**2, 0))
        ranges = np.where(hit, np.minimum(ranges, depth), ranges)
    if rng is not None:
        ranges = np.where(ranges < FAR, ranges + noise * rng.standard_normal(len(ranges)), ranges)
    return ranges


def test_trunks_are_found_where_they_stand():
    things = [(10.0, 0.0, 0.5), (5.0, 6.0, 0.4), (8.0, -15.0, 0.8)]
    found = trunks(scan(*things), ANGLES)
    assert len(found.z) == 3
    for x, y, diameter in things:
        want = math.hypot(x, y), math.atan2(y, x)
        k = np.abs(found.z[:, 1] - want[1]).argmin()
        assert found.z[k, 0] == pytest.approx(want[0], abs=0.1)
        assert found.z[k, 1] == pytest.approx(want[1], abs=math.radians(0.3))
        assert found.diameter[k] == pytest.approx(diameter, abs=0.2)


def test_covariances_fit_the_errors():
    rng = np.random.default_rng(3)
    d2 = []
    for _ in range(800):
        r, b, diameter = rng.uniform(4, 30), rng.uniform(-1.4, 1.4), rng.uniform(0.2, 0.8)
        found = trunks(scan((r * math.cos(b), r * math.sin(b), diameter), noise=0.05, rng=rng), ANGLES)
        if len(found.z) == 1:
            nu = found.z[0] - [r, b]
            d2.append(nu @ np.linalg.solve(found.R[0], nu))
    assert len(d2) > 600
    assert 0.5 < np.mean(d2) < 3.0


def test_walls_pairs_and_hidden_trunks_are_refused():
    wall = np.full(len(ANGLES), FAR)
    wall[100:200] = 8.0 / np.cos(ANGLES[100:200])
    assert len(trunks(wall, ANGLES).z) == 0
    assert len(trunks(scan((10, 0, 0.4), (10, 2, 0.4)), ANGLES).z) == 0
    both = trunks(scan((10, 0, 0.5), (20, 0.6, 0.8)), ANGLES)
    assert len(both.z) == 1
    assert both.z[0, 0] < 11


def test_a_missing_return_does_not_split_a_trunk():
    ranges = scan((5, 0, 0.5))
    ranges[180] = FAR
    assert len(trunks(ranges, ANGLES).z) == 1


def test_poles_are_thin():
    ranges = scan((6, 1, 0.1), (6, -4, 0.6))
    found = poles(ranges, ANGLES)
    assert len(found.z) == 1
    assert found.z[0, 1] > 0


def test_reflectors_are_bright():
    ranges = scan((6, 1, 0.2), (6, -4, 0.2))
    bright = np.where((ranges < FAR) & (ANGLES > 0), 7.0, 0.0)
    found = reflectors(ranges, bright, ANGLES, radius=0.1)
    assert len(found.z) == 1
    np.testing.assert_allclose(found.z[0], [math.hypot(6, 1), math.atan2(1, 6)], atol=0.05)


@pytest.mark.parametrize("finder", [trunks, poles, lambda r, a: reflectors(r, np.ones(len(r)), a)])
def test_empty_scans_give_nothing_and_wrong_shapes_are_named(finder):
    assert finder(np.full(len(ANGLES), np.inf), ANGLES).z.shape == (0, 2)
    assert finder(np.empty(0), np.empty(0)).z.shape == (0, 2)
    assert len(finder(scan((5, 0, 0.2)), ANGLES).observations()) == 1
    with pytest.raises(TomThumbError, match=r"\(B,\)"):
        finder(np.ones(5), ANGLES)
    with pytest.raises(TomThumbError, match="increase"):
        finder(np.ones(361), ANGLES[::-1])


def test_clusters_keep_every_valid_beam_once():
    rng = np.random.default_rng(0)
    ranges = rng.uniform(1, 40, 361)
    valid = rng.random(361) < 0.7
    groups = cluster(ranges, ANGLES, valid, 1.0)
    np.testing.assert_array_equal(np.concatenate(groups), np.flatnonzero(valid))
