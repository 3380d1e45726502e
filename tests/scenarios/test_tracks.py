import math

import numpy as np
import pytest

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.scenarios import load
from tomthumb.scenarios.tracks import read_track

pytest.importorskip("yaml", reason="needs the extra: cones")

TURN = np.linspace(0, 2 * math.pi, 24, endpoint=False)
LEFT = np.column_stack([10 * np.cos(TURN), 10 * np.sin(TURN)]) - [11.5, 0]  # driven counter-clockwise
RIGHT = np.column_stack([13 * np.cos(TURN), 13 * np.sin(TURN)]) - [11.5, 0]


def fssim():
    lines = [f"cones_{side}:" for side in ("left", "right")]
    out = []
    for head, border in zip(lines, (LEFT, RIGHT), strict=True):
        out += [head, *(f"- [{x}, {y}]" for x, y in border)]
    return "\n".join([*out, "cones_orange: []", "cones_orange_big: [[0.5, 1.0]]", "starting_pose_cg: [0, 0, 1.57]"])


def pacsim():
    out = ["version: 1.0", "track:", "  lanesFirstWithLastConnected: true", "  start:", "    position: [0, 0, 0]"]
    out += ["    orientation: [0, 0, 1.57]"]
    for side, colour, border in (("left", "blue", LEFT), ("right", "yellow", RIGHT)):
        out.append(f"  {side}:")
        for x, y in border:
            out += [f"  - position: [{x}, {y}, 0.0]", f"    class: {colour}"]
    return "\n".join([*out, "  unknown:", "  - position: [0.5, 1.0, 0]", "    class: big-orange"])


def eufs():
    rows = [f"{tag},{x},{y},0,0,0,0" for tag, b in (("blue", LEFT), ("yellow", RIGHT)) for x, y in b]
    head = "tag,x,y,direction,x_variance,y_variance,xy_covariance"
    return "\n".join([head, *rows, "big_orange,0.5,1.0,0,0,0,0", "car_start,0,0,1.57,0,0,0"])


def sdf():
    item = "<include><uri>model://a/cone_{}</uri><pose>{} {} 0 0 0 0</pose><name>cone_{}</name></include>"
    cones = [item.format(c, x, y, s) for c, s, b in (("blue", "left", LEFT), ("yellow", "right", RIGHT)) for x, y in b]
    extra = item.format("orange_big", 0.5, 1.0, "orange_big")
    return f'<sdf version="1.4"><model name="a">{"".join(cones)}{extra}</model></sdf>'


FILES = {"fssim.yaml": fssim, "pacsim.yaml": pacsim, "eufs.csv": eufs, "model.sdf": sdf}


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_world(tmp_path, name):
    (tmp_path / name).write_text(FILES[name]())
    found = read_track(tmp_path / name)
    np.testing.assert_allclose(found.cones, np.vstack([LEFT, RIGHT, [[0.5, 1.0]]]), atol=1e-9)
    np.testing.assert_array_equal(np.bincount(found.labels), [24, 24, 0, 1])
    assert found.closed


@pytest.mark.parametrize("name", FILES)
def test_the_car_drives_round_between_the_cones(tmp_path, name):
    (tmp_path / name).write_text(FILES[name]())
    scenario = load(f"track:{tmp_path / name}", 2, laps=2, teach=1, clutter=1.0)
    radius = np.array([math.hypot(s.truth.pose[0] + 11.5, s.truth.pose[1]) for s in scenario.steps])
    assert radius.min() > 10.5
    assert radius.max() < 12.5
    ids = scenario.true_ids()
    assert len(np.unique(ids[ids >= 0])) == 49
    for step in scenario.steps[:50]:
        real = step.truth.ids >= 0
        np.testing.assert_array_equal(
            step.observations.labels[real], read_track(tmp_path / name).labels[step.truth.ids[real]]
        )
        assert (step.observations.labels[~real] == -1).all()


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.yaml", "a: [1", "not YAML"),
        ("a.yaml", "a: &x [1]\nb: *x", "anchors"),
        ("a.yaml", "a: 1", "neither a PacSim"),
        ("a.yaml", "cones_left: [[1, x]]", "not a position"),
        ("a.yaml", "cones_left: [[1, 2]]\ncones_right: [[2, 2]]", "fewer than two cones"),
        ("a.sdf", "<!DOCTYPE a [<!ENTITY b 'c'>]><sdf/>", "not allowed"),
        ("a.sdf", "<sdf>", "not XML"),
        ("a.csv", "tag,x,y\nblue,1,x\n", "csv:2: could not convert"),
        ("a.csv", "tag,x,y\ntree,1,2\n", "csv:2: unknown tag"),
    ],
)
def test_mistakes_are_named(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(BrokenFile, match=words):
        load(f"track:{tmp_path / name}")


def test_an_open_track_has_one_lap(tmp_path):
    (tmp_path / "a.yaml").write_text(pacsim().replace("Connected: true", "Connected: false"))
    with pytest.raises(TomThumbError, match="one lap"):
        load(f"track:{tmp_path}/a.yaml?laps=2")


def test_some_colours_are_read_wrongly_and_nothing_else_changes(tmp_path):
    file = tmp_path / "track.yaml"
    file.write_text(pacsim())
    plain, confused = (load(f"track:{file}", seed=2, laps=2, confusion=c) for c in (0.0, 0.4))
    wrong, count = 0, 0
    for a, b in zip(plain.steps, confused.steps, strict=True):
        np.testing.assert_array_equal(a.observations.z, b.observations.z)
        wrong += int((a.observations.labels != b.observations.labels).sum())
        count += len(a.truth.ids)
    assert wrong / count == pytest.approx(0.4 * 3 / 4, abs=0.05)  # a colour drawn at random is right one time in four
    with pytest.raises(TomThumbError, match="confusion=2"):
        load(f"track:{file}", confusion=2.0)
