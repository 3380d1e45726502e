"""Our own layouts: what goes out comes back, and every mistake in a file is named with its line."""

import gzip
import math
from dataclasses import replace

import numpy as np
import pytest

from tomthumb.errors import BrokenFile
from tomthumb.models.motion import Ackermann, Velocity
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios import load
from tomthumb.scenarios import streaming as streaming_module
from tomthumb.scenarios.csv_layout import load_csv
from tomthumb.scenarios.csv_save import save_csv
from tomthumb.scenarios.jsonl import load_jsonl, save_jsonl
from tomthumb.scenarios.streaming import StreamedSteps
from tomthumb.types import Control, Observations, Prior, Scenario, Step, Truth


def handmade():
    """All that the types allow: no control, no scan, an empty scan, labels, signatures, unknown poses and landmarks."""
    rng = np.random.default_rng(0)
    R = np.tile(np.diag([0.01, 0.001]), (3, 1, 1)) + np.array([[0, 1e-3], [1e-3, 0]])
    full = Observations(rng.random((3, 2)), R, np.array([2, -1, 0]), np.array([0.5, math.nan, 1.5]))
    empty = Observations(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, np.int64), np.empty(0))
    steps = [
        Step(0.0, None, full, Truth(np.array([0.1, 0.2, 0.3]), np.array([4, -1, -2]))),
        Step(0.5, Control(np.array([1.0, 0.1]), 0.5, np.diag([0.1, 0.2])), None, Truth(np.zeros(3), None)),
        Step(0.7, Control(np.array([1.0, -0.1]), 0.2), empty, Truth(np.ones(3), np.empty(0, np.int64))),
    ]
    landmarks = np.array([[1.0, 2.0], [math.nan, math.nan], [3.0, 1 / 3]])
    sensor = RangeBearing(max_range=9.0, fov=2.0, mount=(0.2, 0.0, 0.1), std=(0.1, 0.02), detect=0.7, clutter=0.02)
    prior = Prior(np.array([1.0, 2.0, 3.0]), np.diag([0.1, 0.2, 0.3]))
    return Scenario("hand made", Velocity(std=(0.1, 0.2)), sensor, prior, steps, landmarks, 2, 1)


SCENARIOS = [
    handmade(),
    load("cloister", laps=1, people=3, clutter=2.0, jitter=0.1),
    load("random", steps=40),
    replace(handmade(), motion=Ackermann(ahead=3.78, left=0.5, std=(0.7, 0.1), pose_std=(0.1, 0.1, 0.01))),
]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=["hand made", "cloister", "random", "ackermann"])
def test_jsonl_gives_back_what_went_in(scenario, tmp_path, same):
    save_jsonl(scenario, tmp_path / "log.jsonl")
    same(scenario, load(str(tmp_path / "log.jsonl")))


@pytest.mark.parametrize("scenario", SCENARIOS, ids=["hand made", "cloister", "random", "ackermann"])
def test_csv_gives_back_what_went_in(scenario, tmp_path):
    save_csv(scenario, tmp_path)
    back = load(str(tmp_path))
    assert (back.name, back.motion, back.sensor) == (scenario.name, scenario.motion, scenario.sensor)
    np.testing.assert_array_equal(back.landmarks, scenario.landmarks)
    assert len(back.steps) == len(scenario.steps)
    for a, b in zip(scenario.steps, back.steps, strict=True):
        assert a.t == b.t
        assert (a.control is None) == (b.control is None)
        if a.control is not None:
            np.testing.assert_array_equal(a.control.u, b.control.u)
            assert b.control.dt == pytest.approx(a.control.dt, abs=1e-12)
        if a.truth.pose is not None:
            np.testing.assert_array_equal(a.truth.pose, b.truth.pose)
        if a.observations is not None:
            np.testing.assert_array_equal(a.observations.z, b.observations.z)
            np.testing.assert_array_equal(a.observations.R, b.observations.R)
            np.testing.assert_array_equal(a.truth.ids, b.truth.ids)
    np.testing.assert_array_equal(scenario.true_ids(), back.true_ids())


def test_long_logs_are_streamed_and_equal(tmp_path, same, monkeypatch):
    scenario = load("random", steps=30)
    save_jsonl(scenario, tmp_path / "log.jsonl")
    kept = load_jsonl(tmp_path / "log.jsonl")
    monkeypatch.setattr(streaming_module, "KEEP_BELOW", 0)
    streamed = load_jsonl(tmp_path / "log.jsonl")
    assert isinstance(streamed.steps, StreamedSteps)
    same(kept, streamed)
    assert streamed.steps[-1].t == streamed.steps[len(kept.steps) - 1].t == kept.steps[-1].t
    assert [s.t for s in streamed.steps[3:9:2]] == [s.t for s in kept.steps[3:9:2]]
    with pytest.raises(IndexError):
        streamed.steps[1000]


def test_compressed_files_are_read_as_they_are(tmp_path, same):
    scenario = load("random", steps=10)
    save_jsonl(scenario, tmp_path / "log.jsonl")
    (tmp_path / "log.jsonl.gz").write_bytes(gzip.compress((tmp_path / "log.jsonl").read_bytes()))
    same(scenario, load(str(tmp_path / "log.jsonl.gz")))


def write(folder, **files):
    for name, text in files.items():
        name = name.replace("_", ".")
        (folder / name).write_text(text)
    return folder


MINIMAL = {
    "odometry_csv": "t_s,dx_m,dy_m,dheading_rad\n0,0,0,0\n1,0.5,0,0.1\n",
    "observations_csv": "t_s,range_m,bearing_rad\n0,1,0.5\n1,2,0.25\n1,3,-0.25\n",
}


