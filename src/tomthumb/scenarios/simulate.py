"""What the simulated worlds share: a field of view, noisy scans of points, and random streams apart from one another.

Every draw is made for every landmark at every step, seen or not, so that an option (a missed detection, say) changes
only what it says and leaves all other noise as it was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.geometry import compose, to_frame
from tomthumb.types import NONE, Array, Ids, Mask, Observations

CLUTTER_FLOOR = 1e-3  # per m2 and scan: what a sensor model should allow for even where the world holds no clutter
DETECT_CAP = 0.99  # nor should it trust any sensor blindly
POST_RADIUS = 0.05  # m, half the width of what hides the things behind it
EDGE = 1e-9  # rad: a point exactly on the border of the field of view is seen, whatever the rounding


@dataclass(frozen=True, slots=True)
class Streams:
    """One random generator for each cause of randomness."""

    odometry: np.random.Generator
    sensor: np.random.Generator
    people: np.random.Generator
    clutter: np.random.Generator
    detection: np.random.Generator
    jitter: np.random.Generator
    layout: np.random.Generator

    @classmethod
    def of(cls, rng: np.random.Generator) -> Streams:
        """Seven independent children of `rng`."""
        return cls(*rng.spawn(7))


@dataclass(frozen=True, slots=True)
class Eye:
    """What a simulated sensor can see, and how well.

    Range std is `range_std` m + `range_share` x range; `fov` rad is the full opening angle about straight ahead.
    `clutter` is the mean number of false observations a scan, `detect` the chance of seeing a landmark in view. With
    `cartesian` the observations are points (x m, y m), otherwise (range m, bearing rad).
    """

    max_range: float
    fov: float
    range_std: float = 0.0
    range_share: float = 0.0
    bearing_std: float = math.radians(1.0)
    detect: float = 1.0
    clutter: float = 0.0
    occlusion: bool = False
    cartesian: bool = False

    @property
    def area(self) -> float:
        """The field of view, m2."""
        return 0.5 * min(self.fov, 2 * math.pi) * self.max_range**2

    @property
    def clutter_density(self) -> float:
        """What to tell the sensor model: false observations per m2 and scan."""
        return max(self.clutter / self.area, CLUTTER_FLOOR)

    def std(self, r: Array) -> Array:
        """Standard deviations (m, 2) of range m and bearing rad of points at ranges `r (m,)`."""
        return np.column_stack([self.range_std + self.range_share * r, np.full(len(r), self.bearing_std)])


def require(good: bool, what: str) -> None:
    """Raise `TomThumbError(what)` unless `good`."""
    if not good:
        raise TomThumbError(what)


def polar(points: Array) -> Array:
    """Range m and bearing rad (m, 2) of points (m, 2) in the sensor's frame."""
    return np.column_stack([np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])])


def in_view(eye: Eye, z: Array, edge: float = EDGE) -> Mask:
    """Which of the points `z (m, 2)` (range, bearing) are in the field of view (m,), opened by `edge` rad a side."""
    seen: Mask = np.asarray((z[:, 0] < eye.max_range) & (np.abs(z[:, 1]) <= eye.fov / 2 + edge))
    return seen


def hidden(z: Array, radius: float = POST_RADIUS) -> Mask:
    """Which of the points `z (m, 2)` (range, bearing) have a nearer one in their line of sight (m,).

    A nearer point at range r hides all within asin(radius / r) of its bearing.
    """
    r, b = z[:, 0], z[:, 1]
    half = np.arcsin(np.minimum(radius / np.maximum(r, radius), 1.0))
    apart = np.abs((b[:, None] - b[None] + math.pi) % (2 * math.pi) - math.pi)
    covers = (apart < half[None]) & (r[None] < r[:, None])
    behind: Mask = np.asarray(covers.any(1))
    return behind


def covariance(eye: Eye, z: Array) -> Array:
    """R (m, 2, 2) at the places `z (m, 2)` (range, bearing), in the units the eye hands over."""
    std = eye.std(z[:, 0])
    if not eye.cartesian:
        return np.apply_along_axis(np.diag, 1, std**2) if len(z) else np.empty((0, 2, 2))
    c, s, r = np.cos(z[:, 1]), np.sin(z[:, 1]), z[:, 0]
    J = np.stack([np.stack([c, -r * s], -1), np.stack([s, r * c], -1)], -2)
    R: Array = np.einsum("mij,mj,mkj->mik", J, std**2, J)
    return (R + R.swapaxes(1, 2)) / 2


def hand_over(eye: Eye, true: Array, noise: Array) -> Observations:
    """The observations of points truly at `true (m, 2)` (range, bearing) with standard normal `noise (m, 2)`.

    R belongs to the true place, as in the reference simulator.
    """
    z = true + eye.std(true[:, 0]) * noise
    z[:, 0] = np.maximum(z[:, 0], 1e-6)
    if eye.cartesian:
        z = np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])
    else:
        z[:, 1] = (z[:, 1] + math.pi) % (2 * math.pi) - math.pi
    return Observations(z, covariance(eye, true))


def clutter_places(eye: Eye, rng: np.random.Generator) -> Array:
    """Places (k, 2) (range, bearing) of one scan's false observations: Poisson in number, uniform over the view."""
    k = rng.poisson(eye.clutter)
    r = eye.max_range * np.sqrt(rng.random(k))
    b = eye.fov * (rng.random(k) - 0.5)
    return np.column_stack([r, b])


def path(start: Array, increments: Sequence[Array]) -> Array:
    """The poses (k + 1, 3) that `increments` lead through from `start`."""
    poses = [np.asarray(start, float)]
    for delta in increments:
        poses.append(compose(poses[-1], delta))
    return np.array(poses)


def scans(
    eye: Eye, poses: Array, landmarks: Array, streams: Streams, people: Array, edges: Array | None = None
) -> list[tuple[Observations, Ids]]:
    """One scan at each of the poses (K, 3), with true ids.

    Landmarks (n, 2) come first in their order, then people (K, p, 2), then clutter; the last two have id -1.
    `edges (K,)` rad opens the field of view at each pose by so much.
    """
    out = []
    edges = np.full(len(poses), EDGE) if edges is None else edges
    ids = np.concatenate([np.arange(len(landmarks)), np.full(people.shape[1], NONE)])
    for pose, crowd, edge in zip(poses, people, edges, strict=True):
        z = polar(to_frame(pose, np.vstack([landmarks, crowd])))
        noise = np.vstack([_normal(streams.sensor, len(landmarks)), _normal(streams.people, len(crowd))])
        chance = np.concatenate([streams.detection.random(len(landmarks)), streams.people.random(len(crowd))])
        seen = in_view(eye, z, edge) & (chance < eye.detect)
        if eye.occlusion:
            seen &= ~hidden(z)
        false = clutter_places(eye, streams.clutter)
        noise = np.vstack([noise[seen], _normal(streams.clutter, len(false))])
        found = hand_over(eye, np.vstack([z[seen], false]), noise)
        out.append((found, np.concatenate([ids[seen], np.full(len(false), NONE)])))
    return out


def _normal(rng: np.random.Generator, n: int) -> Array:
    return rng.standard_normal((n, 2))
