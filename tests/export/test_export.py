import csv
import json
import shutil
import subprocess

import numpy as np
import pytest

import tomthumb
from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.export import export
from tomthumb.export.text import matrices
from tomthumb.scenarios import load


@pytest.fixture(scope="module")
def run():
    scenario = load("random", steps=40, landmarks=60, size=30.0)
    return scenario, tomthumb.run(scenario, associator="oracle")


def test_tum_and_kitti_say_the_same(run, tmp_path):
    _, trace = run
    export(trace, tmp_path / "a.tum")
    export(trace, tmp_path / "a.kitti")
    tum, kitti = np.loadtxt(tmp_path / "a.tum"), np.loadtxt(tmp_path / "a.kitti").reshape(-1, 3, 4)
    np.testing.assert_allclose(tum[:, 0], trace.t)
    np.testing.assert_allclose(tum[:, 1:3], trace.pose[:, :2], atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(tum[:, 4:], axis=1), 1.0)
    heading = 2 * np.arctan2(tum[:, 6], tum[:, 7])
    np.testing.assert_allclose(kitti[:, 1, 0], np.sin(heading), atol=1e-7)
    np.testing.assert_allclose(kitti, matrices(trace.pose), atol=1e-7)


def test_csv_and_json_hold_the_same_tables(run, tmp_path):
    scenario, trace = run
    export(trace, tmp_path / "out", format="csv", scenario=scenario)
    export(trace, tmp_path / "a.json", scenario=scenario)
    whole = json.loads((tmp_path / "a.json").read_text(), parse_constant=pytest.fail)
    assert whole["scenario"] == "random"
    for name in ("trajectory", "map", "observations"):
        with open(tmp_path / "out" / f"{name}.csv") as file:
            rows = list(csv.DictReader(file))
        assert set(rows[0]) == set(whole[name])
        for column, values in whole[name].items():
            for row, value in zip(rows, values, strict=True):
                assert row[column] == ("" if value is None else str(value))
    assert whole["observations"]["true_id"] == scenario.true_ids().tolist()


def test_g2o_is_read_back_as_a_log_with_the_same_content(run, tmp_path):
    scenario, trace = run
    export(trace, tmp_path / "a.g2o", scenario=scenario)
    back = load(str(tmp_path / "a.g2o"))
    assert len(back.steps) == len(scenario.steps)
    for a, b in zip(scenario.steps, back.steps, strict=True):
        points = scenario.sensor.locate(np.zeros(3), a.observations.z)[0]
        np.testing.assert_allclose(b.observations.z, points, atol=1e-9)
        if a.control is not None:
            np.testing.assert_allclose(b.control.u, a.control.u, atol=1e-9)
            np.testing.assert_allclose(b.control.cov, a.control.cov, atol=1e-8)
    mine, theirs = scenario.true_ids(), back.true_ids()
    assert len(set(zip(mine.tolist(), theirs.tolist(), strict=True))) == len(np.unique(mine)) == len(np.unique(theirs))


def test_g2o_composes_the_odometry_between_scans(data_dir, tmp_path):
    scenario = load(f"{data_dir}/car_park")
    trace = tomthumb.run(scenario, associator="oracle")
    export(trace, tmp_path / "a.g2o", scenario=scenario)
    back = load(str(tmp_path / "a.g2o"))
    scans = sum(step.observations is not None for step in scenario.steps)
    assert len(back.steps) in (scans, scans + 1)
    assert sum(len(s.observations) for s in back.steps) <= 892


def test_parquet(run, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet", reason="needs the extra: parquet")
    _, trace = run
    export(trace, tmp_path / "p", format="parquet")
    table = pq.read_table(tmp_path / "p" / "trajectory.parquet")
    np.testing.assert_array_equal(table["x_m"].to_numpy(), trace.pose[:, 0])
    assert pq.read_table(tmp_path / "p" / "map.parquet").num_rows == len(trace.final.ids)


def test_rrd(run, tmp_path):
    pytest.importorskip("rerun", reason="needs the extra: rerun")
    scenario, trace = run
    export(trace, tmp_path / "a.rrd", scenario=scenario)
    data = (tmp_path / "a.rrd").read_bytes()
    assert data[:3] == b"RRF"
    assert len(data) > 10_000


def test_gif(run, tmp_path):
    from PIL import Image

    scenario, trace = run
    export(trace, tmp_path / "a.gif", scenario=scenario)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == len(trace.t)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
def test_mp4_holds_every_frame_and_shows_the_run(run, tmp_path):
    scenario, trace = run
    export(trace, tmp_path / "a.mp4", scenario=scenario)
    decode = ["ffmpeg", "-v", "error", "-i", str(tmp_path / "a.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(decode, capture_output=True, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, 480, 480, 3).astype(int)
    assert abs(len(frames) - len(trace.t)) <= 1
    blue = (frames[..., 2] - frames[..., 0] > 60).sum((1, 2))
    assert blue[-1] > 2 * blue[1]  # the way gets longer


def test_mp4_without_ffmpeg_is_one_line(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(TomThumbError, match="needs ffmpeg"):
        export(run[1], tmp_path / "a.mp4")


def test_mistakes_are_named(run, tmp_path):
    _, trace = run
    with pytest.raises(UnknownName, match="tum"):
        export(trace, tmp_path / "a.xyz")
    with pytest.raises(UnknownName, match="did you mean 'kitti'"):
        export(trace, tmp_path / "a", format="kiti")
    with pytest.raises(TomThumbError, match="needs the scenario"):
        export(trace, tmp_path / "a.g2o")
    with pytest.raises(TomThumbError, match="cannot be written"):
        export(trace, tmp_path / "no" / "such" / "a.tum")
