"""Simulated worlds of any size: a square corridor and a random field. For the paper's own world see `cloister`."""

from __future__ import annotations

import math

import numpy as np

from tomthumb.geometry import rotation, wrap_angle
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.simulate import DETECT_CAP, Eye, Streams, path, require, scans
from tomthumb.types import Array, Control, Prior, Scenario, Step, Truth

MAX_LANDMARKS = 1_000_000


def square(
    rng: np.random.Generator,
    *,
    size: float = 20.0,
    spacing: float = 2.0,
    corridor: float = 1.0,
    laps: int = 1,
    teach: int = 0,
    step: float = 0.5,
    max_range: float = 5.0,
    fov: float = math.pi,
    range_std: float = 0.05,
    bearing_std: float = math.radians(0.5),
    odometry_noise: float = 1.0,
    clutter: float = 0.0,
    detect: float = 1.0,
) -> Scenario:
    """A square corridor of side `size` m, walked left-handed `laps` times in steps of `step` m and turns of 10 deg.

    Landmarks stand every `spacing` m, `corridor` m to the left and to the right of the path, each moved at random by up
    to a quarter of either. Sensor: range m and bearing rad with constant stds, `max_range` m, `fov` rad; `clutter` a
    mean per scan, `detect` a probability. Odometry std: 3 % of the way along, 1.5 % aside, 0.5 deg a step, times
    `odometry_noise`. The first `teach` laps are taught and not scored. Raises TomThumbError for values out of range.
    """
    require(0.0 < step <= size <= 1e5, f"square: size={size}, step={step}: 0 < step <= size <= 100000 m")
    require(0.0 < spacing <= size, f"square: spacing={spacing}: more than 0, at most size, m")
    require(8 * size / spacing <= MAX_LANDMARKS, f"square: spacing={spacing}: more than {MAX_LANDMARKS} landmarks")
    require(0.0 <= corridor <= size / 2, f"square: corridor={corridor}: 0 to size / 2, m")
    require(0 <= teach < laps <= 10_000, f"square: laps={laps}, teach={teach}: 0 <= teach < laps <= 10000")
    streams = Streams.of(rng)
    moves = round(size / step)
    side = np.vstack([np.tile([size / moves, 0.0, 0.0], (moves, 1)), np.tile([0.0, 0.0, math.pi / 18], (9, 1))])
    lap = 4 * len(side)
    eye = _eye("square", max_range, fov, range_std, bearing_std, clutter, detect)
    landmarks = _corridor(size, spacing, corridor, streams.layout)
    motions = np.tile(side, (4 * laps, 1))[:-1]
    return _scenario("square", eye, landmarks, motions, odometry_noise, streams, teach * lap)


def random(
    rng: np.random.Generator,
    *,
    landmarks: int = 100,
    density: float = 0.0,
    size: float = 50.0,
    min_gap: float = 0.0,
    steps: int = 500,
    step: float = 0.5,
    max_range: float = 10.0,
    fov: float = math.pi,
    range_std: float = 0.05,
    bearing_std: float = math.radians(0.5),
    odometry_noise: float = 1.0,
    clutter: float = 0.0,
    detect: float = 1.0,
) -> Scenario:
    """A field of `size` x `size` m with `landmarks` points (or `density` per m2, if above 0), driven through at random.

    The robot heads for one random place after the other with at most 15 deg a step, `steps` steps of `step` m. No two
    landmarks are nearer than `min_gap` m (those that would be are left out). Sensor and odometry as in `square`.

    Raises TomThumbError for values out of range.
    """
    count = round(density * size**2) if density > 0.0 else landmarks
    require(0.0 < size <= 1e6, f"random: size={size}: more than 0, at most 1000000 m")
    require(0 <= count <= MAX_LANDMARKS, f"random: {count} landmarks: 0 to {MAX_LANDMARKS}")
    require(0.0 <= min_gap < size, f"random: min_gap={min_gap}: 0 to size, m")
    require(1 <= steps <= 1_000_000, f"random: steps={steps}: 1 to 1000000")
    require(0.0 < step <= size, f"random: step={step}: more than 0, at most size, m")
    streams = Streams.of(rng)
    eye = _eye("random", max_range, fov, range_std, bearing_std, clutter, detect)
    field = _thin(size * streams.layout.random((count, 2)) - size / 2, min_gap)
    motions = _wander(steps - 1, step, size, streams.jitter)
    return _scenario("random", eye, field, motions, odometry_noise, streams, 0)