def test_the_smallest_log_needs_two_files(tmp_path):
    scenario = load_csv(write(tmp_path, **MINIMAL))
    assert [len(step.observations) for step in scenario.steps] == [1, 2]
    np.testing.assert_array_equal(scenario.steps[1].control.u, [0.5, 0, 0.1])
    np.testing.assert_allclose(scenario.steps[1].observations.R[0], np.diag([0.01, 0.0004]))


def test_a_scan_between_two_velocities_gets_its_share(tmp_path):
    files = {
        "scenario_toml": '[motion]\nmodel = "velocity"\n[sensor]\nstd_deg = [1, 1]\nfov_deg = 90\n',
        "odometry_csv": "t_s,speed_m_s,turn_rad_s\n0,9,9\n1,1,0\n2,2,0\n",
        "observations_csv": "t_s,range_m,bearing_rad\n0.25,1,0.5\n2,2,0.25\n2.5,1,0\n",
    }
    until = load_csv(write(tmp_path, **files)).steps
    assert [s.t for s in until] == [0, 0.25, 1, 2, 2.5]
    assert [None if s.control is None else (s.control.u[0], s.control.dt) for s in until] == [
        None,
        (1, 0.25),
        (1, 0.75),
        (2, 1.0),
        None,
    ]
    held = load_csv(
        write(tmp_path, **{**files, "scenario_toml": files["scenario_toml"] + '[odometry]\nholds="from"\n'})
    )
    assert [None if s.control is None else (s.control.u[0], s.control.dt) for s in held.steps] == [
        None,
        (9, 0.25),
        (9, 0.75),
        (1, 1.0),
        (2, 0.5),
    ]


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("odometry_csv", "t_s,dx_m,dy_m\n", "dheading_rad is missing"),
        ("odometry_csv", "t_s,dx_m,dy_m,dheading_rad\n1,2,3\n", "odometry.csv:2: 3 columns where 4"),
        ("odometry_csv", "t_s,dx_m,dy_m,dheading_rad\n1,2,3,x\n", "odometry.csv:2: could not convert"),
        ("odometry_csv", "t_s,dx_m,dy_m,dheading_rad\n1,2,3,inf\n", "odometry.csv:2: .*finite"),
        ("odometry_csv", "t_s,dx_m,dy_m,dheading_rad\n1,2,3,\n", "odometry.csv:2: dheading_rad is empty"),
        ("odometry_csv", "t_s,dx_m,dy_m,dheading_rad\n1,0,0,0\n0.5,0,0,0\n", "odometry.csv:3: time runs back"),
        ("odometry_csv", "t_s,dx_m,dx_m,dy_m,dheading_rad\n", "a column stands twice"),
        ("odometry_csv", "t_s,dx_m,dy_m,dheading\n", "did you mean 'dheading_rad'"),
        ("observations_csv", "t_s,range_m,bearing_rad,cov_11,cov_12,cov_22\n0,1,1,1,2,1\n", ":2: .*not a covariance"),
        ("observations_csv", "t_s,range_m,bearing_rad,cov_11,cov_12,cov_22\n0,1,1,1,,1\n", ":2: .*not complete"),
        ("observations_csv", "t_s,range_m,bearing_rad,id\n0,1,1,0.5\n", "whole number"),
        ("landmarks_csv", "id,x_m,y_m\n-3,1,1\n", "whole number from 0"),
        ("truth_csv", "t_s,x_m,y_m,heading_rad\n1,0,0,0\n0,0,0,0\n", "time runs back"),
        ("scenario_toml", "[motion\n", "not TOML"),
        ("scenario_toml", '[motion]\nmodel = "flying"\n', "one of increment"),
        ("scenario_toml", "[sensor]\nfow = 3\n", "did you mean 'fov'"),
        ("scenario_toml", "[sensor]\ndetect = 2.0\n", "detect must be"),
        ("scenario_toml", "[prior]\ncov = [[1,0,0],[0,-1,0],[0,0,1]]\n", "not a covariance"),
        ("scenario_toml", '[odometry]\nholds = "maybe"\n', "until"),
        ("scenario_toml", "[wheels]\n", "unknown key 'wheels'"),
    ],
)
def test_mistakes_in_csv_are_named(tmp_path, file, text, words):
    with pytest.raises(BrokenFile, match=words):
        load_csv(write(tmp_path, **{**MINIMAL, file: text}))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("[]", "object"),
        ('{"t": "x"}', "t: a number"),
        ('{"t": NaN}', "finite"),
        ('{"t": 1, "control": {"u": [1, 2], "dt": 1}}', "shape"),
        ('{"t": 1, "control": {"u": [1, 2, 3], "dt": -1}}', "negative"),
        ('{"t": 1, "observations": {"z": [[1, 2]], "R": []}}', "observations: R"),
        ('{"t": 1, "observations": {"z": [[1, 2]], "R": [[[1, 2], [2, 1]]]}}', "not a covariance"),
        ('{"t": 1, "truth": {"ids": [1]}}', "0 whole numbers"),
        ('{"t": 1, "speed": 3}', "unknown key 'speed'"),
        ("{" * 100_000, "not JSON"),
    ],
)
def test_mistakes_in_jsonl_are_named(tmp_path, line, words):
    (tmp_path / "a.jsonl").write_text('{"format": 1}\n{"t": 0}\n' + line + "\n")
    with pytest.raises(BrokenFile, match=r"a\.jsonl:3: ") as caught:
        load_jsonl(tmp_path / "a.jsonl")
    assert words in str(caught.value)


def test_an_endless_number_in_toml_is_named(tmp_path):
    with pytest.raises(BrokenFile, match="not TOML"):
        load_csv(write(tmp_path, **{**MINIMAL, "scenario_toml": "format = " + "9" * 5000}))
