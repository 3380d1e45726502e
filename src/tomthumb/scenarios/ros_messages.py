"""Values out of decoded ROS messages: fields by dotted name, poses in the plane, clouds, transforms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.types import Array

COLUMNS = ("id", "label", "signature")
MAX_ITEMS = 100_000  # of one message
# What stands where in the messages that everybody knows: the list, x, y.
KNOWN = {
    "MarkerArray": ("markers", "pose.position.x", "pose.position.y"),
    "PoseArray": ("poses", "position.x", "position.y"),
    "PointCloud2": ("", "x", "y"),
    "PointCloud": ("points", "x", "y"),
}
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField


def attribute(message: Any, name: str, where: str) -> Any:
    """The value at a dotted name; raises TomThumbError naming the fields there are."""
    value = message
    for part in name.split("."):
        if not hasattr(value, part):
            there = ", ".join(getattr(value, "__dataclass_fields__", {}))
            raise TomThumbError(f"{where}: no field {part!r} of {name!r}; there are {there or 'none'}")
        value = getattr(value, part)
    return value


def dictionary_of(landmarks: Any) -> dict[str, str]:
    """The names of the fields of observations, as given in the mapping."""
    return {key: getattr(landmarks, key) for key in ("list", "x", "y", "range", "bearing", *COLUMNS)}


def records(message: Any, kind: str, names: Mapping[str, str], where: str) -> Array:
    """The items of a message as rows (m, 5): two components of z, id, label, signature; NaN where there is none.

    Items without a finite position are left out (clouds use NaN for "no return"). Raises TomThumbError for fields that
    are not there.
    """
    listed, x, y = KNOWN.get(kind.rsplit("/", 1)[-1], ("", "", ""))
    z = (names["range"], names["bearing"]) if names["range"] else (names["x"] or x, names["y"] or y)
    if not all(z):
        raise TomThumbError(f"{where}: a {kind} needs list, x and y (or range and bearing)")
    fields = [*z, *(names[key] for key in COLUMNS)]
    if kind.endswith("PointCloud2"):
        rows = _cloud(message, fields, where)
    else:
        rows = _items(message, names["list"] or listed, fields, where)
    return rows[np.isfinite(rows[:, :2]).all(1)]


def _items(message: Any, listed: str, fields: list[str], where: str) -> Array:
    items = attribute(message, listed, where) if listed else [message]
    if len(items) > MAX_ITEMS:
        raise TomThumbError(f"{where}: {len(items)} items in one message; at most {MAX_ITEMS}")
    kept = [item for item in items if getattr(item, "action", 0) == 0]  # markers to be deleted are no observations
    rows = [[_number(attribute(item, f, where)) if f else math.nan for f in fields] for item in kept]
    return np.array(rows).reshape(-1, len(fields))


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TomThumbError(f"{str(value)[:60]!r} is not a number") from None


def _cloud(message: Any, fields: list[str], where: str) -> Array:
    """Columns of a PointCloud2."""
    order = ">" if message.is_bigendian else "<"
    known = {f.name: (int(f.offset), TYPES.get(int(f.datatype))) for f in message.fields}
    count, step = int(message.width) * int(message.height), int(message.point_step)
    data = np.ascontiguousarray(message.data, np.uint8)
    if count > MAX_ITEMS or count < 0 or step <= 0 or count * step > len(data):
        raise TomThumbError(f"{where}: a cloud of {count} points of {step} bytes in {len(data)} bytes")
    rows = np.full((count, len(fields)), np.nan)
    for k, name in enumerate(fields):
        if not name:
            continue
        offset, code = known.get(name, (0, None))
        if code is None or offset < 0 or offset + int(code[1]) > step:
            raise TomThumbError(f"{where}: no field {name!r} in the cloud; there are {', '.join(known) or 'none'}")
        column = np.ndarray((count,), order + code, data.tobytes(), offset, (step,))
        rows[:, k] = column
    return rows


def planar(pose: Any) -> Array:
    """Position and yaw (3,) of a Pose, PoseWithCovariance or PoseStamped. Raises TomThumbError if it is not finite."""
    while hasattr(pose, "pose"):
        pose = pose.pose
    if not hasattr(pose, "position") or not hasattr(pose, "orientation"):
        raise TomThumbError(f"a {type(pose).__name__} is not a pose")
    return _finite([pose.position.x, pose.position.y, math.atan2(*_sin_cos(pose.orientation))])


def _sin_cos(q: Any) -> tuple[float, float]:
    """Sine and cosine of the yaw of a quaternion."""
    return 2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z)


def _finite(values: list[float]) -> Array:
    out = np.array(values, float)
    if not np.isfinite(out).all():
        raise TomThumbError("a pose is not finite")
    return out


def mount_from_tf(tree: Mapping[str, tuple[str, Any]], base: str, sensor: str, where: str) -> Array:
    """The sensor's place (x m, y m, yaw rad) on the robot, from transforms ``child: (parent, transform)``.

    The chain from `sensor` up to `base` is composed in space and then laid into the plane. Raises TomThumbError where
    there is none.
    """
    total = np.eye(4)
    frame = sensor.lstrip("/")
    frames = {child.lstrip("/"): (parent.lstrip("/"), transform) for child, (parent, transform) in tree.items()}
    for _ in range(len(frames) + 1):
        if frame == base.lstrip("/"):
            return _finite([total[0, 3], total[1, 3], math.atan2(total[1, 0], total[0, 0])])
        if frame not in frames:
            break
        frame, transform = frames[frame]
        total = _matrix(transform) @ total
    known = ", ".join(sorted(frames)) or "none"
    raise TomThumbError(f"{where}: TF does not lead from {sensor!r} to {base!r}; frames with a parent: {known}")


def _matrix(transform: Any) -> Array:
    q, t = transform.rotation, transform.translation
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), t.x],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), t.y],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), t.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
