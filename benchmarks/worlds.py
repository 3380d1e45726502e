"""Worlds that the estimators' benchmarks share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tomthumb.geometry import rotation
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.cloister import cloister
from tomthumb.scenarios.simulate import Eye, Streams, path, scans
from tomthumb.types import Control, Observations, Prior, Scenario, Step, Truth

EYE = Eye(6.0, math.pi, range_std=0.1, bearing_std=math.radians(2.0))
STD = np.array([0.02, 0.02, math.radians(1.0)])  # of an increment of 0.5 m, or of a turn by 15 deg


def loop(rng: np.random.Generator, *, odometry_noise: float = 1.0, laps: int = 2) -> Scenario:
    """A square way of 120 m between two rows of landmarks 1.5 m apart, with a coarse range-bearing sensor."""
    streams = Streams.of(rng)
    side = np.vstack([np.tile([0.5, 0.0, 0.0], (60, 1)), np.tile([0.0, 0.0, math.pi / 12], (6, 1))])
    motions = np.tile(side, (4 * laps, 1))
    poses = path(np.zeros(3), list(motions))
    std = odometry_noise * STD
    readings = motions + std * streams.odometry.standard_normal(motions.shape)
    controls = [None, *(Control(u, 1.0, np.diag(std**2)) for u in readings)]
    landmarks = rows()
    seen = scans(EYE, poses, landmarks, streams, np.empty((len(poses), 0, 2)))
    steps = [
        Step(float(k), c, z, Truth(p, i)) for k, (c, p, (z, i)) in enumerate(zip(controls, poses, seen, strict=True))
    ]
    sensor = RangeBearing(max_range=EYE.max_range, fov=EYE.fov, detect=0.99, clutter=EYE.clutter_density)
    return Scenario("loop", OdometryIncrement(), sensor, Prior(np.zeros(3), np.zeros((3, 3))), steps, landmarks)


def ring(rng: np.random.Generator, *, scale: float = 1.03, turn: float = 0.0008, laps: float = 1.4) -> Scenario:
    """A ring of 110 posts walked round, 94 m a lap, by an odometer that is wrong by `scale` and `turn` (rad a step of .4 m).

    It is sure of itself (1 cm, .06 deg a step), so that scan by scan the loop is missed.
    """
    radius, stride, std = 15.0, 0.4, np.array([0.01, 0.01, 0.001])
    sensor = RangeBearing(max_range=6.0, fov=2.0 * np.pi, std=(0.05, 0.01), detect=0.9, clutter=0.0)
    angle, away = 2.0 * np.pi * rng.random(110), radius + rng.uniform(-4.0, 4.0, 110)
    posts = away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    motion = np.array([stride, 0.0, stride / radius])
    poses = path(np.array([radius, 0.0, np.pi / 2]), [motion] * (int(laps * 2.0 * np.pi * radius / stride) - 1))
    steps = [Step(0.0, None, None, Truth(poses[0], None))]
    for k, pose in enumerate(poses[1:], 1):
        told = motion * [scale, 1.0, 1.0] + [0.0, 0.0, turn] + std * rng.standard_normal(3)
        seen = np.flatnonzero((np.hypot(*(posts - pose[:2]).T) < sensor.max_range) & (rng.random(len(posts)) < 0.9))
        z = sensor.expect(pose, posts[seen])[0] + sensor.std * rng.standard_normal((len(seen), 2))
        scan = Observations(z, np.tile(np.diag(np.square(sensor.std)), (len(seen), 1, 1)))
        steps.append(Step(float(k), Control(told, 1.0, np.diag(std**2)), scan, Truth(pose, seen)))
    return Scenario("ring", OdometryIncrement(), sensor, Prior(poses[0], 1e-8 * np.eye(3)), steps, posts)


def rows() -> np.ndarray:
    """Two rows of landmarks a side, 1.5 m apart, 1.5 m left and right of the way."""
    along = np.arange(0.0, 30.0 + 1e-9, 1.5)
    side = np.vstack(
        [np.column_stack([along, np.full(len(along), -1.5)]), np.column_stack([along + 0.7, np.full(len(along), 1.5)])]
    )
    sides = [side]
    for _ in range(3):
        sides.append(sides[-1] @ rotation(math.pi / 2).T + [30.0, 0.0])
    return np.vstack(sides)


def true_noise_cloister(rng: np.random.Generator, *, odometry_noise: float = 1.0, laps: int = 2) -> Scenario:
    """The cloister with the filter told the true noise of the odometry, not twice its variance as in the reference."""
    world = cloister(rng, laps=laps, odometry_noise=odometry_noise)
    steps = [
        s if s.control is None else replace(s, control=replace(s.control, cov=0.5 * s.control.cov)) for s in world.steps
    ]
    return replace(world, steps=steps)
