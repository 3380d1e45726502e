"""Small valid logs for every loader, and the ways to damage them. Used by fuzz_loaders.py and the tests."""

from __future__ import annotations

import gzip
import importlib.util
import lzma
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.metrics.truth import collect
from tomthumb.runner import run
from tomthumb.scenarios import load
from tomthumb.scenarios.csv_save import save_csv
from tomthumb.scenarios.jsonl import save_jsonl
from tomthumb.storage import SavedRun, load_lessons, load_map, load_run, save_run

HOSTILE = (
    b"nan", b"inf", b"-inf",
    b"1e308", b"-1e308", b"1e999", b"99999999999999999999", b"-1", b"0", b"", b"\x00", b"\xff\xfe",
    b"\xef\xbb\xbf", b"#", b",,,,", b"\n\n", b"\r", b"[[[[", b"{", b'"', b"../../etc/passwd", b"1_0", b"0x10", b"true",
    "\u0661\u0662".encode(), b"9" * 5000, b"-0.0", b"1e-320",
)  # fmt: skip
Files = dict[str, bytes]


def read_log(spec: str) -> int:
    """A scenario, steps and all; how many of them."""
    steps = list(load(spec).steps)
    for step in steps:
        assert np.isfinite(step.t)
        if step.observations is not None:
            assert np.isfinite(step.observations.z).all()
    return len(steps)


def read_map(path: str) -> int:
    """A saved map and what was learned about it; how many landmarks."""
    found = load_map(Path(path))
    load_lessons(Path(path))
    assert np.isfinite(found.landmarks).all()
    return len(found.ids)


def read_run(path: str) -> int:
    """A saved run; how many steps."""
    return len(load_run(Path(path)).trace.t)


@dataclass(frozen=True)
class Target:
    """A loader: how it is asked for (`{}` is the folder), its valid files, and what reads them and counts what it read."""

    spec: str
    files: Files
    read: Callable[[str], int] = read_log


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """One or two damages of random kinds."""
    for _ in range(rng.integers(1, 3)):
        data = DAMAGES[rng.integers(len(DAMAGES))](data, rng)
    return data[: 4 << 20]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for k in rng.integers(0, max(len(out), 1), rng.integers(1, 4)):
        if len(out):
            out[k] = rng.integers(256)
    return bytes(out)


def _span(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    a, b = sorted(rng.integers(0, len(data) + 1, 2))
    return int(a), int(min(b, a + 2000))


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:b] + data[a:b] * int(rng.integers(1, 6)) + data[b:]


def _remove(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:a] + data[b:]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    a = int(rng.integers(len(data) + 1))
    return data[:a] + HOSTILE[rng.integers(len(HOSTILE))] + data[a:]


def _word(data: bytes, rng: np.random.Generator) -> bytes:
    """A word (between blanks or commas) replaced by a hostile one."""
    a = int(rng.integers(len(data) + 1))
    start = max(data.rfind(mark, 0, a) for mark in (b" ", b",", b"\n", b":", b"[")) + 1
    ends = [e for e in (data.find(mark, a) for mark in (b" ", b",", b"\n", b"]")) if e >= 0]
    return data[:start] + HOSTILE[rng.integers(len(HOSTILE))] + data[min(ends, default=len(data)) :]


def _digits(data: bytes, rng: np.random.Generator) -> bytes:
    """A few digits changed: mostly a file of the right shape with wrong numbers."""
    out = bytearray(data)
    places = [k for k, byte in enumerate(data[:4096]) if 48 <= byte <= 57]
    for k in rng.choice(places, min(3, len(places)), replace=False) if places else ():
        out[k] = 48 + int(rng.integers(10))
    return bytes(out)


def _noise(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:a] + rng.bytes(int(rng.integers(0, 300))) + data[b:]


def _empty(data: bytes, rng: np.random.Generator) -> bytes:
    return b""


def _packed(data: bytes, rng: np.random.Generator) -> bytes:
    """The same packed, whole or cut."""
    packed = gzip.compress(data, 1) if rng.random() < 0.5 else lzma.compress(data, preset=0)
    return packed if rng.random() < 0.5 else _cut(packed, rng)


DAMAGES: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _cut, _flip, _flip, _digits, _digits, _repeat, _remove, _insert, _insert, _word, _word, _word, _noise, _empty, _packed,
)  # fmt: skip


