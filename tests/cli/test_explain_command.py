"""tomthumb explain, and the same from Python."""

from __future__ import annotations

import numpy as np
import pytest

import tomthumb
from tomthumb.errors import TomThumbError
from tomthumb.witness import case_at


def test_a_whole_scan_as_json_says_what_the_run_did(tomthumb):
    said = tomthumb("explain", "cloister", "-a", "jcbb", "--step", 40, "--json", "--set", "people=5").json
    assert said["step"] == 40
    assert said["t_s"] == 40.0
    rows = said["observations"]
    assert [row["observation"] for row in rows] == list(range(len(rows)))
    paired = [row for row in rows if row["landmark"] >= 0]
    assert len(paired) >= 4
    for row in paired:
        assert row["true_id"] == row["true_id_of_landmark"] >= 0
        assert row["gain_nats"] - row["runner_up_gain_nats"] == pytest.approx(row["lead_nats"])
        assert 0 < row["gate"] < 1
    for row in rows:
        if row["landmark"] < 0:
            assert row["d2"] is None  # never NaN in JSON
            assert row["true_id_of_landmark"] is None


def test_one_observation_in_a_sentence(tomthumb):
    text = tomthumb("explain", "cloister", "--step", 20, "--observation", 1).out
    assert text.startswith("observation 1 is landmark ")
    assert "% sure" in text
    assert "next comes" in text
    assert text.endswith("[right]\n")
    assert text.count("\n") == 1


def test_looks_are_told_of(tomthumb):
    sets = ("--set", "diameter_std=0.02", "--set", "slam.signature=ratio")
    rows = tomthumb("explain", "cloister", "--step", 30, "--json", *sets).json["observations"]
    assert any(row["evidence_nats"] > 1.0 for row in rows)
    assert "for its looks" in tomthumb("explain", "cloister", "--step", 30, *sets).out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cloister", "--step", 500], "step 500 does not exist; the run has 168"),
        (["cloister", "--step", 3, "--observation", 99], "observation 99 does not exist in step 3; valid: 0 to"),
        (["cloistre", "--step", 3], "did you mean 'cloister'"),
    ],
)
def test_what_is_not_there_is_one_line(tomthumb, arguments, message):
    said = tomthumb("explain", *arguments)
    assert said.code == 2
    assert said.err.count("\n") == 1
    assert message in said.err


def test_taught_steps_are_the_teachers():
    world = tomthumb.load("cloister", laps=2, teach=1)
    case = case_at(world, 10, associator="nn")
    truth = world.true_ids()
    rows = np.flatnonzero(case.answer.match >= 0)
    founders = case.problem.predictions.ids[case.answer.match[rows]]
    assert len(rows)
    assert (truth[case.record.serials[rows]] == truth[founders]).all()


@pytest.mark.parametrize("step", [58, 59, 60])
def test_of_several_branches_the_answer_that_was_followed_is_told(step):
    """In step 59 the branch that was best before the scan is not the best after it."""
    world = tomthumb.load("cloister", seed=1, odometry_noise=8.0)
    brothers = {"slam": {"width": 8}, "associator": {"brothers": 8}}
    case = case_at(world, step, seed=1, settings=brothers)
    rows = np.flatnonzero(case.answer.match >= 0)
    assert len(rows) > 1
    assert case.problem.predictions.ids[case.answer.match[rows]].tolist() == case.record.ids[rows].tolist()


def test_from_plain_arrays():
    rng = np.random.default_rng(0)
    z_hat = np.array([[4.0, -0.5], [4.0, 0.0], [4.0, 0.5]])
    z = z_hat[[1, 2]] + 0.01 * rng.standard_normal((2, 2))
    arrays = z, z_hat, 1e-4 * np.eye(6), np.diag([0.05, 0.02]) ** 2
    asked = tomthumb.problem(*arrays)
    found = tomthumb.associate(*arrays, method="map")
    told = tomthumb.explain(asked, found, 0)
    assert isinstance(told, tomthumb.Explanation)
    assert told.landmark == found.match[0] == 1
    assert told.lead > 5
    against = tomthumb.associate(*arrays, method="map", evidence=np.full((2, 3), -50.0))
    assert against.match.tolist() == [-1, -1]
    with pytest.raises(TomThumbError, match=r"evidence has shape \(3, 2\); it must be \(2, 3\)"):
        tomthumb.problem(*arrays, evidence=np.zeros((3, 2)))
