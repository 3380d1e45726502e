"""`tomthumb.associate` on plain arrays: shapes, what is refused and in which words, agreement with the parts."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import tomthumb
from associators.brute import random_problem
from tomthumb import registry
from tomthumb.errors import TomThumbError, UnknownName

METHODS = [name for name in registry.names("associator") if name != "oracle"]
Z_HAT = np.array([[5.0, 0.0], [5.0, 0.5], [8.0, -0.5]])
Z = Z_HAT[[2, 0]] + [[0.05, 0.005], [-0.05, -0.005]]
R = np.diag([0.1, 0.02]) ** 2
COV = 0.05**2 * np.eye(6)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_names_an_easy_scan(method):
    found = tomthumb.associate(Z, Z_HAT, COV, R, method=method)
    assert found.match.tolist() == [2, 0]
    assert np.issubdtype(found.match.dtype, np.integer)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("m", "n"), [(0, 3), (2, 0), (0, 0)])
def test_empty_scans_and_empty_maps(method, m, n):
    found = tomthumb.associate(Z[:m], Z_HAT[:n], COV[: 2 * n, : 2 * n], R, method=method)
    assert found.match.shape == (m,)
    assert (found.match == -1).all()


def test_empty_lists_will_do():
    assert tomthumb.associate([], [], np.empty((0, 0)), R).match.shape == (0,)


@pytest.mark.parametrize("method", METHODS)
def test_noise_may_be_shared_or_its_own_for_each(method):
    shared = tomthumb.associate(Z, Z_HAT, COV, R, method=method)
    each = tomthumb.associate(Z, Z_HAT, COV, np.stack([R, R]), method=method)
    assert np.array_equal(shared.match, each.match)


def test_own_noise_counts():
    """One component off by .3: within the gate of the noisy observation only."""
    z = Z_HAT[[0, 2]] + [0.3, 0.0]
    each = np.stack([np.diag([0.5, 0.02]) ** 2, np.diag([0.02, 0.02]) ** 2])
    assert tomthumb.associate(z, Z_HAT, COV, each, method="jcbb").match.tolist() == [0, -1]


@pytest.mark.parametrize("method", METHODS)
def test_angles_wrap(method):
    z_hat = np.array([[5.0, np.pi - 0.01], [5.0, 0.0], [9.0, 1.5]])
    z = np.array([[5.0, -np.pi + 0.01], [5.0, 0.01], [9.0, 1.49]])
    assert tomthumb.associate(z, z_hat, COV, R, method=method).match.tolist() == [0, 1, 2]
    flat = tomthumb.associate(z, z_hat, COV, R, method=method, angles=())
    assert flat.match.tolist() == [-1, 1, 2]


@pytest.mark.parametrize("method", METHODS)
def test_labels_exclude(method):
    labels = (np.array([1, -1]), np.array([1, 1, 2]))
    assert tomthumb.associate(Z, Z_HAT, COV, R, method=method, labels=labels).match.tolist() == [-1, 0]


@pytest.mark.parametrize("method", METHODS)
def test_all_that_may_be_given_is_taken(method):
    given = random_problem(np.random.default_rng(1), 4, 5, angles=(1,))
    p = given.predictions
    found = tomthumb.associate(
        given.z, p.z_hat, p.cov, given.R, method=method, pose_cov=p.pose_cov, cross=p.cross, points=p.points,
        detect=np.full(5, 0.9), clutter=given.clutter, rng=np.random.default_rng(2), check=True,
    )  # fmt: skip
    assert found.match.shape == (4,)
    assert ((found.match >= -1) & (found.match < 5)).all()


def test_it_gives_what_the_associator_gives():
    given = random_problem(np.random.default_rng(3), 5, 5)
    for method in ("nn", "gnn", "jcbb"):
        direct = registry.build("associator", method, {"gate": 0.999}).associate(given, np.random.default_rng(0))[0]
        plain = tomthumb.associate(
            given.z, given.predictions.z_hat, given.predictions.cov, given.R, method=method, angles=(), gate=0.999
        )
        assert np.array_equal(plain.match, direct.match)


BAD = {
    "z of the wrong width": ({"z": np.zeros((2, 3))}, r"z has shape \(2, 3\); it must be \(any, 2\)"),
    "z a flat list": ({"z": np.zeros(4)}, r"z has shape \(4,\)"),
    "z no numbers": ({"z": [["a", "b"]]}, "z is not an array of numbers"),
    "NaN in z": ({"z": [[np.nan, 0.0], [1.0, 1.0]]}, "z.*is not finite"),
    "infinite z_hat": ({"z_hat": [[5, 0], [5, np.inf], [8, 0]]}, "z_hat.*is not finite"),
    "z_hat of the wrong width": ({"z_hat": np.zeros((3, 1))}, r"z_hat has shape \(3, 1\)"),
    "cov too small": ({"cov": np.eye(4)}, r"cov has shape \(4, 4\); it must be \(6, 6\)"),
    "cov not positive": ({"cov": -np.eye(6)}, "diagonal block of cov 0 is not positive semi-definite"),
    "R too many": ({"R": np.tile(R, (3, 1, 1))}, r"R has shape \(3, 2, 2\); it must be \(2, 2, 2\)"),
    "R not positive": ({"R": np.diag([1.0, 0.0])}, "R 0 is not positive definite"),
    "R not symmetric": ({"R": np.array([[1.0, 0.5], [0.0, 1.0]])}, "R 0 is not positive definite and symmetric"),
    "pose_cov of the wrong shape": ({"pose_cov": np.eye(2)}, r"pose_cov has shape \(2, 2\)"),
    "pose_cov not positive": ({"pose_cov": -np.eye(3)}, "pose_cov is not positive semi-definite"),
    "cross of the wrong shape": ({"cross": np.zeros((3, 3))}, r"cross has shape \(3, 3\); it must be \(6, 3\)"),
    "points of the wrong shape": ({"points": np.zeros((2, 2))}, r"points has shape \(2, 2\); it must be \(3, 2\)"),
    "detect above one": ({"detect": [0.5, 1.5, 0.5]}, r"detect\[1\] is above 1"),
    "detect too short": ({"detect": [0.5, 0.5]}, r"detect has shape \(2,\); it must be \(3\)"),
    "clutter negative": ({"clutter": -1.0}, r"clutter\[0\] is negative"),
    "angles beyond": ({"angles": (2,)}, r"angles \(2,\) must name components"),
    "labels too short": ({"labels": ([1], [1, 1, 1])}, r"labels have shapes \(1,\) and \(3,\)"),
    "the oracle": ({"method": "oracle"}, "needs the truth"),
    "a word for a gate": ({"method": "nn", "gate": "wide"}, "gate must be a number"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_told_in_one_line(case):
    changed, words = BAD[case]
    given = {"z": Z, "z_hat": Z_HAT, "cov": COV, "R": R, **changed}
    with pytest.raises(TomThumbError, match=words) as told:
        tomthumb.associate(**given)
    assert "\n" not in str(told.value)


def test_unknown_methods_and_keywords_say_what_is_valid():
    with pytest.raises(UnknownName, match="jcbb"):
        tomthumb.associate(Z, Z_HAT, COV, R, method="jcb")
    with pytest.raises(UnknownName, match="gate"):
        tomthumb.associate(Z, Z_HAT, COV, R, method="jcbb", gat=0.9)


def test_the_whole_covariance_is_checked_on_demand():
    cov = COV.copy()
    cov[0, 2] = cov[2, 0] = 1.0  # blocks fine, the whole is not positive
    assert tomthumb.associate(Z, Z_HAT, cov, R, method="nn").match.tolist() == [2, 0]
    with pytest.raises(TomThumbError, match="least eigenvalue"):
        tomthumb.associate(Z, Z_HAT, cov, R, method="nn", check=True)


def test_what_may_be_said_of_a_scan_is_the_same_with_and_without_an_answer():
    """Both signatures are written out, for whoever reads them; they may not drift apart."""
    asked, answered = (inspect.signature(f).parameters for f in (tomthumb.problem, tomthumb.associate))
    assert {name: str(p) for name, p in asked.items()}.items() <= {name: str(p) for name, p in answered.items()}.items()