def targets(data: Path | None) -> dict[str, Target]:
    """Small valid files for every loader; those of I-SLSJF are the log's own, where `data` has it. Bags need the
    extra ros.
    """
    found = {**_own(), **_saved(), **_text(), **_binary()}
    if importlib.util.find_spec("rosbags") is not None:
        found |= _bags()
    if data is not None:
        found |= _logs(data)
    return found


def _own() -> dict[str, Target]:
    world = load("random", steps=6, landmarks=30, size=20.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_jsonl(world, folder / "a.jsonl")
        save_csv(world, folder / "csv")
        csv = {file.name: file.read_bytes() for file in sorted((folder / "csv").iterdir())}
        return {
            "jsonl": Target("jsonl:{}/a.jsonl", {"a.jsonl": (folder / "a.jsonl").read_bytes()}),
            "csv": Target("csv:{}", csv),
        }


def _saved() -> dict[str, Target]:
    """What a run leaves: its trace, and its map with a memory beside it."""
    world = load("random", steps=12, landmarks=30, size=20.0)
    trace = run(world, associator="stt", settings={"associator": {"memory": True}, "slam": {"hits": 2}})
    with tempfile.TemporaryDirectory() as name:
        save_run(Path(name), SavedRun(trace, collect(world, trace)))
        files = _below(Path(name))
    kept = files.pop("trace.npz")
    return {
        "saved_map": Target("{}/map.csv", files, read_map),
        "saved_run": Target("{}", {"trace.npz": kept}, read_run),
    }


def _text() -> dict[str, Target]:
    g2o = b"VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400\n"
    g2o += b"EDGE_SE2_XY 0 7 2 1 4 0 25\nLANDMARK 1 7 1 1 2 0 5\n"
    course = b"ODOMETRY 0.1 0.1 0.0\nSENSOR 1 2.3 0.35\nSENSOR 2 4.0 1.5\nODOMETRY 0.1 0.1 0.0\nSENSOR 1 2.2 0.3\n" * 3
    step = b"STEP e.0001 0.1 -0.2 0.01 0.00002 0 0.00001 0 0 0.0002\nLANDMARK_C -0.2 -3.1 0.93 0.0017 0.0001 0.0037 6\n"
    velocity = b"".join(b"%d 1.0 0.0 0.1 1 0 0 0 1 0 0 0 1\n" % k for k in range(4, 40))
    seen = b"".join(b"%d\n1 0 3\n3.3 5.8 12.6\n-0.5 0.2 -0.1\n" % k for k in range(8, 40, 8))
    yaml = b"track:\n  left:\n" + b"".join(b"  - position: [%d, 2, 0]\n    class: blue\n" % x for x in range(0, 40, 4))
    yaml += b"  right:\n" + b"".join(b"  - position: [%d, -2, 0]\n    class: yellow\n" % x for x in range(0, 40, 4))
    yaml += b"  lanesFirstWithLastConnected: false\n"
    item = b"<include><uri>model://cone_%s</uri><pose>%d %d 0 0 0 0</pose><name>cone_%s</name></include>"
    cones = [(b"blue", 2, b"left"), (b"yellow", -2, b"right")]
    sdf = (
        b"<sdf><model>"
        + b"".join(item % (c, x, y, s) for c, y, s in cones for x in range(0, 40, 4))
        + b"</model></sdf>"
    )
    tags = b"tag,x,y,direction\n" + b"".join(b"%s,%d,%d,0\n" % (c, x, y) for c, y, _ in cones for x in range(0, 40, 4))
    robot = {
        "Barcodes.dat": b"1 5\n6 63\n7 25\n",
        "Landmark_Groundtruth.dat": b"6 1.2 3.4 0.001 0.001\n7 2.2 1.4 0.001 0.001\n",
        "Robot1_Odometry.dat": b"".join(b"%d.5 0.1 0.02\n" % k for k in range(12)),
        "Robot1_Measurement.dat": b"".join(b"%d.7 63 1.2 0.1\n%d.7 25 2.2 -0.1\n" % (k, k) for k in range(10)),
        "Robot1_Groundtruth.dat": b"".join(b"%d.1 1.0 2.0 0.1\n" % k for k in range(12)),
    }
    return {
        "graph": Target("graph:{}/a.g2o", {"a.g2o": g2o}),
        "freiburg": Target("freiburg:{}", {"sensor_data.dat": course, "world.dat": b"1 2 1\n2 0 4\n"}),
        "dlr": Target("dlr:{}", {"map.circles": b"# a\n" + step * 5}),
        "cones": Target("cones:{}", {"T_velocityLog_1.txt": velocity, "T_perceptionLog_1.txt": seen}),
        "mrclam": Target("mrclam:{}", robot),
        "track_yaml": Target("track:{}/a.yaml?rate=1", {"a.yaml": yaml}),
        "track_sdf": Target("track:{}/a.sdf?rate=1", {"a.sdf": sdf}),
        "track_csv": Target("track:{}/a.csv?rate=1", {"a.csv": tags}),
    }


def _binary() -> dict[str, Target]:
    park = {"raw_acfr/victoria_park_ascii.zip": _small_park()}
    return {
        "golden": Target("golden:{}/a.mat", {"a.mat": _small_golden()}),
        "lost_in_the_woods": Target("lost_in_the_woods:{}", {"dataset2.mat": _small_woods()}),
        "car_park": Target("car_park:{}?detections=raw", _small_car_park()),
        "victoria_park": Target("victoria_park:{}?detections=raw", park),
        "victoria_park_published": Target("victoria_park:{}", park | _derived_park()),
    }


def _logs(data: Path) -> dict[str, Target]:
    folder = data / "slsjf_simulated" / "535"
    names = ("sensor_data.mat", "store_speed.mat", "store_turnrate.mat", "store_robotTrue.mat", "store_beaconsTrue.mat")
    return {"slsjf": Target("slsjf:{}", {name: (folder / name).read_bytes() for name in names})}


def _mat(**values: object) -> bytes:
    from scipy.io import savemat

    out = BytesIO()
    savemat(out, values, do_compression=len(values) % 2 == 0)
    return out.getvalue()


def _small_golden() -> bytes:
    eye = np.eye(4)
    row = {
        "odom_x": np.zeros(3), "odom_P": np.eye(3), "z": np.zeros(4), "R": eye, "ground_id": np.array([1.0, 2]),
        "H": np.array([1.0, 2]), "map_ground_id": np.array([1.0, 2]), "x": np.zeros(7), "Pdiag": np.ones(7),
    }  # fmt: skip
    trace = np.array([row] * 3, object)
    run = {
        "algo": "JCBB", "points": np.zeros((2, 2)), "truth": np.zeros((3, 4)), "est": np.zeros((3, 4)),
        "x1": np.zeros(7),
        "P1": np.eye(7), "z1": np.zeros(4), "R1": eye, "ground_id1": np.array([1.0, 2]), "trace": trace,
    }  # fmt: skip
    return _mat(o=run)


def _small_woods() -> bytes:
    k = np.ones((5, 1))
    t = 0.1 * np.arange(5.0)[:, None]
    r = np.full((5, 3), 2.0)
    return _mat(
        t=t, x_true=k, y_true=k, th_true=k, true_valid=k, l=np.ones((3, 2)), r=r, b=r / 9, v=k, om=k, d=0.2, r_var=0.1,
        b_var=0.1, v_var=0.1, om_var=0.1,
    )  # fmt: skip


def _small_car_park() -> Files:
    t = np.arange(8.0)[None]
    bright = np.zeros((8, 361))
    bright[:, 100] = 1
    log = _mat(
        Time_VS=t, Velocity=t * 0 + 1, Steering=t * 0, TimeGPS=t, GPSLon=t, GPSLat=t, TimeLaser=t + 0.5,
        Laser=np.full((8, 361), 5.0), Intensity=bright,
    )  # fmt: skip
    return {"data_set.mat": log, "beac_juan3.mat": _mat(estbeac=np.ones((3, 2)))}


def _small_park() -> bytes:
    out = BytesIO()
    scan = np.full(361, 81.91)
    scan[100:104] = 10.0
    laser = " ".join(f"{k} " + " ".join(map(str, scan)) for k in range(4))
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("DRS.txt", "".join(f"{0.1 * k} 1.0 0.01\n" for k in range(40)))
        archive.writestr("GPS.txt", "0 1 1\n1 2 2\n")
        archive.writestr("LASER.txt", laser)
    return out.getvalue()


def _derived_park() -> Files:
    seen = "".join(f"{k},{0.2 * k},{5 + k % 3},{1.5},0.4,{k % 3 - 1}\n" for k in range(20))
    tables = {
        "detections_labelled.csv.gz": "scan_index,t_s,range_m,bearing_rad,diameter_m,ref_id\n" + seen,
        "reference_ls_landmarks.csv": "ref_id,x_m,y_m,n_obs,median_diameter_m\n0,1,2,9,0.4\n1,4,2,9,0.4\n",
        "reference_ls_poses.csv.gz": "t_s,x_m,y_m,theta_rad\n" + "".join(f"{0.2 * k},{k},0,0.1\n" for k in range(20)),
    }
    packed = {
        name: gzip.compress(text.encode()) if name.endswith("gz") else text.encode() for name, text in tables.items()
    }
    return {f"derived/{name}": data for name, data in packed.items()}


MAPPING = b"""bag = "run%s"
[odometry]
topic = "/odom"
use = "pose"
[observations]
topic = "/landmarks"
%s
std = [0.1, 0.1]
[truth]
topic = "/odom"
[sensor]
max_range = 20.0
"""


def _bags() -> dict[str, Target]:
    """The same few messages as ROS 2 (SQLite), MCAP and ROS 1."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores

    from tomthumb.export.rosbag import Builder

    new, old = Builder(), Builder(Stores.ROS1_NOETIC)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, plugin in (("sqlite", rosbag2.StoragePlugin.SQLITE3), ("mcap", rosbag2.StoragePlugin.MCAP)):
            with rosbag2.Writer(folder / kind / "run", version=9, storage_plugin=plugin) as writer:
                _messages(writer, new, new.store.serialize_cdr, _markers)
        (folder / "ros1").mkdir()
        with rosbag1.Writer(folder / "ros1" / "run.bag") as writer:
            _messages(writer, old, old.store.serialize_ros1, _poses)
        return {
            f"bag_{kind}": Target("rosbag:{}/map.toml", {"map.toml": MAPPING % rest} | _below(folder / kind))
            for kind, rest in (("sqlite", (b"", b'id = "id"')), ("mcap", (b"", b'id = "id"')), ("ros1", (b".bag", b"")))
        }


def _markers(build: Any, t: float, points: np.ndarray) -> Any:
    return build.markers(t, points, np.arange(len(points)), "laser")


def _poses(build: Any, t: float, points: np.ndarray) -> Any:
    header = build.header(t, "laser")
    return build.make("geometry_msgs/msg/PoseArray", header=header, poses=[build.pose(x, y, 0.0) for x, y in points])


def _messages(writer: Any, build: Any, serialize: Callable[..., Any], observe: Callable[..., Any]) -> None:
    connections: dict[str, Any] = {}
    for k in range(4):
        odometry = build.odometry(k, np.array([k, 0.0, 0.1]), np.zeros((3, 3)))
        seen = observe(build, k, np.array([[4.0 - k, 1.0], [2.0, -1.0]]))
        for topic, message in (("/odom", odometry), ("/landmarks", seen)):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=build.store)
            writer.write(connections[topic], (k + 1) * 10**9, serialize(message, message.__msgtype__))


def _below(folder: Path) -> Files:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def attempt(target: Target, folder: Path, rng: np.random.Generator) -> bool:
    """One case in an empty folder; True where the damaged log was still read."""
    hit = rng.random(len(target.files)) < 1.5 / len(target.files)
    hit[rng.integers(len(hit))] = True
    spoiled = zip(target.files.items(), hit, strict=True)
    return survives(target, folder, {name: damage(data, rng) if spoil else data for (name, data), spoil in spoiled})


def survives(target: Target, folder: Path, files: Files) -> bool:
    """Load such files, steps and all; True where it was read, False where a TomThumbError came instead."""
    write(folder, files)
    try:
        target.read(target.spec.format(folder))
    except TomThumbError as error:
        text = str(error)
        assert "\n" not in text, f"more than one line: {text!r}"
        assert "MemoryError" not in text, text  # someone caught it on the way
        return False
    return True


def write(folder: Path, files: Files) -> None:
    """Put files, with their folders, below `folder`."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
