"""Where a small map may lie in a large one, weighed by Bayes' rule: one scale, nats, for every place.

    log P(local map | place) - log P(local map | nothing is known there)      the `evidence` of the place
      + log of how likely its pose was beforehand, over the poses that fit as well    (Occam's factor)

Both sides count: a local landmark that finds its partner, one that has none where the old map has others, and a stone of
the old map that the robot ought to have seen and has not. Without anything known, landmarks are strewn evenly (Poisson).
Then a place is believed if it outweighs all the others together, and that nobody knows this place.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tomthumb.constellation import Fit, density
from tomthumb.geometry import compose, compose_jacobians, inverse, to_frame, to_world, wrap_angle
from tomthumb.protocols import Sensor
from tomthumb.sensing import DetectionMap
from tomthumb.types import Array, Mask

GONE = 0.1  # of the stones of a map that is in order are hidden or no more
NEW = 0.1  # of the landmarks where the old map has others are not on it
STRANGE = 1.0  # nats for a landmark that the old map lacks where it has others, in a map that may be torn
DRIFT = (0.05, 0.03)  # m, rad: that far off a filter that is all right may be, beside three standard deviations
POSES = 20  # of the trail, at least where it has so many, from which the view is drawn
FINE, MOST = 10, 100  # cells of the view to the sensor's range, and at most along one side


@dataclass(frozen=True, slots=True)
class Stones:
    """The large map: stones (n, 2) m, how likely each exists (n,), how many there are to the m2, and their tree."""

    points: Array
    exist: Array
    density: float
    tree: Any

    def cover(self, points: Array) -> Mask:
        """Points that fall where there are stones: within twice the usual spacing of one."""
        covered: Mask = self.tree.query(points)[0] < 1.0 / np.sqrt(self.density)
        return covered


def stones(points: Array, exist: Array) -> Stones:
    """The large map as it is asked for."""
    from scipy.spatial import cKDTree

    return Stones(points, exist, density(points), cKDTree(points))


@dataclass(frozen=True, slots=True)
class View:
    """Chance (a, b) that a landmark in each cell of the local plane would have been seen; cells of `cell` m from `low`."""

    low: Array
    cell: float
    chance: Array

    def at(self, points: Array) -> Array:
        """The chance (n,) at local points (n, 2); none outside."""
        at = np.floor((points - self.low) / self.cell).astype(np.int64)
        inside = ((at >= 0) & (at < self.chance.shape)).all(1)
        out = np.zeros(len(points))
        out[inside] = self.chance[tuple(at[inside].T)]
        return out


@dataclass(frozen=True, slots=True)
class Guess:
    """A pose that is believed: `weight` is the probability that it is right, within its covariance and `DRIFT`.

    `doubted`: something that is known was missed on the way there, and nothing old has been met since.
    """

    pose: Array
    cov: Array
    weight: float
    doubted: bool = False

    @property
    def firm(self) -> bool:
        """Believed rather than not: then being elsewhere is what has to be shown."""
        return self.weight > 0.5

    @property
    def may_walk_on(self) -> bool:
        """Whether new land may be just that: the robot is believed to be right, and nothing has been missed on the way."""
        return self.firm and not self.doubted

    @property
    def odds(self) -> tuple[float, float]:
        """log of the probabilities that it is right, and that it is wrong."""
        return (float(np.log(self.weight)) if self.weight > 0.0 else -np.inf), float(np.log1p(-self.weight))


@dataclass(frozen=True, slots=True)
class Local:
    """A local map: landmarks q (k, 2) m, the robot's pose (3,) in it, and what was looked at."""

    q: Array
    pose: Array
    view: View


