"""Bags are written here, with rosbags, and read back through a mapping; no ROS is on the machine."""

import bz2
import contextlib
import math
import re
import sqlite3
import struct
import tracemalloc
from contextlib import closing

import numpy as np
import pytest

import tomthumb
from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.export import export
from tomthumb.geometry import compose
from tomthumb.scenarios import load
from tomthumb.scenarios.bag_files import BoundedPath

exported = pytest.importorskip("tomthumb.export.rosbag", reason="needs the extra: ros", exc_type=ModuleNotFoundError)
lz4_compress = pytest.importorskip("lz4.frame").compress
Builder, nanoseconds = exported.Builder, exported.nanoseconds

MAPPING = """
bag = "{bag}"
name = "from a bag"
[odometry]
topic = "/odom"
use = "{use}"
[observations]
topic = "/landmarks"
{fields}
[truth]
topic = "/truth"
[mount]
base = "base_link"
[sensor]
max_range = 10.0
fov_deg = 180
"""


def zstd_compress(raw):
    try:
        from compression import zstd
    except ModuleNotFoundError:
        from backports import zstd
    return zstd.compress(raw)


def world():
    return load("random", 2, steps=25, landmarks=80, size=30.0)


def cloud(build, t, points, ids):
    fields = [
        build.make("sensor_msgs/msg/PointField", name=n, offset=o, datatype=d, count=1)
        for n, o, d in (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("tag", 12, 5))
    ]
    raw = np.zeros(len(points) + 1, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("tag", "<i4")])
    raw["x"][:-1], raw["y"][:-1], raw["tag"][:-1] = points[:, 0], points[:, 1], ids
    raw["x"][-1] = np.nan
    return build.make(
        "sensor_msgs/msg/PointCloud2",
        header=build.header(t, "laser"),
        height=1,
        width=len(raw),
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=16 * len(raw),
        data=np.frombuffer(raw.tobytes(), np.uint8),
        is_dense=True,
    )


def poses(build, t, points, ids):
    header = build.header(t, "laser")
    return build.make("geometry_msgs/msg/PoseArray", header=header, poses=[build.pose(x, y, 0.0) for x, y in points])


def static(build, x, y, yaw):
    head = build.header(0.0, "plate")
    half = build.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    none = build.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    links = [("base_link", "plate", x, 0.0, none), ("plate", "laser", 0.0, y, half)]
    items = []
    for parent, child, dx, dy, q in links:
        move = build.make("geometry_msgs/msg/Transform", translation=build.vector(dx, dy, 0.3), rotation=q)
        head = build.header(0.0, parent)
        items.append(
            build.make("geometry_msgs/msg/TransformStamped", header=head, child_frame_id=child, transform=move)
        )
    return build.make("tf2_msgs/msg/TFMessage", transforms=items)


def everything(build, scenario, observe):
    if "tf2_msgs/msg/TFMessage" in build.store.types:  # which the store of ROS 1 does not know
        yield "/tf_static", 0.0, static(build, 0.2, 0.1, 0.5)
    pose = np.zeros(3)
    for k, step in enumerate(scenario.steps):
        following = scenario.steps[k + 1].control if k + 1 < len(scenario.steps) else None
        if step.control is not None:
            pose = compose(pose, step.control.u)
        u = np.zeros(3) if following is None else following.u
        yield "/odom", step.t, build.odometry(step.t, pose, np.zeros((3, 3)), u[0], u[2], ("odom", "base_link"))
        z = step.observations.z
        points = np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])
        yield "/landmarks", step.t, observe(build, step.t, points, step.truth.ids)
        yield "/truth", step.t, build.odometry(step.t, step.truth.pose, np.zeros((3, 3)))


def markers(build, t, points, ids):
    return build.markers(t, points, ids, "laser")


def write_ros2(path, scenario, observe, mcap):
    from rosbags.rosbag2 import StoragePlugin, Writer

    build = Builder()
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        _write(writer, build, scenario, observe, lambda m: build.store.serialize_cdr(m, m.__msgtype__))


def write_ros1(path, scenario, observe):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores

    build = Builder(Stores.ROS1_NOETIC)
    with Writer(path) as writer:
        _write(writer, build, scenario, observe, lambda m: build.store.serialize_ros1(m, m.__msgtype__))


def _write(writer, build, scenario, observe, serialize):
    connections = {}
    for topic, t, message in everything(build, scenario, observe):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=build.store)
        writer.write(connections[topic], nanoseconds(t), serialize(message))


