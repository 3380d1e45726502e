"""FastSLAM 2.0: particles for the pose, and for each a map of independent small Gaussians and its own association.

Between scans a particle's pose is a Gaussian (mean, covariance) that the odometry moves; the scan sharpens it, a pose
is drawn from it, the particle is weighed by the likelihood of the scan before the drawing, and the landmarks are
updated at the drawn pose. With `version` 1 the pose is drawn from the odometry alone. Pairings with crumbs update the
crumb and count as unexplained, so they neither move nor weigh the particle. Stones in view that were not seen count
against it.

A particle cannot take back what it once believed, as a filter with cross-covariances can. Bearings that err alike from
scan to scan turn its map for good, so they must not count as news: `estimators.echo` measures that, `whiten` heeds it.

Particles are resampled before the next motion, so that ids given for each particle fit from `expect` to `add`; the
heaviest is always the first.

References: M. Montemerlo, S. Thrun, D. Koller, B. Wegbreit, "FastSLAM 2.0", IJCAI 2003, eq. 8 to 20; M. Montemerlo,
"FastSLAM", PhD thesis, CMU 2003, sec. 3.5 (negative evidence) and 3.7 (shared maps).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import chdtri

from tomthumb import geometry
from tomthumb.errors import Diverged, TomThumbError
from tomthumb.estimators import echo, mixture, pages
from tomthumb.estimators.echo import Echo
from tomthumb.estimators.pages import Pages
from tomthumb.kernels import fastslam as kernel
from tomthumb.kernels import particles
from tomthumb.protocols import Motion, Rng, Sensor
from tomthumb.types import Array, Control, Estimate, Ids, Mask, Observations, Predictions

UNSEEN = 1e-4
ORIGIN = np.zeros(3)


@dataclass(slots=True)
class Particles:
    """Poses (M, 3), their covariances before the scan (M, 3, 3), log weights (M,), and the maps."""

    pose: Array
    cov: Array
    log_weight: Array
    maps: Pages
    view: View | None = None
    echo: Echo = field(default_factory=Echo)
    named: Ids = field(default_factory=lambda: np.empty((0, 0), np.int64))
    stats: dict[str, Any] = field(default_factory=lambda: {"nis": 0.0, "dof": 0, "iterations": 0})

    def weights(self) -> Array:
        """Normalised weights (M,)."""
        w = np.exp(self.log_weight - self.log_weight.max())
        normal: Array = w / w.sum()
        return normal


@dataclass(frozen=True, slots=True)
class View:
    """What all particles expect of the landmarks `slots` (c,): arrays (M, c, ...), everything in the robot's frame."""

    slots: Ids
    points: Array
    spread: Array
    there: Mask
    z_hat: Array
    H: Array
    C: Array
    Hx: Array
    chance: Array


