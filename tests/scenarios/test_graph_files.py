import numpy as np
import pytest

from tomthumb.errors import BrokenFile
from tomthumb.scenarios import load

G2O = """VERTEX_SE2 0 1 2 0.5
VERTEX_XY 7 3 3
FIX 0
EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 0 5 9 9 9 1 0 0 1 0 1
EDGE_SE2_XY 0 7 2 1 4 0 25
EDGE_SE2_XY 1 7 1 1 4 1 25
"""
ISAM = "ODOMETRY 0 1 1 0 0.1 10 0 0 10 0 20\nLANDMARK 1 3 1 2 2 1 4\n"
TORO = "VERTEX2 0 0 0 0\nEDGE2 0 1 1 0 0.1 100 0 100 400 0 0\n"


def write(folder, name, text):
    (folder / name).write_text(text)
    return str(folder / name)


def test_g2o(tmp_path):
    scenario = load(write(tmp_path, "a.g2o", G2O))
    np.testing.assert_array_equal(scenario.prior.pose, [1, 2, 0.5])
    assert scenario.info["loops"] == 1
    first, second = scenario.steps[0], scenario.steps[1]
    np.testing.assert_allclose(first.observations.R[0], np.diag([1 / 4, 1 / 25]))
    np.testing.assert_allclose(second.observations.R[0], np.linalg.inv([[4, 1], [1, 25]]))
    np.testing.assert_allclose(second.control.cov, np.diag([0.01, 0.01, 0.0025]))
    assert first.truth.ids == second.truth.ids == [0]


def test_isam_gives_square_roots(tmp_path):
    step = load("graph:" + write(tmp_path, "a.txt", ISAM)).steps[1]
    np.testing.assert_allclose(step.control.cov, np.diag([0.01, 0.01, 0.0025]))
    root = np.array([[2, 1], [0, 4]])
    np.testing.assert_allclose(step.observations.R[0], np.linalg.inv(root.T @ root))


def test_toro_has_its_own_order(tmp_path):
    step = load(write(tmp_path, "a.toro", TORO)).steps[1]
    np.testing.assert_allclose(step.control.cov, np.diag([0.01, 0.01, 0.0025]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("EDGE_SE3 1 2 3\n", "1: unknown tag"),
        ("\nEDGE_SE2 0 1 1 0\n", "2: EDGE_SE2 has 4 values"),
        ("EDGE_SE2 0 1 1 0 0 0 0 0 0 0 0\n", "1: the information of EDGE_SE2 is not positive"),
        ("EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1\n", "1: a vertex number is not whole"),
        ("EDGE_SE2 0 1 x 0 0 1 0 0 1 0 1\n", "1: could not convert"),
        ("FIX 0\n", "holds no edges"),
    ],
)
def test_mistakes_are_named(tmp_path, text, words):
    with pytest.raises(BrokenFile, match=words):
        load(write(tmp_path, "a.g2o", text))