def read(tmp_path, bag, use="pose", fields=""):
    (tmp_path / "map.toml").write_text(MAPPING.format(bag=bag, use=use, fields=fields))
    return load(f"rosbag:{tmp_path}/map.toml")


@pytest.mark.parametrize("mcap", [False, True])
@pytest.mark.parametrize("use", ["pose", "twist"])
def test_ros2_round_trip(tmp_path, mcap, use):
    scenario = world()
    write_ros2(tmp_path / "run", scenario, markers, mcap)
    back = read(tmp_path, "run", use, 'id = "id"')
    check(scenario, back, use)
    np.testing.assert_array_equal(scenario.true_ids(), back.true_ids())


def check(scenario, back, use):
    assert back.name == "from a bag"
    assert len(back.steps) == len(scenario.steps)
    np.testing.assert_allclose(back.sensor.mount, [0.2, 0.1, 0.5], atol=1e-12)
    assert back.sensor.fov == pytest.approx(math.pi)
    for a, b in zip(scenario.steps, back.steps, strict=True):
        assert b.t == pytest.approx(a.t, abs=1e-9)
        points = scenario.sensor.locate(np.zeros(3), a.observations.z)[0]
        np.testing.assert_allclose(b.observations.z, points, atol=1e-5)
        np.testing.assert_allclose(b.truth.pose, a.truth.pose, atol=1e-9)
        if a.control is not None:
            want = a.control.u if use == "pose" else a.control.u[[0, 2]]
            np.testing.assert_allclose(b.control.u, want, atol=1e-9)
            assert b.control.dt == pytest.approx(1.0)


@pytest.mark.parametrize(("observe", "fields"), [(cloud, 'id = "tag"'), (poses, "")])
def test_other_messages(tmp_path, observe, fields):
    scenario = world()
    write_ros2(tmp_path / "run", scenario, observe, False)
    back = read(tmp_path, "run", "pose", fields)
    check(scenario, back, "pose")
    if fields:
        np.testing.assert_array_equal(scenario.true_ids(), back.true_ids())
    else:
        assert (back.true_ids() == -2).all()


def test_ros1(tmp_path):
    scenario = world()
    write_ros1(tmp_path / "run.bag", scenario, poses)
    (tmp_path / "map.toml").write_text(
        MAPPING.format(bag="run.bag", use="pose", fields="").replace('[mount]\nbase = "base_link"\n', "")
        + "mount = [0.2, 0.1, 0.5]\n"
    )
    check(scenario, load(f"rosbag:{tmp_path}/map.toml"), "pose")


@pytest.mark.parametrize("name", ["out", "out.mcap"])
def test_results_go_out_as_a_bag_and_come_back(tmp_path, name):
    scenario = world()
    trace = tomthumb.run(scenario, associator="oracle")
    for _ in range(2):  # the second time over the first
        export(trace, tmp_path / name, format="rosbag", scenario=scenario)
    text = MAPPING.replace("/odom", "/tomthumb/estimate").replace("/landmarks", "/tomthumb/observations")
    text = text.replace("/truth", "/tomthumb/truth").replace('[mount]\nbase = "base_link"', "")
    (tmp_path / "map.toml").write_text(text.format(bag=name, use="pose", fields='id = "id"'))
    back = load(f"rosbag:{tmp_path}/map.toml")
    np.testing.assert_array_equal(back.true_ids(), trace.ids)
    pose = trace.pose[0]
    for k, step in enumerate(back.steps):
        pose = pose if step.control is None else compose(pose, step.control.u)
        np.testing.assert_allclose(pose, trace.pose[k], atol=1e-9)