def thinned(poses: Sequence[Array], wanted: int) -> list[Array]:
    """Every so many-th pose, the last one among them: `wanted` of them to twice as many, or all."""
    return list(poses[:: -max(1, len(poses) // wanted)][::-1])


def view(sensor: Sensor, detection: DetectionMap, trail: Sequence[Array], q: Array) -> View:
    """What was seen from the poses of the trail, by the field of view and by what the run has learned of detection."""
    poses = [sensor.frame(pose) for pose in thinned(trail, POSES)]
    at = np.array(poses)[:, :2]
    farthest = float(np.hypot(*(q[:, None] - at[None]).transpose(2, 0, 1)).min(1).max()) if len(q) else 1.0
    reach = min(sensor.max_range, 1.5 * farthest)
    low, high = at.min(0) - reach, at.max(0) + reach
    cell = max(reach / FINE, float((high - low).max()) / MOST)
    shape = np.ceil((high - low) / cell).astype(np.int64)
    points = low + cell * (np.indices(shape).reshape(2, -1).T + 0.5)
    unseen, still = np.ones(len(points)), np.full((len(points), 2), 1e-4)
    for pose, frame in zip(thinned(trail, POSES), poses, strict=True):
        near = np.flatnonzero(((points - frame[:2]) ** 2).sum(1) < reach**2)
        visible = sensor.in_view(sensor.expect(pose, points[near])[0], still[near])
        unseen[near] *= 1.0 - visible * np.minimum(detection.chance(to_frame(frame, points[near])), 0.999)
    return View(low, cell, (1.0 - unseen).reshape(tuple(shape)))


def evidence(motion: Array, fit: Fit | None, local: Local, old: Stones) -> float:
    """Nats by which the local map speaks for lying at `motion` on the old stones, with the pairs of `fit` or with none."""
    match = np.full(len(local.q), -1, np.int64) if fit is None else fit.match
    hit = match >= 0
    seen = np.minimum(local.view.at(to_world(inverse(motion), old.points)) * old.exist, 1.0 - GONE)
    met = np.zeros(len(seen), bool)
    met[match[hit]] = True
    there = old.cover(to_world(motion, local.q)) | hit
    expected = (1.0 - NEW) * float(np.count_nonzero(there))
    pairs = 0.0 if fit is None else fit.gain + float(np.log(np.maximum(seen[met], GONE)).sum())
    strange = float(np.count_nonzero(there & ~hit)) * np.log(NEW)
    return float(pairs + np.log1p(-seen[~met]).sum() + strange + expected)


def explained(fit: Fit, q: Array, trail: Sequence[Array], sensor: Sensor, old: Stones) -> float:
    """Nats by which the pairs of a fit outweigh what is missing and what is strange, by the sensor's data sheet alone.

    For places within the drift of odometry (`scout`): what they were likely beforehand is not in it.
    """
    hit, met = fit.match >= 0, np.zeros(len(old.points), bool)
    met[fit.match[hit]] = True
    chance = _seen(sensor, [compose(fit.motion, pose) for pose in trail], old.points) * old.exist
    missing = np.minimum(chance[(chance > 0.5) & ~met], 1.0 - GONE)
    there = old.cover(to_world(fit.motion, q)) | hit
    return fit.gain + float(np.log1p(-missing).sum()) - STRANGE * float(np.count_nonzero(there & ~hit))


def _seen(sensor: Sensor, poses: Iterable[Array], points: Array) -> Array:
    """Chance (n,) that each point would have been seen at least once from the poses."""
    unseen = np.ones(len(points))
    still = np.full((len(points), 2), 1e-4)
    for pose in poses:
        near = np.flatnonzero(np.hypot(*(points - sensor.frame(pose)[:2]).T) < sensor.max_range)
        if len(near):
            z_hat = sensor.expect(pose, points[near])[0]
            unseen[near] *= 1.0 - sensor.in_view(z_hat, still[near]) * sensor.detect
    return 1.0 - unseen


def weighed(found: Sequence[Fit], local: Local, old: Stones, guess: Guess) -> Array:
    """Log weights (f,) of the places: what speaks for each, and how likely it was beforehand."""
    weights = [evidence(fit.motion, fit, local, old) + np.logaddexp(*_priors(fit, local, old, guess)) for fit in found]
    return np.array(weights)


def bare(local: Local, old: Stones, guess: Guess) -> float:
    """Log weight of being where the robot believes to be, with none of what it sees there on the map."""
    return guess.odds[0] + evidence(compose(guess.pose, inverse(local.pose)), None, local, old)


def most_elsewhere(best: Fit, old: Stones, guess: Guess) -> float:
    """More than any place can weigh that is not where the robot believes to be; in `best` all landmarks have a partner."""
    return float(best.gain + (1.0 - NEW) * len(best.match) + guess.odds[1] + _occam_anywhere(best, old))


def copied(fit: Fit, share: Array, new: Mask, old: Stones, here: float) -> float:
    """Log weight of being where the robot believes to be, `here`, where the new land merely looks like that of `fit`.

    `share` (k,): what each local landmark adds to the fit's gain; `new` (k,): those that would lie where nothing is known.
    The sides of a cloister do look alike, so a robot that walks into new land is sent elsewhere only by what it sees, or
    misses, in land that it knows.
    """
    pairs = new & (fit.match >= 0)
    return here + float(share[pairs].sum() + (1.0 - NEW) * np.count_nonzero(pairs)) + _occam_anywhere(fit, old)


def _priors(fit: Fit, local: Local, old: Stones, guess: Guess) -> tuple[float, float]:
    """log of the prior of a place, over the poses that fit as well: by what is believed, and if that is wrong."""
    right, wrong = guess.odds
    return right + _occam_here(fit, local, guess), wrong + _occam_anywhere(fit, old)


def clear(places: Array, other: float, lead: float) -> int | None:
    """The place (of log weights (f,)) that outweighs the others and all else together by `lead` nats, if there is one."""
    if not len(places):
        return None
    best = int(np.argmax(places))
    rest = np.logaddexp.reduce(np.append(np.delete(places, best), other))
    return best if places[best] - rest >= lead else None


def _occam_anywhere(fit: Fit, old: Stones) -> float:
    """log of the share of all poses in the mapped plane that fit as well."""
    poses = len(old.points) / old.density * 2.0 * np.pi
    return float(min(1.5 * np.log(2.0 * np.pi) + 0.5 * np.linalg.slogdet(fit.cov)[1] - np.log(poses), 0.0))


def _occam_here(fit: Fit, local: Local, guess: Guess) -> float:
    """The same where the poses are those that the robot believes in: of the robot, not of the origin of its local map."""
    gap = compose(fit.motion, local.pose) - guess.pose
    gap[2] = wrap_angle(gap[2])
    by_fit = compose_jacobians(fit.motion, local.pose)[0]
    cov = by_fit @ fit.cov @ by_fit.T
    metres, radians = DRIFT
    spread = 9.0 * guess.cov + np.diag([metres, metres, radians]) ** 2 + cov
    volume = 0.5 * (np.linalg.slogdet(cov)[1] - np.linalg.slogdet(spread)[1])
    return float(min(volume, 0.0) - 0.5 * gap @ np.linalg.solve(spread, gap))
