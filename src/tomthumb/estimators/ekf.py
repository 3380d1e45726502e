"""EKF-SLAM: one Gaussian over the pose and the landmarks, with the usual or the right-invariant error.

Covariance. Only the lower triangle is kept, so it cannot become asymmetric. An update subtracts W W' (W = P H' L^-T,
L L' = S) in one pass, with S computed from the same P; S that is not positive definite, a negative variance or a value
that is not finite is named: `Diverged`.

Update. Iterated (Gauss-Newton) until the linearisation error is below `tolerance` of the sensor's noise; one iteration
is enough most of the time and then costs one more evaluation of the sensor. Pairings with crumbs are Schmidt updates:
the crumb learns from the pose, never the other way round.

Invariant error. xi = (p - R(e) p_hat, e, l - R(e) l_hat), e the error of the heading. It stays Gaussian where the usual
one bends, and a turn of the whole map stays unobservable whatever the estimate. What is stored is the covariance of the
usual error delta = T(x_hat) xi, T = I + J x_hat e': its prediction is then the usual one, linear in the number of
landmarks, and an update that moves x_hat by `change` leaves xi's covariance as it is, so that
P <- (I + v e') P (I + v e')' with v = J change (J turns the position and every landmark by 90 deg).

Maps of more than `local` landmarks are worked on by regions (`estimators.local`), to the same result.

References: R. Smith, M. Self, P. Cheeseman, 1990; B. Bell, F. Cathey, IEEE T-AC 38(2), 1993 (iterated update is
Gauss-Newton); S. Schmidt, 1966 (considered states); A. Barrau, S. Bonnabel, "An EKF-SLAM algorithm with consistency
properties", arXiv:1510.06263, 2015, sec. 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.estimators import gaussian, local
from tomthumb.estimators.core import Core
from tomthumb.estimators.local import Atlas
from tomthumb.kernels import storage
from tomthumb.protocols import Motion, Rng, Sensor
from tomthumb.types import Array, Control, Estimate, Ids, Observations, Predictions


@dataclass(frozen=True)
class EKF:
    """The filter's settings.

    `invariant`: right-invariant error. `iterations` at most; `fixed` runs exactly that many. `faithful`: the reference
    program's filter, four fixed iterations with the usual error. `outliers`: pairings whose own d2 passes this
    chi-square probability are left out of the update (0: none are). `local`: maps of more landmarks are worked on by
    regions that reach `margin` times the sensor's range beyond it and hold `crowd` times the square root of the map's
    number (0: never). `calibrate` names systematic errors of the odometry that are estimated as states
    (`models.calibration`), with prior standard deviations `calibrate_std`.
    Raises `TomThumbError` for settings that cannot be.
    """

    motion: Motion
    sensor: Sensor
    invariant: bool = False
    iterations: int = 10
    fixed: bool = False
    tolerance: float = 0.02
    faithful: bool = False
    outliers: float = 0.0
    local: int = 200
    margin: float = 1.0
    crowd: float = 2.0
    calibrate: tuple[str, ...] = ()
    calibrate_std: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _check(self)

    @cached_property
    def core(self) -> Core:
        """The filter over one `Gaussian`."""
        e = replace(self, invariant=False, iterations=4, fixed=True) if self.faithful else self
        return Core(
            e.motion, e.sensor, e.invariant, e.iterations, e.fixed, e.tolerance, e.outliers,
            tuple(e.calibrate), tuple(e.calibrate_std),
        )  # fmt: skip

    def init(self, pose: Array, cov: Array, rng: Rng) -> Atlas:
        """See `protocols.Estimator`."""
        return Atlas(self.core.begin(pose, cov))

    def fork(self, belief: Atlas) -> Atlas:
        """See `protocols.Estimator`."""
        return local.copy(belief)

    def predict(self, belief: Atlas, control: Control, rng: Rng) -> Atlas:
        """See `protocols.Estimator`."""
        self.core.predict(belief.active, control)
        if self.local and len(belief.whole.ids) > self.local:
            local.settle(belief, self.sensor, self.margin, self.crowd, self.invariant and not self.faithful)
        return belief

    def expect(self, belief: Atlas) -> Sequence[Predictions]:
        """See `protocols.Estimator`."""
        return [self.core.expect(belief.active)]

    def update(self, belief: Atlas, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Atlas:
        """See `protocols.Estimator`. Raises `Diverged`."""
        local.bring(belief, [int(i) for i in ids[0] if i >= 0])
        self.core.update(belief.active, observations, ids[0])
        return belief

    def add(self, belief: Atlas, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Atlas:
        """See `protocols.Estimator`."""
        self.core.add(belief.active, observations, ids[0])
        return belief

    def place(self, belief: Atlas, ids: Ids, landmarks: Array, covs: Array) -> Atlas:
        """See `protocols.Estimator`."""
        self.core.place(belief.active, ids, landmarks, covs)
        return belief

    def promote(self, belief: Atlas, ids: Ids) -> Atlas:
        """See `protocols.Estimator`."""
        return _marked(belief, ids, True)

    def doubt(self, belief: Atlas, ids: Ids) -> Atlas:
        """See `protocols.Estimator`."""
        return _marked(belief, ids, False)

    def forget(self, belief: Atlas, ids: Ids) -> Atlas:
        """See `protocols.Estimator`."""
        for i in ids.tolist():
            local.forget(belief, i)
        return belief

    def merge(self, belief: Atlas, keep: int, drop: int) -> Atlas:
        """See `protocols.Estimator`. Between two stones the constraint moves the pose; a crumb is just dropped."""
        local.bring(belief, [keep, drop])
        self.core.unite(belief.active, keep, drop)
        local.forget(belief, drop)
        return belief

    def relocate(self, belief: Atlas, pose: Array, cov: Array) -> Atlas:
        """See `protocols.Estimator`. Calibration states keep what they know."""
        local.leave(belief)
        whole = belief.whole
        whole.x[:3] = pose
        whole.P[:3, :3] = cov
        whole.P[3 : whole.dim, :3] = 0.0
        return belief

    def pose(self, belief: Atlas) -> tuple[Array, Array]:
        """See `protocols.Estimator`."""
        active = belief.active
        return active.pose.copy(), storage.pose_block(active.P)

    def estimate(self, belief: Atlas) -> Estimate:
        """See `protocols.Estimator`."""
        local.leave(belief)
        return gaussian.estimate(belief.whole)

    def calibration(self, belief: Atlas) -> dict[str, tuple[float, float]]:
        """The estimated systematic errors by name: value and standard deviation."""
        return self.core.calibration(belief.active)

    def stats(self, belief: Atlas) -> dict[str, Any]:
        """See `protocols.Estimator`."""
        return belief.active.stats


InvariantEKF = partial(EKF, invariant=True)
"""`EKF` with the right-invariant error; the settings are the same."""


def _check(e: EKF) -> None:
    from tomthumb.models.calibration import check

    if e.iterations < 1:
        raise TomThumbError(f"iterations={e.iterations}: at least 1")
    if not 0.0 < e.tolerance < np.inf:
        raise TomThumbError(f"tolerance={e.tolerance}: more than 0, in standard deviations of the sensor's noise")
    if not 0.0 <= e.outliers < 1.0:
        raise TomThumbError(f"outliers={e.outliers}: a probability below 1 (0: keep all)")
    if e.local < 0 or not e.margin > 0.0 or not e.crowd >= 0.0:
        raise TomThumbError(
            f"local={e.local}, margin={e.margin}, crowd={e.crowd}: a number of landmarks (0: never), more than 0, and 0 or more"
        )
    if len(e.calibrate) != len(e.calibrate_std):
        raise TomThumbError(f"calibrate names {len(e.calibrate)} errors and calibrate_std {len(e.calibrate_std)}")
    check(e.motion, e.calibrate, e.calibrate_std)


def _marked(belief: Atlas, ids: Ids, stone: bool) -> Atlas:
    """Stones or crumbs, in every part that holds them."""
    for i in ids.tolist():
        for part in belief.parts:
            if i in part.slot:
                part.stone[part.slot[i]] = stone
    return belief