def test_export_does_not_remove_what_is_no_bag(tmp_path):
    trace = tomthumb.run(world(), associator="oracle")
    (tmp_path / "precious").mkdir()
    with pytest.raises(TomThumbError, match="is no bag"):
        export(trace, tmp_path / "precious", format="rosbag")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("/odom", "/odo"), "unknown topic '/odo'; did you mean '/odom'"),
        (('topic = "/odom"', ""), r"\[odometry\] needs a topic"),
        (("base_link", "chassis"), "TF does not lead from 'laser' to 'chassis'"),
        (("[mount]", "[mounting]"), "did you mean 'mount'"),
        (('use = "pose"', 'use = "guess"'), "one of twist, pose"),
        (('topic = "/landmarks"', 'topic = "/landmarks"\nx = "pose.position.q"'), "no field 'q'"),
        (('topic = "/truth"', 'topic = "/truth"\npose = "twist"'), "is not a pose"),
        (("[sensor]", "[sensor]\nmodel = 3"), "model 3"),
        (('topic = "/truth"', ""), r"\[truth\] needs a topic"),
        (('topic = "/landmarks"', 'topic = "/landmarks"\nstd = [0.1, 1e200]'), "std must be positive, and at most"),
    ],
)
def test_mistakes_in_the_mapping_are_named(tmp_path, change, words):
    write_ros2(tmp_path / "run", world(), markers, False)
    text = MAPPING.format(bag="run", use="pose", fields="")
    assert change[0] in text
    (tmp_path / "map.toml").write_text(text.replace(*change))
    with pytest.raises(TomThumbError, match=words):
        load(f"rosbag:{tmp_path}/map.toml")


def test_a_damaged_bag_is_named(tmp_path):
    write_ros2(tmp_path / "run", world(), markers, True)
    file = next((tmp_path / "run").glob("*.mcap"))
    data = file.read_bytes()
    rng = np.random.default_rng(0)
    for cut in [data[: len(data) // 2], b"", *(_spoiled(data, rng) for _ in range(10))]:
        file.write_bytes(cut)
        with contextlib.suppress(TomThumbError):  # nothing else may come out
            read(tmp_path, "run")
    with pytest.raises(BrokenFile, match="no such bag"):
        read(tmp_path, "nowhere")
    with pytest.raises(BrokenFile, match="File name too long"):
        read(tmp_path, "a" * 5000)


def _spoiled(data, rng):
    out = bytearray(data)
    for k in rng.integers(0, len(out), 30):
        out[k] = rng.integers(256)
    return bytes(out)


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr("tomthumb.scenarios.bag_files.MAX_CHUNK", 8 << 20)
    return 8 << 20


@pytest.mark.parametrize("compression", [b"zstd", b"lz4", b""])
def test_lengths_that_lie_and_chunks_that_unfold_cost_little(tmp_path, compression, small_chunks):
    write_ros2(tmp_path / "run", world(), markers, True)
    file = next((tmp_path / "run").glob("*.mcap"))
    data = file.read_bytes()
    zeros = bytes(small_chunks + 1000)
    packed = {b"zstd": zstd_compress, b"lz4": lz4_compress}.get(compression, lambda raw: raw[:100])(zeros)
    length = 2**40 if not compression else 40 + len(compression) + len(packed)
    chunk = struct.pack("<BQQQQII", 6, length, 0, 1, len(zeros), 0, len(compression)) + compression
    file.write_bytes(data[:8] + chunk + struct.pack("<Q", len(packed)) + packed + data[8:])
    tracemalloc.start()
    with pytest.raises(BrokenFile, match="when unpacked" if compression else "not a readable bag"):
        read(tmp_path, "run")
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


def test_a_chunk_of_ros1_that_unfolds_is_refused(tmp_path, small_chunks):
    packed = bz2.compress(bytes(small_chunks + 1000))
    fields = b"".join(struct.pack("<I", len(f)) + f for f in (b"op=\x05", b"compression=bz2", b"size=\0\0\0\0"))
    record = struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(packed)) + packed
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + record)
    with pytest.raises(BrokenFile, match="when unpacked"):
        read(tmp_path, "a.bag")


def test_a_packed_message_that_unfolds_is_refused(tmp_path, small_chunks):
    write_ros2(tmp_path / "run", world(), markers, False)
    yaml = tmp_path / "run" / "metadata.yaml"
    text = yaml.read_text()
    yaml.write_text(re.sub("compression_mode:.*", "compression_mode: MESSAGE", text))
    with closing(sqlite3.connect(next((tmp_path / "run").glob("*.db3")))) as base:
        base.execute("UPDATE messages SET data = ? WHERE id = 5", (zstd_compress(bytes(small_chunks + 1000)),))
        base.commit()
    with pytest.raises(BrokenFile, match="a message of more than 8 MiB when unpacked"):
        read(tmp_path, "run")


def test_files_never_read_beyond_their_end(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * 200_000)
    with BoundedPath(tmp_path / "a").open("rb") as stream:
        stream.seek(150_000)
        assert len(stream.read(2**50)) == 50_000
        assert stream.read(2**50) == b""
        stream.seek(300_000)
        assert stream.read(2**50) == b""
