import math

import numpy as np
import pytest

from tomthumb.errors import TomThumbError
from tomthumb.geometry import between, to_frame
from tomthumb.scenarios import load
from tomthumb.scenarios.simulate import Eye, hidden


@pytest.mark.parametrize("name", ["square", "random"])
def test_observations_fit_their_covariances(name):
    scenario = load(name, 1, clutter=2.0, **({"steps": 2000} if name == "random" else {"laps": 5}))
    d2 = []
    for step in scenario.steps:
        real = step.truth.ids >= 0
        q = to_frame(step.truth.pose, scenario.landmarks[step.truth.ids[real]])
        nu = step.observations.z[real] - np.column_stack([np.hypot(*q.T), np.arctan2(q[:, 1], q[:, 0])])
        nu[:, 1] = (nu[:, 1] + math.pi) % (2 * math.pi) - math.pi
        d2.append(np.einsum("mi,mij,mj->m", nu, np.linalg.inv(step.observations.R[real]), nu))
    d2 = np.concatenate(d2)
    assert d2.mean() == pytest.approx(2.0, abs=5 * 2 / math.sqrt(len(d2)))


@pytest.mark.parametrize("name", ["square", "random"])
def test_odometry_fits_its_covariance(name):
    scenario = load(name, 2, odometry_noise=3.0)
    d2 = []
    for before, step in zip(scenario.steps, scenario.steps[1:], strict=False):
        error = step.control.u - between(before.truth.pose, step.truth.pose)
        d2.append(error @ np.linalg.solve(step.control.cov, error))
    assert np.mean(d2) == pytest.approx(3.0, abs=5 * math.sqrt(6 / len(d2)))


def test_square_closes_and_stays_in_its_corridor():
    scenario = load("square", size=12.0, laps=2)
    poses = np.array([s.truth.pose for s in scenario.steps])
    assert poses[:, :2].min() > -1e-9
    assert poses[:, :2].max() < 12.0 + 1e-9
    half = len(poses) // 2
    np.testing.assert_allclose(poses[half, :2], [0, 0], atol=1e-9)


def test_random_stays_in_its_field_and_keeps_the_gap():
    from scipy.spatial import cKDTree

    scenario = load("random", 5, density=0.2, min_gap=0.8, steps=3000)
    assert np.abs([s.truth.pose[:2] for s in scenario.steps]).max() < 30.0
    assert cKDTree(scenario.landmarks).query(scenario.landmarks, 2)[0][:, 1].min() > 0.8


def test_a_field_without_landmarks_is_allowed():
    assert len(load("random", landmarks=0, steps=3).true_ids()) == 0


@pytest.mark.parametrize("query", ["size=-1", "steps=0", "step=0", "density=1e9", "fov=7", "range_std=0", "detect=0"])
def test_values_out_of_range_are_named(query):
    with pytest.raises(TomThumbError, match="random: "):
        load(f"random?{query}")


def test_a_post_hides_only_what_is_behind_it():
    z = np.array([[1.0, 0.0], [2.0, 0.01], [2.0, 0.1], [0.5, 3.0], [3.0, -3.2]])
    np.testing.assert_array_equal(hidden(z), [False, True, False, False, True])
    assert Eye(2.0, math.pi).area == pytest.approx(2 * math.pi)
