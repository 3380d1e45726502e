"""What a motion model, a sensor, an associator and an estimator must offer. Nothing is inherited; shapes are the contract."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from tomthumb.types import (
    Array,
    Association,
    AssociationProblem,
    Control,
    Estimate,
    Ids,
    Lessons,
    Observations,
    Predictions,
)

Rng = np.random.Generator
Belief = TypeVar("Belief")


class Motion(Protocol):
    """A motion model gives the robot's relative motion; how it adds to the pose is the same for all of them."""

    @property
    def rates(self) -> bool:
        """True when `u` is per second (velocities), False when it is an amount (increments)."""
        ...

    def increment(self, control: Control) -> tuple[Array, Array]:
        """The motion (3,) in the robot's frame before it [m, m, rad], and its covariance (3, 3)."""
        ...


class Sensor(Protocol):
    """A sensor that sees points: predicts them, locates them, and says what it can see."""

    @property
    def angles(self) -> tuple[int, ...]:
        """The components of z that are angles and wrap."""
        ...

    @property
    def detect(self) -> float:
        """Probability of detecting a landmark well inside the field of view."""
        ...

    @property
    def max_range(self) -> float:
        """Farthest landmark it can see, m."""
        ...

    def frame(self, pose: Array) -> Array:
        """The sensor's own pose (3,) in the world when the robot is at `pose`."""
        ...

    def expect(self, pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        """z_hat (n, 2) of world points (n, 2), with derivatives by the pose (n, 2, 3) and by the landmark (n, 2, 2)."""
        ...

    def locate(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """World points (m, 2) of observations, with derivatives by the pose (m, 2, 3) and by z (m, 2, 2)."""
        ...

    def in_view(self, z_hat: Array, var: Array) -> Array:
        """Probability (n,) that a point predicted at `z_hat` with variances `var (n, 2)` is in the field of view."""
        ...

    @property
    def clutter(self) -> float:
        """False observations per m2 of the plane and scan."""
        ...

    @property
    def fov(self) -> float:
        """Full opening angle, rad."""
        ...

    @property
    def memory(self) -> tuple[float, float]:
        """Path, m, over which the error of each component of z repeats itself; 0 where every scan errs anew."""
        ...

    def scale(self, z: Array) -> Array:
        """m2 of the plane per unit of z at each z (m,): turns a density per m2 into one per unit of z."""
        ...


class Associator(Protocol):
    """Names the observations. Returns hypotheses, best first, with log weights; most return one."""

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]: ...

    def learn(self, ids: Ids, t: float) -> None:
        """The confirmed landmarks that were seen in a step; most associators do nothing with them."""
        ...


@runtime_checkable
class Learner(Protocol):
    """What an associator offers besides if its lessons can be saved with a map and taught to another."""

    def recall(self, ids: Ids) -> Lessons | None:
        """What was learned about the landmarks `ids`; None where nothing is."""
        ...

    def remind(self, lessons: Lessons) -> None:
        """Begin with these lessons instead of what was learned so far."""
        ...


class Estimator(Protocol[Belief]):
    """Belief in, belief out. The one passed in is spent (its arrays may be reused); `fork` copies."""

    def init(self, pose: Array, cov: Array, rng: Rng) -> Belief: ...

    def fork(self, belief: Belief) -> Belief: ...

    def predict(self, belief: Belief, control: Control, rng: Rng) -> Belief: ...

    def expect(self, belief: Belief) -> Sequence[Predictions]:
        """One `Predictions` for the belief, or one for each of its particles, of landmarks near enough to be seen."""
        ...

    def update(self, belief: Belief, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Belief:
        """Pairings with stones move the pose; those with crumbs move the crumb only. `ids`: one (m,) for each of `expect`."""
        ...

    def add(self, belief: Belief, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Belief:
        """New landmarks, as crumbs, where the observations (m) point; ids -1 are passed over."""
        ...

    def place(self, belief: Belief, ids: Ids, landmarks: Array, covs: Array) -> Belief:
        """Known landmarks, as stones: world points (n, 2) with covariances (n, 2, 2), independent of the pose."""
        ...

    def promote(self, belief: Belief, ids: Ids) -> Belief:
        """Crumbs become stones: from now on they move the pose."""
        ...

    def doubt(self, belief: Belief, ids: Ids) -> Belief:
        """Stones become crumbs again: what they have told the pose stays, and they tell it no more."""
        ...

    def forget(self, belief: Belief, ids: Ids) -> Belief: ...

    def merge(self, belief: Belief, keep: int, drop: int) -> Belief:
        """Two landmarks are one: the constraint l_keep = l_drop is applied and `drop` forgotten."""
        ...

    def relocate(self, belief: Belief, pose: Array, cov: Array) -> Belief:
        """The robot stands elsewhere: pose (3,) with covariance (3, 3), which owe nothing to the map."""
        ...

    def pose(self, belief: Belief) -> tuple[Array, Array]:
        """The robot's pose (3,) and its covariance (3, 3), copied."""
        ...

    def estimate(self, belief: Belief) -> Estimate: ...

    def stats(self, belief: Belief) -> dict[str, Any]:
        """Of the last update: nis, dof, iterations."""
        ...