@dataclass(frozen=True)
class FastSLAM:
    """`particles` many; `version` 2 or 1; resampled when the effective number falls below `resample` of them.

    `iterations` of the proposal's linearisation. `density`: observations per m2 and scan that no stone explains;
    `negative`: stones in view that are not seen count. `whiten`: the noise of angles is raised as far as their residuals
    repeat themselves. `quick`: the associator names the scan for the heaviest particle alone, the others name it by
    maximum likelihood within `gate`, all in one kernel. Raises `TomThumbError` for settings that cannot be.
    """

    motion: Motion
    sensor: Sensor
    particles: int = 100
    version: int = 2
    resample: float = 0.5
    iterations: int = 2
    density: float = 0.3
    negative: bool = True
    whiten: bool = True
    quick: bool = False
    gate: float = 0.999

    def __post_init__(self) -> None:
        if not 0.0 < self.gate < 1.0:
            raise TomThumbError(f"gate={self.gate}: a probability between 0 and 1")
        if self.particles < 1 or self.iterations < 1 or self.version not in (1, 2):
            raise TomThumbError(
                f"particles={self.particles}, iterations={self.iterations}, version={self.version}: "
                "at least 1, at least 1, and 1 or 2"
            )
        if not (0.0 <= self.resample <= 1.0 and self.density > 0.0):
            raise TomThumbError(f"resample={self.resample}, density={self.density}: 0 to 1, and more than 0 per m2")

    def init(self, pose: Array, cov: Array, rng: Rng) -> Particles:
        """See `protocols.Estimator`."""
        M = self.particles
        belief = Particles(
            np.tile(np.asarray(pose, float), (M, 1)), np.tile(np.asarray(cov, float), (M, 1, 1)), np.zeros(M),
            pages.empty(M),
        )  # fmt: skip
        if self.version == 1:
            self._draw(belief, np.zeros((M, 3)), mixture.in_body(belief.pose, belief.cov), rng)
        return belief

    def fork(self, belief: Particles) -> Particles:
        """See `protocols.Estimator`."""
        b = belief
        maps, heard = pages.copy(b.maps), echo.copy(b.echo)
        return Particles(b.pose.copy(), b.cov.copy(), b.log_weight.copy(), maps, b.view, heard, b.named, dict(b.stats))

    def predict(self, belief: Particles, control: Control, rng: Rng) -> Particles:
        """See `protocols.Estimator`. Resamples first, where the last scan made it necessary."""
        self._resample(belief, rng)
        delta, cov = self.motion.increment(control)
        particles.move(belief.pose, belief.cov, np.asarray(delta, float), np.asarray(cov, float))
        if self.version == 1:
            self._draw(belief, np.zeros_like(belief.pose), mixture.in_body(belief.pose, belief.cov), rng)
        belief.view = None
        return belief

    def _draw(self, b: Particles, shift: Array, cov: Array, rng: Rng) -> None:
        """Poses drawn; from now on they are certain until the next motion."""
        kernel.sample(b.pose, shift, cov, rng.standard_normal((len(b.pose), 3)))
        b.cov[:] = 0.0

    def _resample(self, b: Particles, rng: Rng) -> None:
        w = b.weights()
        order = np.arange(len(w))
        if 1.0 / np.square(w).sum() < self.resample * len(w):
            order = kernel.systematic(w, rng.random())
            b.log_weight = np.zeros(len(w))
        else:
            b.log_weight -= b.log_weight.max()
        order = _first(order, int(w.argmax()))
        if not np.array_equal(order, np.arange(len(w))):
            b.pose, b.cov, b.log_weight = b.pose[order], b.cov[order], b.log_weight[order]
            b.maps.table = kernel.inherit(order, b.maps.table, b.maps.uses, b.maps.free)

    # --- expectation --------------------------------------------------------------------------------------------------

    def _look(self, b: Particles) -> View:
        """The landmarks near enough for any particle, seen from all of them by one call of the sensor."""
        if b.view is not None:
            return b.view
        m = b.maps
        reach = self.sensor.max_range + float(np.hypot(*self.sensor.frame(ORIGIN)[:2]))
        spread = 5.0 * float(np.sqrt(np.trace(b.cov[:, :2, :2], axis1=1, axis2=2).max()))
        slots = kernel.near(b.pose, m.box, m.live, min(reach + spread, 1e9))
        every = np.broadcast_to(slots, (len(b.pose), len(slots)))
        points, cov, there = kernel.to_body(b.pose, every, m.table, m.mean, m.cov, m.has)
        z_hat, H = _expect(self.sensor, points)
        C, Hx = kernel.own_covariances(b.pose, b.cov, points, cov, H)
        var = C.reshape(-1, 2, 2)[:, [0, 1], [0, 1]]
        chance = self.sensor.in_view(z_hat.reshape(-1, 2), var).reshape(there.shape) * there
        b.view = View(slots, points, cov, there, z_hat, H, C, Hx, chance)
        return b.view

    def expect(self, belief: Particles) -> Sequence[Predictions]:
        """See `protocols.Estimator`: one for each particle, or for the heaviest alone (`quick`)."""
        v = self._look(belief)
        cov = mixture.in_body(belief.pose, belief.cov)
        ids, stone = belief.maps.ids[v.slots], belief.maps.stone[v.slots]
        asked = range(1 if self.quick else len(belief.pose))
        return [self._predictions(v, p, cov[p], ids, stone, belief) for p in asked]

    def _predictions(self, v: View, p: int, cov: Array, ids: Ids, stone: Mask, b: Particles) -> Predictions:
        keep = np.flatnonzero(v.chance[p] > UNSEEN)
        n = len(keep)
        Hx = v.Hx[p, keep].reshape(2 * n, 3)
        C = Hx @ cov @ Hx.T
        blocks = C.reshape(n, 2, n, 2)
        blocks[np.arange(n), :, np.arange(n), :] = v.C[p, keep]
        turn = np.eye(3)
        turn[:2, :2] = geometry.rotation(b.pose[p, 2])
        frame = geometry.to_frame(self.sensor.frame(ORIGIN), v.points[p, keep])
        visible = v.chance[p, keep] * self.sensor.detect
        return Predictions(
            ids[keep], v.z_hat[p, keep], C, b.cov[p], Hx @ cov @ turn.T, frame, None, visible, stone[keep]
        )  # fmt: skip

    def name(self, belief: Particles, observations: Observations) -> Ids:
        """Ids (M, m) of the observations by maximum likelihood in each particle, -1 for none: the quick path.

        The same as an associator would say that takes, for each observation, the likeliest landmark within the gate.
        """
        v = self._look(belief)
        z, R = np.asarray(observations.z, float), np.asarray(observations.R, float)
        flags, gate2 = geometry.wrapped(self.sensor.angles), float(chdtri(2, 1.0 - self.gate))
        match = kernel.name(z, R, v.z_hat, v.C, v.chance > UNSEEN, flags, gate2)
        named: Ids = np.where(match >= 0, belief.maps.ids[v.slots][match], -1) if len(v.slots) else match
        return named

    # --- update -------------------------------------------------------------------------------------------------------

    def update(self, belief: Particles, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Particles:
        """See `protocols.Estimator`. Raises `Diverged`."""
        b, m = belief, belief.maps
        z, R = np.asarray(observations.z, float), np.asarray(observations.R, float)
        b.named = self._all_named(b, observations, ids)
        slots = _slots(m, b.named)
        firm = (slots >= 0) & m.stone[slots] if len(m.stone) else slots >= 0
        if self.negative:
            v = self._look(b)
            detect = min(self.sensor.detect, 0.999)
            b.log_weight += particles.missed(v.slots, v.chance, v.there, m.stone, slots, firm, detect)
        if self.whiten:
            R = R * self._listen(b, z, R, np.where(firm, slots, -1))
        shift, cov = self._propose(b, z, R, slots, firm)
        b.log_weight += ((~firm) @ np.log(self.density * self.sensor.scale(z))) if len(z) else 0.0
        self._draw(b, shift, cov, rng)
        b.view = None
        self._absorb(b, z, R, slots)
        if not (np.isfinite(b.log_weight).any() and np.isfinite(b.pose).all()):
            raise Diverged("no particle explains the observations")
        return b

    def _all_named(self, b: Particles, observations: Observations, ids: Sequence[Ids]) -> Ids:
        """Ids (M, m): as given, or where only the heaviest particle's are, the others' by maximum likelihood."""
        if not self.quick or len(ids) == len(b.pose):
            return np.asarray(ids, np.int64).reshape(len(b.pose), len(observations))
        named = self.name(b, observations)
        named[0] = ids[0]
        return named

    def _listen(self, b: Particles, z: Array, R: Array, slots: Ids) -> Array:
        """By what R (m, 2, 2) is to be multiplied, from the residuals of the heaviest particle before the scan."""
        points, _ = _of_each(b.pose[:1], slots[:1], b.maps)
        residual = z - _expect(self.sensor, points)[0][0]
        for k in self.sensor.angles:
            residual[:, k] = geometry.wrap(residual[:, k])
        raised = echo.listen(b.echo, slots[0], residual / np.sqrt(R[:, [0, 1], [0, 1]]))
        raised[~geometry.wrapped(self.sensor.angles)] = 1.0
        factor: Array = np.sqrt(np.outer(raised, raised))
        return factor

    def _propose(self, b: Particles, z: Array, R: Array, slots: Ids, firm: Mask) -> tuple[Array, Array]:
        """Each pose's Gaussian after the scan, in its own frame; weights and statistics are brought up to date."""
        shift = np.zeros((len(b.pose), 3))
        cov = mixture.in_body(b.pose, b.cov)
        if not firm.any():
            b.stats = {"nis": 0.0, "dof": 0, "iterations": 0}
            return shift, cov
        points, spread = _of_each(b.pose, slots, b.maps)
        for _ in range(self.iterations if b.cov.any() else 1):
            moved, turned = particles.after(shift, points, spread)
            z_hat, H = _expect(self.sensor, moved)
            Hx, noise = particles.by_motion(H, moved, turned, shift)
            total, nis, shift, cov = kernel.propose_all(
                z, R, firm, z_hat, Hx, noise, shift, b.pose, b.cov, geometry.wrapped(self.sensor.angles)
            )  # fmt: skip
        b.log_weight += total
        b.stats = {"nis": float(nis[0]), "dof": 2 * int(firm[0].sum()), "iterations": self.iterations}
        return shift, cov

    def _absorb(self, b: Particles, z: Array, R: Array, slots: Ids) -> None:
        if not (slots >= 0).any():
            return
        points, spread = _of_each(b.pose, slots, b.maps)
        z_hat, H = _expect(self.sensor, points)
        pages.reserve(b.maps, pages.columns_of(slots))
        flags = geometry.wrapped(self.sensor.angles)
        kernel.absorb(b.pose, points, spread, slots, z, R, z_hat, H, flags, *pages.arrays(b.maps))
        kernel.boxes(pages.distinct(slots), b.maps.table, b.maps.mean, b.maps.has, b.maps.box)

    # --- landmarks ----------------------------------------------------------------------------------------------------

    def add(self, belief: Particles, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Particles:
        """See `protocols.Estimator`. A landmark may be new in some particles and known under another id in others."""
        b, m = belief, belief.maps
        named = np.asarray(ids, np.int64).reshape(len(ids), len(observations))
        if len(named) < len(b.pose):  # new to the heaviest: new to all that found no name for it either
            size = (len(b.pose), named.shape[1])
            named = np.where(b.named < 0 if b.named.shape == size else np.ones(size, bool), named, -1)
        rows = np.flatnonzero((named >= 0).any(0))
        if not len(rows):
            return b
        if b.cov.any():
            self._draw(b, np.zeros_like(b.pose), mixture.in_body(b.pose, b.cov), rng)
        points, _, G = self.sensor.locate(ORIGIN, observations.z[rows])
        noise = G @ observations.R[rows] @ G.transpose(0, 2, 1)
        serials = named[:, rows].max(0).tolist()
        slots = np.array(pages.open_slots(m, serials), np.int64)
        every = np.where(named[:, rows] >= 0, slots[None], -1)
        pages.reserve(m, pages.columns_of(every))
        kernel.found(b.pose, every, points, noise, *pages.arrays(m))
        kernel.boxes(slots, m.table, m.mean, m.has, m.box)
        b.view = None
        return b

    def place(self, belief: Particles, ids: Ids, landmarks: Array, covs: Array) -> Particles:
        """See `protocols.Estimator`."""
        m = belief.maps
        slots = np.array(pages.open_slots(m, ids.tolist()), np.int64)
        every = np.tile(slots, (len(belief.pose), 1))
        pages.reserve(m, pages.columns_of(every))
        kernel.found(np.zeros_like(belief.pose), every, landmarks, covs, *pages.arrays(m))
        kernel.boxes(slots, m.table, m.mean, m.has, m.box)
        belief.view = None
        return self.promote(belief, ids)

    def promote(self, belief: Particles, ids: Ids) -> Particles:
        """See `protocols.Estimator`."""
        belief.maps.stone[[belief.maps.slot[i] for i in ids.tolist()]] = True
        return belief

    def doubt(self, belief: Particles, ids: Ids) -> Particles:
        """See `protocols.Estimator`."""
        belief.maps.stone[[belief.maps.slot[i] for i in ids.tolist()]] = False
        return belief

    def forget(self, belief: Particles, ids: Ids) -> Particles:
        """See `protocols.Estimator`."""
        for i in ids.tolist():
            echo.forget(belief.echo, belief.maps.slot[i])
            pages.forget(belief.maps, i)
        belief.view = None
        return belief

    def merge(self, belief: Particles, keep: int, drop: int) -> Particles:
        """See `protocols.Estimator`. Two stones that are one also weigh the particles."""
        b, m = belief, belief.maps
        k, d = m.slot[keep], m.slot[drop]
        if m.stone[d] and not m.stone[k]:
            raise ValueError(f"crumb {keep} cannot absorb stone {drop}: merge the other way round")
        if m.stone[d]:
            pages.reserve(m, 1)
            b.log_weight += kernel.unite(k, d, *pages.arrays(m))
            kernel.boxes(np.array([k]), m.table, m.mean, m.has, m.box)
        return self.forget(b, np.array([drop]))

    def relocate(self, belief: Particles, pose: Array, cov: Array) -> Particles:
        """See `protocols.Estimator`: the particles keep their maps; each stands there with the whole uncertainty."""
        belief.pose[:] = pose
        belief.cov[:] = cov
        belief.view = None
        return belief

    def pose(self, belief: Particles) -> tuple[Array, Array]:
        """See `protocols.Estimator`: mean and covariance of the mixture; headings are averaged on the circle."""
        return mixture.pose(belief.weights(), belief.pose, belief.cov)

    def estimate(self, belief: Particles) -> Estimate:
        """See `protocols.Estimator`: the heaviest particle's landmarks, averaged over all particles that hold them."""
        ids, places, covs, stone = mixture.landmarks(belief.weights(), belief.maps)
        return Estimate(*self.pose(belief), ids, places, covs, stone)

    def stats(self, belief: Particles) -> dict[str, Any]:
        """See `protocols.Estimator`; of the heaviest particle."""
        return {**belief.stats, "effective": float(1.0 / np.square(belief.weights()).sum())}


def _first(order: Ids, best: int) -> Ids:
    """The same particles with `best` in front (it survives any systematic resampling)."""
    place = int(np.flatnonzero(order == best)[0]) if (order == best).any() else 0
    swapped = order.copy()
    swapped[0], swapped[place] = order[place], order[0]
    return swapped


def _slots(m: Pages, named: Ids) -> Ids:
    """The slot of each id, -1 for none. Particles mostly agree, so each id is looked up once."""
    ids, places = np.unique(named, return_inverse=True)
    slots: Ids = np.array([m.slot.get(i, -1) for i in ids.tolist()], np.int64)[places].reshape(named.shape)
    return slots


def _expect(sensor: Sensor, points: Array) -> tuple[Array, Array]:
    """z_hat and its derivative by the point, of points (M, c, 2) in the robots' frames: one call for all."""
    z_hat, _, H = sensor.expect(ORIGIN, points.reshape(-1, 2))
    return z_hat.reshape(points.shape), H.reshape(*points.shape, 2)


def _of_each(pose: Array, slots: Ids, m: Pages) -> tuple[Array, Array]:
    """Landmarks `slots` (M, m; -1 gives a stand-in) in each robot's frame: points, covariances (M, m, 2, 2)."""
    points, spread, _ = kernel.to_body(pose, slots, m.table, m.mean, m.cov, m.has)
    return points, spread
