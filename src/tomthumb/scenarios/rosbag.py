"""ROS 1 and ROS 2 bags (MCAP too) as logs, through a small TOML file that says which topic is what (extra: ros).

docs/logs.md describes the file. No ROS is needed.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.geometry import between
from tomthumb.scenarios.bag_files import BoundedPath, check_bag
from tomthumb.scenarios.layout import parse_header
from tomthumb.scenarios.params import convert, unknown_key
from tomthumb.scenarios.reading import MAX_NUMBER, Steps, increasing, known, pose_at, read_text
from tomthumb.scenarios.ros_messages import attribute, dictionary_of, mount_from_tf, planar, records
from tomthumb.scenarios.timeline import Scan, steps, timeline
from tomthumb.types import Array, Control, Ids, Observations, Scenario, Step, Truth

MAX_MESSAGES = 2_000_000
KEYS = ("bag", "name", "odometry", "observations", "truth", "mount", "motion", "sensor", "prior", "scoring")
STD = (0.1, 0.1)


@dataclass(frozen=True, slots=True)
class Odometry:
    """Where the odometry is. `use` "twist": `speed` and `turn` are rates; "pose": changes of `pose` are increments."""

    topic: str
    use: Literal["twist", "pose"] = "twist"
    speed: str = "twist.twist.linear.x"
    turn: str = "twist.twist.angular.z"
    pose: str = "pose.pose"


@dataclass(frozen=True, slots=True)
class Landmarks:
    """Where the observations are: the `list` of a message, and the fields of its items ("" where there is none).

    MarkerArray, PoseArray and PointCloud2 need no fields but those that differ. With `range` and `bearing` instead of
    `x` and `y` the sensor must be range_bearing. `id` names the true landmark (leave it out where it is only a running
    number), `label` a class, `signature` a measured property. `std` is of the two components of z.
    """

    topic: str
    list: str = ""
    x: str = ""
    y: str = ""
    range: str = ""
    bearing: str = ""
    id: str = ""
    label: str = ""
    signature: str = ""
    std: tuple[float, float] = STD


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """Where the true pose is, and over how many seconds it may be interpolated."""

    topic: str
    pose: str = "pose.pose"
    longest_gap: float = 0.5


@dataclass(frozen=True, slots=True)
class Mount:
    """The frames between which TF gives the sensor's place: `base` of the robot, `sensor` ("": the message's own)."""

    base: str = "base_link"
    sensor: str = ""


@dataclass(frozen=True, slots=True)
class BagMapping:
    """The whole TOML file."""

    bag: Path
    odometry: Odometry
    observations: Landmarks
    truth: GroundTruth | None
    mount: Mount | None
    header: dict[str, Any]


@dataclass(slots=True)
class Collected:
    """What was in the bag, in the order of its messages."""

    odometry: list[tuple[float, Any]] = field(default_factory=list)
    scans: list[tuple[float, Array]] = field(default_factory=list)
    truth: list[tuple[float, Array]] = field(default_factory=list)
    tf: dict[str, tuple[str, Any]] = field(default_factory=dict)
    frame: str = ""


def load_bag(path: Path, *, bag: Path | None = None) -> Scenario:
    """A scenario from a mapping file; `bag` stands for the bag that the file names (relative to the file).

    Times are those of the headers, or of the bag where a message has none, from the first one on. Velocities hold until
    the next message; poses are interpolated to the scans. Raises BrokenFile for files that cannot be read,
    TomThumbError for keys, topics or fields that are not there, or where the extra is not installed.
    """
    mapping = read_mapping(Path(path), bag)
    found = collect(mapping, Path(path))
    if not found.odometry or not found.scans:
        what = "odometry" if not found.odometry else "observations"
        raise TomThumbError(f"{path}: the topic of {what} holds no messages")
    if mapping.mount is not None:
        sensor = mapping.mount.sensor or found.frame
        mapping.header["sensor"]["mount"] = list(mount_from_tf(found.tf, mapping.mount.base, sensor, str(path)))
    values = parse_header(mapping.header, str(path))
    start = min(found.odometry[0][0], found.scans[0][0])
    truth = np.array([[t - start, *pose] for t, pose in found.truth]).reshape(-1, 4)
    increasing(truth[:, 0], mapping.bag, "time of the truth")
    scan_t = np.array([t - start for t, _ in found.scans])
    increasing(scan_t, mapping.bag, "time of the observations")
    gap = 0.0 if mapping.truth is None else mapping.truth.longest_gap
    poses = pose_at(scan_t, truth[:, 0], truth[:, 1:], gap)
    scan = _scan(mapping.observations, [rows for _, rows in found.scans], poses)
    odometry_t = np.array([t - start for t, _ in found.odometry])
    increasing(odometry_t, mapping.bag, "time of the odometry")
    moved = np.array([value for _, value in found.odometry])
    make = _from_rates if mapping.odometry.use == "twist" else _from_poses
    return Scenario(steps=make(odometry_t, moved, scan_t, scan), info={"file": str(path)}, **values)


def read_mapping(path: Path, bag: Path | None = None) -> BagMapping:
    """The TOML file, checked. Raises BrokenFile where it is no TOML, TomThumbError for wrong keys and values."""
    try:
        raw = tomllib.loads(read_text(path, 1 << 20))
    except (ValueError, RecursionError) as error:  # a TOMLDecodeError, or an integer of too many digits
        raise BrokenFile(path, f"not TOML: {error}") from None
    for key in raw:
        if key not in KEYS:
            raise TomThumbError(unknown_key(str(path), key, KEYS))
    for key in ("odometry", "observations", *(k for k in ("truth",) if k in raw)):
        if not isinstance(raw.get(key, {}), dict) or "topic" not in raw.get(key, {}):
            raise TomThumbError(f"{path}: [{key}] needs a topic")
    odometry = _table(Odometry, raw, "odometry", path)
    header: dict[str, Any] = {key: raw[key] for key in ("name", "motion", "prior", "scoring") if key in raw}
    header["motion"] = {"model": "velocity" if odometry.use == "twist" else "increment", **raw.get("motion", {})}
    polar = bool(raw["observations"].get("range"))
    header["sensor"] = {"model": "range_bearing" if polar else "cartesian", **raw.get("sensor", {})}
    named = bag if bag is not None else path.parent / str(raw.get("bag", ""))
    if bag is None and "bag" not in raw:
        raise TomThumbError(f'{path}: no bag is named: bag = "PATH" or ?bag=PATH')
    landmarks = _table(Landmarks, raw, "observations", path)
    if not all(0 < std <= MAX_NUMBER for std in landmarks.std):
        raise TomThumbError(f"{path}: observations: std must be positive, and at most {MAX_NUMBER:g}")
    return BagMapping(
        Path(named),
        odometry,
        landmarks,
        _table(GroundTruth, raw, "truth", path) if "truth" in raw else None,
        _table(Mount, raw, "mount", path) if "mount" in raw else None,
        header,
    )


def _table(kind: Callable[..., Any], raw: Mapping[str, Any], key: str, path: Path) -> Any:
    if not isinstance(raw[key], dict):
        raise TomThumbError(f"{path}: {key} must be a table")
    return kind(**convert(kind, raw[key], f"{path}: {key}"))


def collect(mapping: BagMapping, where: Path) -> Collected:
    """All messages that the mapping asks for, decoded. Raises BrokenFile where the bag cannot be read."""
    out = Collected()
    read = dictionary_of(mapping.observations)
    topics = {mapping.odometry.topic, mapping.observations.topic}
    if mapping.truth is not None:
        topics.add(mapping.truth.topic)
    for k, (topic, t, message, kind) in enumerate(messages(mapping.bag, topics, tf=mapping.mount is not None)):
        if k > MAX_MESSAGES:
            raise BrokenFile(mapping.bag, f"more than {MAX_MESSAGES} messages")
        if kind.endswith("TFMessage"):
            for item in message.transforms:
                out.tf.setdefault(item.child_frame_id, (item.header.frame_id, item.transform))
            continue
        if topic == mapping.odometry.topic:
            out.odometry.append((t, _moved(mapping.odometry, message, str(where))))
        if topic == mapping.observations.topic:
            out.scans.append((t, records(message, kind, read, f"{where}: observations")))
            header = getattr(message, "header", None) or getattr(next(iter(_markers(message)), None), "header", None)
            out.frame = out.frame or getattr(header, "frame_id", "")
        if mapping.truth is not None and topic == mapping.truth.topic:
            out.truth.append((t, planar(attribute(message, mapping.truth.pose, f"{where}: truth"))))
    return out


def _markers(message: Any) -> list[Any]:
    return getattr(message, "markers", [])


def _moved(odometry: Odometry, message: Any, where: str) -> Array:
    if odometry.use == "pose":
        return planar(attribute(message, odometry.pose, f"{where}: odometry"))
    values = [float(attribute(message, name, f"{where}: odometry")) for name in (odometry.speed, odometry.turn)]
    if not all(map(math.isfinite, values)):
        raise TomThumbError(f"{where}: odometry: a velocity is not finite")
    return np.array(values)


def messages(bag: Path, topics: set[str], *, tf: bool) -> Iterator[tuple[str, float, Any, str]]:
    """Topic, time s, message and type of every message on `topics` (and TF), in order of the bag's time.

    Whatever the reading library raises on a damaged bag becomes one BrokenFile, since its exceptions are of many kinds.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise TomThumbError("bags need rosbags: pip install 'tomthumb[ros]'") from None
    try:
        if not bag.exists():
            raise BrokenFile(bag, "no such bag")
        check_bag(bag)
        with AnyReader([BoundedPath(bag)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            there = {c.topic for c in reader.connections}
            _all_there(topics, there, bag)
            wanted = [c for c in reader.connections if c.topic in topics or (tf and c.msgtype.endswith("TFMessage"))]
            for connection, stamp, raw in reader.messages(connections=wanted):
                message = reader.deserialize(raw, connection.msgtype)
                yield connection.topic, _stamp(message, stamp), message, connection.msgtype
    except (TomThumbError, GeneratorExit, KeyboardInterrupt):
        raise
    except Exception as error:
        raise BrokenFile(
            bag, f"not a readable bag: {type(error).__name__}: {' '.join(str(error).split())[:150]}"
        ) from None


def _all_there(topics: set[str], there: set[str], bag: Path) -> None:
    for topic in sorted(topics - there):
        raise TomThumbError(unknown_key(str(bag), topic, there).replace("key", "topic"))


def _stamp(message: Any, bag_time: int) -> float:
    """The header's time, the first marker's, or the bag's, s."""
    header = getattr(message, "header", None)
    if header is None and _markers(message):
        header = getattr(_markers(message)[0], "header", None)
    stamp = getattr(header, "stamp", None)
    if stamp is None or (stamp.sec == 0 and stamp.nanosec == 0):
        return bag_time * 1e-9
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _scan(landmarks: Landmarks, rows: list[Array], poses: Array) -> Scan:
    """What makes the i-th scan: columns of rows are z (2), id, label, signature, NaN where there is none."""
    R = np.diag(np.square(landmarks.std))

    def column(values: Array, name: str, blank: int) -> Ids | None:
        if not name:
            return None
        return np.where(np.isfinite(values), np.nan_to_num(values), blank).astype(np.int64)

    def scan(i: int) -> tuple[Observations, Truth | None]:
        z = rows[i][:, :2]
        signature = rows[i][:, 4] if landmarks.signature else None
        labels = column(rows[i][:, 3], landmarks.label, -1)
        found = Observations(z, np.tile(R, (len(z), 1, 1)), labels, signature)
        return found, Truth(known(poses[i]), column(rows[i][:, 2], landmarks.id, -2))

    return scan


def _from_rates(t: Array, u: Array, scan_t: Array, scan: Scan) -> Steps:
    return steps(timeline(t, scan_t, float(min(t[0], scan_t[0]))), u, scan)


def _from_poses(t: Array, poses: Array, scan_t: Array, scan: Scan) -> Steps:
    """One step a scan, moved by the change of the odometry's pose since the scan before (none outside its time)."""
    at = pose_at(np.clip(scan_t, t[0], t[-1]), t, poses, math.inf)

    def make(k: int) -> Step:
        dt = float(scan_t[k] - scan_t[k - 1]) if k else 0.0
        control = Control(between(at[k - 1], at[k]), dt) if k else None
        return Step(float(scan_t[k]), control, *scan(k))

    return Steps(len(scan_t), make)
