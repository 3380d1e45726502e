"""The contract of an estimator, one function for each clause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tomthumb.protocols import Rng
from tomthumb.testing.problems import MOVE, motion, observe, sensor, small_world
from tomthumb.types import Array, Control, Estimate, Ids, Observations

Build = Callable[..., Any]

POINTS = np.array([[5.0, 0.0], [0.0, 4.0], [-3.0, -3.0]])
IDS = np.array([0, 1, 2], np.int64)
PRIOR = (np.array([0.1, -0.2, 0.3]), np.diag([0.02, 0.03, 0.01]) ** 2)


@dataclass
class Bench:
    """An estimator with a belief on it; each method is one call of the protocol."""

    estimator: Any
    belief: Any
    rng: Rng

    @classmethod
    def of(cls, build: Build, seed: int = 0) -> Bench:
        """A fresh estimator whose belief is the prior."""
        rng = np.random.default_rng(seed)
        estimator = build(motion=motion(), sensor=sensor())
        return cls(estimator, estimator.init(PRIOR[0].copy(), PRIOR[1].copy(), rng), rng)

    @classmethod
    def mapped(cls, build: Build, seed: int = 0) -> Bench:
        """The same with three landmarks, confirmed."""
        bench = cls.of(build, seed)
        bench.add(IDS)
        bench.belief = bench.estimator.promote(bench.belief, IDS)
        return bench

    def scan(self, pose: Array | None = None) -> Observations:
        """The three landmarks as seen from `pose` (the prior's by default)."""
        return observe(PRIOR[0] if pose is None else pose, POINTS, np.random.default_rng(21))

    def add(self, ids: Ids) -> None:
        """Found landmarks from a scan, in every particle."""
        every = [ids.copy() for _ in self.estimator.expect(self.belief)]
        self.belief = self.estimator.add(self.belief, self.scan(), every, self.rng)

    def move(self) -> None:
        """One step of odometry."""
        self.belief = self.estimator.predict(self.belief, Control(MOVE.copy(), 1.0), self.rng)

    def see(self, scan: Observations, ids: Ids) -> None:
        """Update by observations of known names."""
        every = [ids.copy() for _ in self.estimator.expect(self.belief)]
        self.belief = self.estimator.update(self.belief, scan, every, self.rng)

    def estimate(self) -> Estimate:
        """What the belief says."""
        found: Estimate = self.estimator.estimate(self.belief)
        return found


def starts_at_the_prior(build: Build) -> None:
    """`init` believes the prior: exactly for a Gaussian, within sampling error for particles; the map is empty."""
    found = Bench.of(build).estimate()
    spread = np.sqrt(np.diag(PRIOR[1]))
    assert (np.abs(found.pose - PRIOR[0]) <= spread).all(), f"pose {found.pose}, prior {PRIOR[0]}"
    assert found.pose_cov.shape == (3, 3), f"pose_cov has shape {found.pose_cov.shape}"
    assert len(found.ids) == 0, f"{len(found.ids)} landmarks before anything was seen"


def gives_shapes_that_agree(build: Build) -> None:
    """`estimate`: ids (n,), landmarks (n, 2), covs (n, 2, 2), stone (n,); `pose` says the same pose."""
    bench = Bench.mapped(build)
    found = bench.estimate()
    shapes = (found.ids.shape, found.landmarks.shape, found.covs.shape, found.stone.shape)
    assert shapes == ((3,), (3, 2), (3, 2, 2), (3,)), f"shapes {shapes}"
    pose, cov = bench.estimator.pose(bench.belief)
    assert np.allclose(pose, found.pose), f"pose() says {pose}, estimate() {found.pose}"
    assert np.allclose(cov, found.pose_cov), "pose() and estimate() disagree about the covariance"


def moves_as_the_control_says(build: Build) -> None:
    """`predict` composes the increment with the pose and grows less sure of it."""
    from tomthumb.geometry import compose

    bench = Bench.of(build)
    before = bench.estimate()
    bench.move()
    after = bench.estimate()
    expected = compose(before.pose, MOVE)
    assert np.allclose(after.pose, expected, atol=0.05), f"pose {after.pose}, expected {expected}"
    assert np.trace(after.pose_cov) > np.trace(before.pose_cov), "moving made the pose more certain"


def founds_landmarks_as_crumbs(build: Build) -> None:
    """`add` puts landmarks where the observations point, tentative, and passes over ids of -1."""
    bench = Bench.of(build)
    bench.add(np.array([7, -1, 9], np.int64))
    found = bench.estimate()
    order = np.argsort(found.ids)
    assert found.ids[order].tolist() == [7, 9], f"ids {found.ids}"
    assert not found.stone.any(), "a landmark was confirmed at birth"
    assert np.allclose(found.landmarks[order], POINTS[[0, 2]], atol=0.3), f"landmarks {found.landmarks}"


def promotes_crumbs_to_stones(build: Build) -> None:
    """`promote` confirms the landmarks named and no others."""
    bench = Bench.of(build)
    bench.add(IDS)
    bench.belief = bench.estimator.promote(bench.belief, IDS[:2])
    found = bench.estimate()
    stones = sorted(found.ids[found.stone].tolist())
    assert stones == [0, 1], f"stones {stones}"


def doubts_stones(build: Build) -> None:
    """`doubt` makes crumbs of the landmarks named and of no others; such a crumb does not move the pose."""
    bench = Bench.mapped(build)
    bench.belief = bench.estimator.doubt(bench.belief, IDS[:1])
    found = bench.estimate()
    crumbs = found.ids[~found.stone].tolist()
    assert crumbs == IDS[:1].tolist(), f"crumbs {crumbs}"
    bench.belief = bench.estimator.doubt(bench.belief, IDS[1:])
    _stays_put(bench)


def expects_what_it_mapped(build: Build) -> None:
    """`expect` gives ids, z_hat (n, 2) near the scan and cov (2n, 2n), symmetric, positive semi-definite."""
    bench = Bench.mapped(build)
    scan = bench.scan()
    for predictions in bench.estimator.expect(bench.belief):
        order = np.argsort(predictions.ids)
        assert predictions.ids[order].tolist() == IDS.tolist(), f"ids {predictions.ids}"
        assert np.allclose(predictions.z_hat[order], scan.z, atol=0.3), "z_hat is far from what founded the landmarks"
        cov = predictions.cov
        assert cov.shape == (6, 6), f"cov has shape {cov.shape}"
        assert np.allclose(cov, cov.T, atol=1e-9), "cov is not symmetric"
        assert np.linalg.eigvalsh(cov)[0] > -1e-9, "cov is not positive semi-definite"


def expects_nothing_of_an_empty_map(build: Build) -> None:
    """`expect` of an empty map: predictions of length 0."""
    for predictions in (bench := Bench.of(build)).estimator.expect(bench.belief):
        assert len(predictions) == 0, f"{len(predictions)} predictions"
        assert predictions.cov.shape == (0, 0), f"cov has shape {predictions.cov.shape}"


def learns_from_stones(build: Build) -> None:
    """Seeing confirmed landmarks again after a motion makes the pose more certain."""
    from tomthumb.geometry import compose

    bench = Bench.mapped(build)
    bench.move()
    unsure = np.trace(bench.estimate().pose_cov[:2, :2])
    bench.see(bench.scan(compose(PRIOR[0], MOVE)), IDS)
    found = bench.estimate()
    assert np.trace(found.pose_cov[:2, :2]) < unsure, "seeing known landmarks did not help"
    assert np.isfinite(found.pose).all(), f"pose {found.pose}"


def is_not_moved_by_crumbs(build: Build) -> None:
    """Pairings with tentative landmarks teach the landmark only: the pose and its covariance stay.

    Particles may draw their poses in the update; theirs stay within sampling error.
    """
    bench = Bench.of(build)
    bench.add(IDS)
    _stays_put(bench)


def _stays_put(bench: Bench) -> None:
    """The robot moves and then sees its crumbs as if it had not: that tells the pose nothing."""
    bench.move()
    before = bench.estimate()
    bench.see(bench.scan(PRIOR[0]), IDS)
    after = bench.estimate()
    particles = len(bench.estimator.expect(bench.belief))
    slack = 1e-9 if particles == 1 else 5.0 * np.sqrt(np.diag(before.pose_cov) / particles)
    assert (np.abs(after.pose - before.pose) <= slack).all(), f"pose {before.pose} became {after.pose}"
    share = np.diag(after.pose_cov) / np.diag(before.pose_cov)
    slack = 1e-9 if particles == 1 else 5.0 * np.sqrt(2.0 / particles)
    assert (np.abs(share - 1.0) <= slack).all(), f"the pose's variances changed by factors {share}"


def takes_an_empty_scan(build: Build) -> None:
    """An update by nothing, or by observations that are all unpaired, changes nothing."""
    bench = Bench.mapped(build)
    before = bench.estimate()
    bench.see(Observations(np.empty((0, 2)), np.empty((0, 2, 2))), np.empty(0, np.int64))
    bench.see(bench.scan(), np.full(3, -1, np.int64))
    after = bench.estimate()
    assert np.allclose(after.pose, before.pose), f"pose {before.pose} became {after.pose}"
    assert np.allclose(after.landmarks, before.landmarks), "landmarks moved"


def forgets_and_merges(build: Build) -> None:
    """`forget` removes the landmarks named; `merge` leaves the one to keep."""
    bench = Bench.mapped(build)
    bench.belief = bench.estimator.merge(bench.belief, 0, 1)
    assert sorted(bench.estimate().ids.tolist()) == [0, 2], f"after merging 1 into 0: {bench.estimate().ids}"
    bench.belief = bench.estimator.forget(bench.belief, np.array([2], np.int64))
    assert bench.estimate().ids.tolist() == [0], f"after forgetting 2: {bench.estimate().ids}"


def stands_where_it_is_carried(build: Build) -> None:
    """`relocate` puts the robot elsewhere, as uncertain as told; the map stays where it was."""
    bench = Bench.mapped(build)
    before, elsewhere, cov = bench.estimate(), np.array([4.0, -3.0, 2.0]), np.diag([0.2, 0.1, 0.05]) ** 2
    bench.belief = bench.estimator.relocate(bench.belief, elsewhere, cov)
    pose, spread = bench.estimator.pose(bench.belief)
    assert np.allclose(pose, elsewhere, atol=0.1), f"carried to {elsewhere}, but it stands at {pose}"
    assert np.allclose(np.diag(spread), np.diag(cov), rtol=0.5), (
        f"variances {np.diag(spread)} instead of {np.diag(cov)}"
    )
    after = bench.estimate()
    assert np.allclose(after.landmarks, before.landmarks, atol=1e-9), "the map moved with the robot"


def forks_do_not_share(build: Build) -> None:
    """What happens to a fork leaves the original as it was."""
    bench = Bench.mapped(build)
    before = bench.estimate()
    other = Bench(bench.estimator, bench.estimator.fork(bench.belief), np.random.default_rng(1))
    other.move()
    other.see(other.scan(), IDS)
    other.belief = other.estimator.forget(other.belief, np.array([1], np.int64))
    after = bench.estimate()
    assert np.array_equal(after.pose, before.pose), "the fork moved the original"
    assert np.array_equal(after.ids, before.ids), "the fork's forgetting reached the original"
    assert np.array_equal(after.landmarks, before.landmarks), "the fork changed the original's map"


def leaves_its_input_as_it_was(build: Build) -> None:
    """Observations and controls are not written to."""
    bench = Bench.mapped(build)
    scan, control = bench.scan(), Control(MOVE.copy(), 1.0)
    z, R, u = scan.z.copy(), scan.R.copy(), control.u.copy()
    bench.belief = bench.estimator.predict(bench.belief, control, bench.rng)
    bench.see(scan, IDS)
    assert np.array_equal(scan.z, z), "z was changed in place"
    assert np.array_equal(scan.R, R), "R was changed in place"
    assert np.array_equal(control.u, u), "the control was changed in place"


def runs_the_same_from_the_same_seed(build: Build) -> None:
    """A short run with known names ends without failure, twice the same, near the truth."""
    from tomthumb.metrics import evaluate
    from tomthumb.runner import run

    scenario = small_world()
    parts = {"motion": scenario.motion, "sensor": scenario.sensor}
    one, two = (run(scenario, associator="oracle", estimator=build(**parts), seed=3) for _ in range(2))
    assert one.failure is None, one.failure
    assert np.array_equal(one.pose, two.pose), "two runs from one seed differ"
    error = evaluate(one, scenario)["ate_raw_m"]
    assert error < 0.1, f"{error:.2f} m off in a world where all is known"


ESTIMATOR_CHECKS: tuple[Callable[[Build], None], ...] = (
    starts_at_the_prior,
    gives_shapes_that_agree,
    moves_as_the_control_says,
    founds_landmarks_as_crumbs,
    promotes_crumbs_to_stones,
    doubts_stones,
    expects_what_it_mapped,
    expects_nothing_of_an_empty_map,
    learns_from_stones,
    is_not_moved_by_crumbs,
    takes_an_empty_scan,
    forgets_and_merges,
    stands_where_it_is_carried,
    forks_do_not_share,
    leaves_its_input_as_it_was,
    runs_the_same_from_the_same_seed,
)
