"""Cone tracks of Formula Student simulators as worlds: PacSim YAML, FSSIM YAML and SDF, EUFS / FSDS CSV.

A car drives round between the cones, which it sees with their colours as labels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.geometry import wrap_angle
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.reading import as_text, floats, read_bytes
from tomthumb.scenarios.simulate import DETECT_CAP, Eye, Streams, require, scans
from tomthumb.scenarios.simulate import path as poses_along
from tomthumb.types import NONE, Array, Control, Ids, Observations, Prior, Scenario, Step, Truth

MAX_FILE = 4 << 20
MAX_CONES = 20_000
YELLOW, BLUE, ORANGE, LARGE = range(4)
CLASSES = {
    "yellow": YELLOW,
    "blue": BLUE,
    "small-orange": ORANGE,
    "orange": ORANGE,
    "big-orange": LARGE,
    "big_orange": LARGE,
    "orange_big": LARGE,
}
SIDES = {BLUE: "left", YELLOW: "right"}  # Formula Student: blue is left, yellow is right


@dataclass(frozen=True, slots=True)
class Track:
    """Cones (n, 2) m with labels (n,), the borders (m, 2) in driving order, where the car starts, whether it closes."""

    cones: Array
    labels: Ids
    left: Array
    right: Array
    start: Array
    closed: bool


def track(
    path: Path,
    rng: np.random.Generator,
    *,
    laps: int = 1,
    teach: int = 0,
    speed: float = 5.0,
    rate: float = 10.0,
    max_range: float = 12.0,
    fov: float = math.radians(120.0),
    range_std: float = 0.1,
    bearing_std: float = math.radians(1.0),
    odometry_noise: float = 1.0,
    clutter: float = 0.0,
    detect: float = 0.9,
    mislabel: float = 0.0,
    confusion: float = 0.0,
) -> Scenario:
    """Drive `laps` laps along the middle of a track file at `speed` m/s, with `rate` scans a second.

    Labels are colours (0 yellow, 1 blue, 2 orange, 3 large orange), unknown (-1) for a share `mislabel` of the
    observations and for clutter; a share `confusion` of the others is read at random. The sensor is as in
    `worlds.square`. Raises BrokenFile for files that are no track.
    """
    require(0 <= teach < laps <= 1000, f"track: laps={laps}, teach={teach}: 0 <= teach < laps <= 1000")
    require(0.0 < speed <= 100.0 and 0.1 <= rate <= 1000.0, f"track: speed={speed}, rate={rate}: both above 0")
    require(0.0 <= mislabel <= 1.0, f"track: mislabel={mislabel}: 0 to 1")
    require(0.0 <= confusion <= 1.0, f"track: confusion={confusion}: 0 to 1")
    require(range_std > 0 and bearing_std > 0 and max_range > 0, "track: range_std, bearing_std, max_range: above 0")
    require(0.0 < detect <= 1.0 and clutter >= 0.0 and odometry_noise >= 0.0, "track: detect, clutter or noise wrong")
    world = read_track(Path(path))
    streams = Streams.of(rng)
    eye = Eye(max_range, fov, range_std=range_std, bearing_std=bearing_std, detect=detect, clutter=clutter)
    start, motions = _drive(world, speed / rate, laps)
    poses = poses_along(start, list(motions))
    seen = scans(eye, poses, world.cones, streams, np.empty((len(poses), 0, 2)))
    colours = Colours(world.labels, mislabel, confusion, streams.layout, streams.layout.spawn(1)[0])
    controls = [None, *_readings(motions, speed, rate, odometry_noise, streams.odometry)]
    taught = len(poses) * teach // laps
    return Scenario(
        name=f"track {Path(path).stem}",
        motion=OdometryIncrement(),
        sensor=RangeBearing(
            max_range=max_range,
            fov=fov,
            std=(range_std, bearing_std),
            detect=min(detect, DETECT_CAP),
            clutter=eye.clutter_density,
        ),
        prior=Prior(start, np.zeros((3, 3))),
        steps=[
            Step(k / rate, control, colours.of(z, ids), Truth(pose, ids))
            for k, (control, pose, (z, ids)) in enumerate(zip(controls, poses, seen, strict=True))
        ],
        landmarks=world.cones,
        score_from=max(1, taught),
        teach_steps=taught,
        info={"file": str(path), "labels": ("yellow", "blue", "orange", "large orange")},
    )


def _readings(motions: Array, speed: float, rate: float, noise: float, rng: np.random.Generator) -> list[Control]:
    """What the odometry says of each motion: off by 2 % of its length ahead, 1 % aside and 0.1 deg, times `noise`."""
    std = noise * np.array([0.02 * speed / rate, 0.01 * speed / rate, math.radians(0.1)])
    read = motions + std * rng.standard_normal(motions.shape)
    return [Control(u, 1 / rate, np.diag(std**2)) for u in read]


@dataclass(frozen=True, slots=True)
class Colours:
    """Colours as they are read: some not at all, some wrongly; each by a stream of its own."""

    labels: Ids
    mislabel: float
    confusion: float
    rng: np.random.Generator
    wrong: np.random.Generator

    def of(self, scan: Observations, ids: Ids) -> Observations:
        """The scan with the colours of landmarks `ids (m,)`; clutter has none."""
        confused, other = self.wrong.random(len(ids)) < self.confusion, self.wrong.integers(0, LARGE + 1, len(ids))
        colours = np.where(confused, other, self.labels[np.maximum(ids, 0)])
        unknown = (self.rng.random(len(ids)) < self.mislabel) | (ids < 0)
        return Observations(scan.z, scan.R, np.where(unknown, NONE, colours))


def _drive(world: Track, step: float, laps: int) -> tuple[Array, Array]:
    """The start pose and motions along the middle line, `step` m each."""
    nearest = np.linalg.norm(world.left[:, None] - world.right[None], axis=2).argmin(1)
    middle = (world.left + world.right[nearest]) / 2
    keep = np.append(True, np.linalg.norm(np.diff(middle, axis=0), axis=1) > 1e-3)
    middle = middle[keep]
    if world.closed:
        middle = np.vstack([*[middle] * laps, middle[:1]])
    elif laps > 1:
        raise TomThumbError("track: an open track has one lap")
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1)))
    at = np.arange(0.0, way[-1], step)
    if len(at) < 3 or len(at) > 1_000_000:
        raise TomThumbError(f"track: {len(at)} steps along {way[-1]:.3g} m: 3 to 1000000 are possible")
    points = np.column_stack([np.interp(at, way, middle[:, k]) for k in (0, 1)])
    delta = np.diff(points, axis=0)
    heading = np.arctan2(delta[:, 1], delta[:, 0])
    turns = np.array([wrap_angle(b - a) for a, b in pairwise(heading)])
    moves = np.hypot(delta[:-1, 0], delta[:-1, 1])
    return np.array([*points[0], heading[0]]), np.column_stack([moves, np.zeros(len(moves)), turns])


def read_track(file: Path) -> Track:
    """The cones of a track file, its format told by its content. Raises BrokenFile where it is none."""
    data = read_bytes(file, MAX_FILE)
    head = data.lstrip()[:200]
    if head.startswith(b"<"):
        cones, start, closed = _sdf(data, file)
    elif head.startswith(b"tag,"):
        cones, start, closed = _csv(as_text(data, file), file)
    else:
        cones, start, closed = _yaml(as_text(data, file), file)
    if not 2 <= len(cones) <= MAX_CONES:
        raise BrokenFile(file, f"holds {len(cones)} cones; 2 to {MAX_CONES} are possible")
    places = np.array([[x, y] for x, y, _, _ in cones])
    left, right = (places[[side == want for _, _, _, side in cones]] for want in ("left", "right"))
    if len(left) < 2 or len(right) < 2:
        raise BrokenFile(file, "has fewer than two cones on the left or on the right")
    labels = np.array([label for _, _, label, _ in cones], np.int64)
    visible = labels >= NONE
    return Track(places[visible], labels[visible], _order(left, start), right, start, closed)


def _order(border: Array, start: Array) -> Array:
    """A border from the start on: as listed where that is in order, otherwise from neighbour to neighbour."""
    gaps = np.linalg.norm(np.diff(border, axis=0), axis=1)
    if gaps.max() <= 4 * np.median(gaps) + 1e-9:
        first = int(np.linalg.norm(border - start[:2], axis=1).argmin())
        return np.roll(border, -first, axis=0)
    left = list(range(len(border)))
    ahead = start[:2] + 2.0 * np.array([math.cos(start[2]), math.sin(start[2])])
    order = [int(np.linalg.norm(border - ahead, axis=1).argmin())]
    left.remove(order[0])
    while left:
        apart = np.linalg.norm(border[left] - border[order[-1]], axis=1)
        order.append(left.pop(int(apart.argmin())))
    return border[order]


Cone = tuple[float, float, int, str]
INVISIBLE = -2


def _point(value: Any, file: Path) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) < 2 or not all(isinstance(v, int | float) for v in value[:2]):
        raise BrokenFile(file, f"{str(value)[:60]} is not a position")
    x, y = floats([str(value[0]), str(value[1])], file, 1)
    if max(abs(x), abs(y)) > 1e5:
        raise BrokenFile(file, "a cone is more than 100 km away")
    return x, y


def _yaml(text: str, file: Path) -> tuple[list[Cone], Array, bool]:
    try:
        import yaml
    except ModuleNotFoundError:
        raise TomThumbError("YAML tracks need PyYAML: pip install 'tomthumb[cones]'") from None
    try:
        if "&" in text:  # aliases of aliases may unfold without bounds, and no track has any
            raise yaml.YAMLError("anchors are not allowed")
        raw = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise BrokenFile(file, f"not YAML: {' '.join(str(error).split())[:200]}") from None
    if isinstance(raw, dict) and isinstance(raw.get("track"), dict):
        return _pacsim(raw["track"], file)
    if isinstance(raw, dict) and "cones_left" in raw:
        return _fssim(raw, file)
    raise BrokenFile(file, "neither a PacSim track (track: left, right) nor a FSSIM one (cones_left, cones_right)")


def _list(raw: dict[str, Any], key: str, file: Path) -> list[Any]:
    value = raw.get(key) or []
    if not isinstance(value, list):
        raise BrokenFile(file, f"{key} is not a list")
    return value


def _pacsim(raw: dict[str, Any], file: Path) -> tuple[list[Cone], Array, bool]:
    cones: list[Cone] = []
    for side in ("left", "right", "unknown"):
        for item in _list(raw, side, file):
            if not isinstance(item, dict):
                raise BrokenFile(file, f"{side}: an entry has no position")
            label = CLASSES.get(str(item.get("class")), INVISIBLE if item.get("class") == "invisible" else NONE)
            cones.append((*_point(item.get("position"), file), label, side))
    start = raw.get("start")
    start = start if isinstance(start, dict) else {}
    place = _point(start.get("position", [0.0, 0.0]), file)
    turn = start.get("orientation", [0.0, 0.0, 0.0])
    heading = turn[2] if isinstance(turn, list) and len(turn) == 3 and isinstance(turn[2], int | float) else 0.0
    return cones, np.array([*place, float(heading)]), bool(raw.get("lanesFirstWithLastConnected", True))


def _fssim(raw: dict[str, Any], file: Path) -> tuple[list[Cone], Array, bool]:
    kinds = (
        ("cones_left", BLUE, "left"),
        ("cones_right", YELLOW, "right"),
        ("cones_orange", ORANGE, ""),
        ("cones_orange_big", LARGE, ""),
    )
    cones = [(*_point(item, file), label, side) for key, label, side in kinds for item in _list(raw, key, file)]
    start = raw.get("starting_pose_front_wing", raw.get("starting_pose_cg", [0.0, 0.0, 0.0]))
    x, y = _point(start, file)
    heading = float(start[2]) if len(start) > 2 and isinstance(start[2], int | float) else 0.0
    return cones, np.array([x, y, heading]), _closes(cones)


def _closes(cones: list[Cone]) -> bool:
    """Whether the left border comes back near its first cone."""
    left = np.array([[x, y] for x, y, _, side in cones if side == "left"])
    return len(left) > 2 and bool(np.linalg.norm(left[0] - left[-1]) < 12.0)


def _csv(text: str, file: Path) -> tuple[list[Cone], Array, bool]:
    """EUFS and FSDS: tag,x,y,... with tags blue, yellow, orange, big_orange and car_start (its heading in column 4)."""
    cones: list[Cone] = []
    start = np.zeros(3)
    for number, line in enumerate(text.splitlines()[1:], 2):
        cells = [c.strip() for c in line.split(",")]
        if not cells[0]:
            continue
        values = floats(cells[1:4], file, number)
        if len(values) < 2:
            raise BrokenFile(file, "tag, x and y are expected", number)
        if cells[0] == "car_start":
            start = np.array([*values, 0.0][:3])
        elif cells[0] in CLASSES:
            label = CLASSES[cells[0]]
            cones.append((*_point(values, file), label, SIDES.get(label, "")))
        elif cells[0] not in ("midpoint", "unknown", "inactive"):
            raise BrokenFile(file, f"unknown tag {cells[0][:40]!r}", number)
    return cones, start, True


def _sdf(data: bytes, file: Path) -> tuple[list[Cone], Array, bool]:
    """FSSIM's Gazebo model: <include> with a <uri> of cone_blue, cone_yellow, cone_orange(_big) and a <pose>.

    Where <name> says cone_left or cone_right, that is the side; colours stay as they are (FSSIM swaps them).
    """
    from xml.etree import ElementTree

    if b"<!" in data.replace(b"<!--", b""):
        raise BrokenFile(file, "document types and entities are not allowed")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise BrokenFile(file, f"not XML: {error}") from None
    cones: list[Cone] = []
    for item in root.iter("include"):
        kind = (item.findtext("uri") or "").rsplit("/", 1)[-1].removeprefix("cone_")
        if kind not in CLASSES:
            continue
        place = floats((item.findtext("pose") or "").split()[:2], file, 1)
        name = item.findtext("name") or ""
        side = next((s for s in ("left", "right") if s in name), SIDES.get(CLASSES[kind], "") if not name else "")
        cones.append((*_point(place, file), CLASSES[kind], side))
    return cones, np.zeros(3), _closes(cones)