def _eye(
    name: str, max_range: float, fov: float, range_std: float, bearing_std: float, clutter: float, detect: float
) -> Eye:
    require(0.0 < max_range < math.inf, f"{name}: max_range={max_range}: more than 0 m")
    require(0.0 < fov <= 2 * math.pi, f"{name}: fov={fov}: more than 0, at most 2 pi rad")
    require(range_std > 0.0, f"{name}: range_std={range_std}: more than 0 m")
    require(bearing_std > 0.0, f"{name}: bearing_std={bearing_std}: more than 0 rad")
    require(0.0 <= clutter < 1e4, f"{name}: clutter={clutter}: a mean per scan, 0 to 10000")
    require(0.0 < detect <= 1.0, f"{name}: detect={detect}: a probability above 0, at most 1")
    return Eye(max_range, fov, range_std=range_std, bearing_std=bearing_std, clutter=clutter, detect=detect)


def _corridor(size: float, spacing: float, corridor: float, rng: np.random.Generator) -> Array:
    x = np.arange(spacing / 2, size, spacing)
    side = np.vstack([np.column_stack([x, np.full(len(x), y)]) for y in (-corridor, corridor)])
    centre = np.array([size / 2, size / 2])
    sides = [(side - centre) @ rotation(k * math.pi / 2).T + centre for k in range(4)]
    places = np.vstack(sides)
    jitter: Array = (rng.random(places.shape) - 0.5) * min(spacing, 2 * corridor) / 2
    return places + jitter


def _thin(points: Array, gap: float) -> Array:
    """The points without those nearer than `gap` m to one kept before them."""
    if gap <= 0.0 or len(points) < 2:
        return points
    from scipy.spatial import cKDTree

    close = cKDTree(points).query_pairs(gap, output_type="ndarray")
    keep = np.ones(len(points), bool)
    for i, j in close[np.lexsort((close[:, 1], close[:, 0]))]:
        keep[j] &= not keep[i]
    return points[keep]


def _wander(motions: int, step: float, size: float, rng: np.random.Generator) -> Array:
    """Motions (n, 3) from the middle towards one random place after the other."""
    limit, reach = math.radians(15.0), max(2 * step, step / math.radians(15.0))
    x = y = heading = 0.0
    goal = (rng.random(2) - 0.5) * 0.9 * size
    out = np.zeros((motions, 3))
    for k in range(motions):
        if math.hypot(goal[0] - x, goal[1] - y) < reach:
            goal = (rng.random(2) - 0.5) * 0.9 * size
        turn = wrap_angle(math.atan2(goal[1] - y, goal[0] - x) - heading)
        turn = min(max(turn, -limit), limit)
        out[k] = step, 0.0, turn
        x, y = x + step * math.cos(heading), y + step * math.sin(heading)
        heading = wrap_angle(heading + turn)
    return out


def _scenario(
    name: str, eye: Eye, landmarks: Array, motions: Array, multiplier: float, streams: Streams, teach: int
) -> Scenario:
    require(0.0 <= multiplier < math.inf, f"{name}: odometry_noise={multiplier}: 0 or more")
    poses = path(np.zeros(3), list(motions))
    seen = scans(eye, poses, landmarks, streams, np.empty((len(poses), 0, 2)))
    way = np.abs(motions[:, 0])
    stds = multiplier * np.column_stack([0.03 * way + 1e-3, 0.015 * way + 1e-3, np.full(len(way), math.radians(0.5))])
    readings = motions + stds * streams.odometry.standard_normal(motions.shape)
    controls = [None, *(Control(u, 1.0, np.diag(std**2)) for u, std in zip(readings, stds, strict=True))]
    return Scenario(
        name=name,
        motion=OdometryIncrement(),
        sensor=RangeBearing(
            max_range=eye.max_range,
            fov=eye.fov,
            std=(eye.range_std, eye.bearing_std),
            detect=min(eye.detect, DETECT_CAP),
            clutter=eye.clutter_density,
        ),
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        steps=[
            Step(float(k), control, z, Truth(pose, ids))
            for k, (control, pose, (z, ids)) in enumerate(zip(controls, poses, seen, strict=True))
        ],
        landmarks=landmarks,
        score_from=max(1, teach),
        teach_steps=teach,
    )
