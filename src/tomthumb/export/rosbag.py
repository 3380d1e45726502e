"""A run as a ROS 2 bag (extra: ros): estimate, observations with the identities found, map. No ROS is needed."""

from __future__ import annotations

import inspect
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tomthumb.errors import TomThumbError
from tomthumb.types import Array, Scenario, Trace

STORE = Stores.ROS2_HUMBLE
EPOCH = 1  # s added to all times, since ROS takes the time 0 for "none"
SPHERE = 2
Message = tuple[str, float, Any]


def save_bag(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """/tomthumb/estimate (nav_msgs/Odometry with covariance), /tomthumb/map (MarkerArray, at the end) and, with the
    scenario, /tomthumb/observations (MarkerArray in the sensor's frame, id = the landmark given, -1 none) and
    /tomthumb/truth (nav_msgs/Odometry). A path that ends in .mcap makes an MCAP bag, others SQLite.

    Raises TomThumbError where `path` holds something that is not a bag.
    """
    if path.exists():
        if not (path / "metadata.yaml").exists():
            raise TomThumbError(f"{path}: is there already, and is no bag")
        shutil.rmtree(path)
    build = Builder()
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, t, message in _messages(build, trace, scenario):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=build.store)
            stamp = nanoseconds(t)
            writer.write(connections[topic], stamp, build.store.serialize_cdr(message, kind))


def _messages(build: Builder, trace: Trace, scenario: Scenario | None) -> Iterator[Message]:
    steps = iter(scenario.steps) if scenario is not None else iter(())
    for k, t in enumerate(trace.t.tolist()):
        yield "/tomthumb/estimate", t, build.odometry(t, trace.pose[k], trace.pose_cov[k])
        step = next(steps, None)
        if step is None or scenario is None:
            continue
        if step.observations is not None:
            z = step.observations.z
            points = z if not scenario.sensor.angles else _points(z)
            ids = trace.ids[trace.offsets[k] : trace.offsets[k + 1]]
            yield "/tomthumb/observations", t, build.markers(t, points, ids, "sensor")
        if step.truth is not None and step.truth.pose is not None:
            yield "/tomthumb/truth", t, build.odometry(t, step.truth.pose, np.zeros((3, 3)))
    if len(trace.t):
        yield (
            "/tomthumb/map",
            float(trace.t[-1]),
            build.markers(float(trace.t[-1]), trace.final.landmarks, trace.final.ids, "map"),
        )


def _points(z: Array) -> Array:
    return np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])


def nanoseconds(t: float) -> int:
    """The time of a message in a bag: whole nanoseconds, from EPOCH on."""
    return round((t + EPOCH) * 1e9)


class Builder:
    """Makes messages of the type store (which costs a moment to load, so that it is kept)."""

    def __init__(self, store: Stores = STORE) -> None:
        self.store = get_typestore(store)

    def make(self, kind: str, **values: Any) -> Any:
        """A message of a kind."""
        return self.store.types[kind](**values)

    def header(self, t: float, frame: str) -> Any:
        """A header at `t` s."""
        stamp = nanoseconds(t)
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        numbered: dict[str, Any] = (
            {"seq": 0} if "seq" in inspect.signature(self.store.types["std_msgs/msg/Header"]).parameters else {}
        )  # ROS 1
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **numbered)

    def pose(self, x: float, y: float, heading: float) -> Any:
        """A pose in the plane."""
        q = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))
        point = self.make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=q)

    def odometry(
        self,
        t: float,
        pose: Array,
        cov: Array,
        speed: float = 0.0,
        turn: float = 0.0,
        frames: tuple[str, str] = ("map", "base_link"),
    ) -> Any:
        """nav_msgs/Odometry with the covariance (3, 3) in its place in the 6 x 6."""
        full = np.zeros((6, 6))
        full[np.ix_((0, 1, 5), (0, 1, 5))] = cov
        spread = self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(*pose), covariance=full.ravel())
        twist = self.make("geometry_msgs/msg/Twist", linear=self.vector(speed), angular=self.vector(0.0, 0.0, turn))
        moving = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        head = self.header(t, frames[0])
        return self.make("nav_msgs/msg/Odometry", header=head, child_frame_id=frames[1], pose=spread, twist=moving)

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        """A Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def markers(self, t: float, points: Array, ids: Any, frame: str) -> Any:
        """A MarkerArray of spheres."""
        items = [self.marker(t, x, y, int(i), frame) for (x, y), i in zip(points, ids, strict=True)]
        return self.make("visualization_msgs/msg/MarkerArray", markers=items)

    def marker(self, t: float, x: float, y: float, number: int, frame: str) -> Any:
        """One sphere."""
        empty = np.empty(0, np.uint8)
        image = self.make("sensor_msgs/msg/CompressedImage", header=self.header(t, frame), format="", data=empty)
        colour = self.make("std_msgs/msg/ColorRGBA", r=0.8, g=0.3, b=0.1, a=1.0)
        return self.make(
            "visualization_msgs/msg/Marker",
            header=self.header(t, frame),
            ns="tomthumb",
            id=number,
            type=SPHERE,
            action=0,
            pose=self.pose(x, y, 0.0),
            scale=self.vector(0.1, 0.1, 0.1),
            color=colour,
            lifetime=self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=image,
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=self.make("visualization_msgs/msg/MeshFile", filename="", data=empty),
            mesh_use_embedded_materials=False,
        )
