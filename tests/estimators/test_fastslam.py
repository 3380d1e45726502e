"""FastSLAM: Gaussians against plain linear algebra, shared maps by their bookkeeping, draws by statistics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.worlds import drive, models
from tomthumb import geometry
from tomthumb.errors import Diverged, TomThumbError
from tomthumb.estimators import echo, pages
from tomthumb.estimators.ekf import EKF
from tomthumb.estimators.fastslam import FastSLAM
from tomthumb.kernels import fastslam as kernel
from tomthumb.types import Control, Observations

START = np.array([6.0, 3.0, 0.4])


def grown(kind="range_bearing", particles=20, steps=6, **options):
    """A belief after some steps with true names, everything known a stone; and the steps that come next."""
    motion, sensor = models(kind)
    fast = FastSLAM(motion, sensor, particles=particles, **options)
    rng = np.random.default_rng(1)
    belief = fast.init(np.array([6.0, 3.0, 0.0]), np.diag([0.05, 0.05, 0.02]) ** 2, rng)
    ahead = list(drive(sensor, rng, steps=steps + 4))
    for _, control, seen, ids in ahead[:steps]:
        belief = step(fast, belief, control, seen, ids, rng)
    return fast, belief, ahead[steps:], rng


def step(fast, belief, control, seen, ids, rng):
    belief = fast.predict(belief, control, rng)
    fast.expect(belief)
    known = np.array(sorted(belief.maps.slot), np.int64)
    named = np.where(np.isin(ids, known), ids, -1)
    belief = fast.update(belief, seen, [named] * fast.particles, rng)
    new = np.where(named < 0, ids, -1)
    belief = fast.add(belief, seen, [new] * fast.particles, rng)
    return fast.promote(belief, np.setdiff1d(ids, known))


def check_pages(m):
    """Every page's owners are counted, and a page is free or owned, never both."""
    used = m.table[m.table >= 0]
    np.testing.assert_array_equal(np.bincount(used, minlength=len(m.uses)), m.uses)
    free = m.free[1 : 1 + m.free[0]]
    assert len(np.unique(free)) == len(free)
    assert not np.isin(free, used).any()
    assert len(free) + len(np.unique(used)) == len(m.uses)


def test_pages_are_counted_and_shared():
    fast, belief, ahead, rng = grown(particles=30, steps=9, resample=1.0)
    check_pages(belief.maps)
    belief.log_weight = rng.standard_normal(30)
    fast._resample(belief, rng)
    check_pages(belief.maps)
    used = belief.maps.table[belief.maps.table >= 0]
    assert len(np.unique(used)) < len(used)
    _, control, seen, ids = ahead[0]
    step(fast, belief, control, seen, ids, rng)
    check_pages(belief.maps)


def test_what_one_particle_writes_the_others_do_not_see():
    _fast, belief, _, _rng = grown(particles=4)
    m = belief.maps
    m.table = kernel.inherit(np.zeros(4, np.int64), m.table, m.uses, m.free)
    slots = np.full((4, 1), -1)
    slots[2, 0] = s = int(np.flatnonzero(m.live)[0])
    before = [m.mean[m.table[p, s // pages.SIZE], s % pages.SIZE].copy() for p in range(4)]
    pages.reserve(m, 1)
    kernel.found(belief.pose, slots, np.ones((1, 2)), np.eye(2)[None], *pages.arrays(m))
    after = [m.mean[m.table[p, s // pages.SIZE], s % pages.SIZE] for p in range(4)]
    for p in (0, 1, 3):
        np.testing.assert_array_equal(before[p], after[p])
    np.testing.assert_allclose(after[2], geometry.to_world(belief.pose[2], np.ones((1, 2)))[0])
    check_pages(m)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40), st.floats(0.0, 0.999))
@settings(max_examples=200, deadline=None)
def test_systematic_resampling_is_fair(weights, start):
    w = np.array(weights) + 1e-9
    w /= w.sum()
    counts = np.bincount(kernel.systematic(w, start), minlength=len(w))
    assert (np.abs(counts - len(w) * w) < 1.0 + 1e-6).all()
    assert counts.sum() == len(w)


def test_expectations_equal_the_ekfs_of_a_map_without_correlations():
    fast, belief, ahead, rng = grown("range_bearing", particles=3)
    belief = fast.predict(belief, ahead[0][1], rng)
    predictions = fast.expect(belief)
    for p, mine in enumerate(predictions):
        m = belief.maps
        slots = np.array([m.slot[i] for i in mine.ids.tolist()])
        page, at = m.table[p, slots // pages.SIZE], slots % pages.SIZE
        z_hat, by_pose, by_point = fast.sensor.expect(belief.pose[p], m.mean[page, at])
        n = len(slots)
        P = np.zeros((3 + 2 * n, 3 + 2 * n))
        P[:3, :3] = belief.cov[p]
        H = np.zeros((2 * n, 3 + 2 * n))
        for k in range(n):
            a, b, d = m.cov[page[k], at[k]]
            rows = slice(3 + 2 * k, 5 + 2 * k)
            P[rows, rows] = [[a, b], [b, d]]
            H[2 * k : 2 * k + 2, :3], H[2 * k : 2 * k + 2, rows] = by_pose[k], by_point[k]
        np.testing.assert_allclose(mine.z_hat, z_hat, atol=1e-9)
        np.testing.assert_allclose(mine.cov, H @ P @ H.T, atol=1e-9)
        np.testing.assert_allclose(mine.cross, (H @ P)[:, :3], atol=1e-9)


@pytest.mark.parametrize("kind", ["range_bearing", "cartesian"])
def test_the_proposal_is_the_conditional_gaussian(kind):
    """Mean, covariance and likelihood of the pose given the scan, against the joint linear-Gaussian formula."""
    fast, belief, ahead, rng = grown(kind, particles=1, iterations=1, negative=False)
    _, control, seen, ids = ahead[0]
    belief = fast.predict(belief, control, rng)
    m = belief.maps
    known = np.array([i in m.slot for i in ids.tolist()])
    seen, ids = seen.take(known), ids[known]
    slots = np.array([[m.slot[i] for i in ids.tolist()]])
    page, at = m.table[0, slots[0] // pages.SIZE], slots[0] % pages.SIZE
    z_hat, by_pose, by_point = fast.sensor.expect(belief.pose[0], m.mean[page, at])
    n, cov = len(ids), belief.cov[0]
    V, H = np.zeros((2 * n, 2 * n)), by_pose.reshape(-1, 3)
    for k in range(n):
        a, b, d = m.cov[page[k], at[k]]
        V[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = by_point[k] @ [[a, b], [b, d]] @ by_point[k].T + seen.R[k]
    nu = seen.z - z_hat
    for k in fast.sensor.angles:
        nu[:, k] = geometry.wrap(nu[:, k])
    S = H @ cov @ H.T + V
    K = cov @ H.T @ np.linalg.inv(S)
    pose = belief.pose[0] + K @ nu.ravel()
    likelihood = -0.5 * (nu.ravel() @ np.linalg.solve(S, nu.ravel()) + np.linalg.slogdet(2 * np.pi * S)[1])
    weight = belief.log_weight[0]
    shift, body = fast._propose(belief, seen.z, seen.R, slots, np.ones_like(slots, bool))
    turn = np.eye(3)
    turn[:2, :2] = geometry.rotation(belief.pose[0, 2])
    np.testing.assert_allclose(belief.pose[0] + turn @ shift[0], pose, atol=1e-9)
    np.testing.assert_allclose(turn @ body[0] @ turn.T, cov - K @ S @ K.T, atol=1e-10)
    assert belief.log_weight[0] - weight == pytest.approx(likelihood)


def test_draws_have_the_proposals_mean_and_covariance():
    M = 40_000
    rng = np.random.default_rng(2)
    A = rng.standard_normal((3, 2))
    cov = 1e-4 * A @ A.T  # singular: a velocity model has no sideways noise
    pose = np.tile(START, (M, 1))
    shift = np.array([0.02, -0.01, 0.005])
    kernel.sample(pose, np.tile(shift, (M, 1)), np.tile(cov, (M, 1, 1)), rng.standard_normal((M, 3)))
    turn = np.eye(3)
    turn[:2, :2] = geometry.rotation(START[2])
    away = (pose - START) @ turn
    scale = np.sqrt(np.diag(cov).max() / M)
    np.testing.assert_allclose(away.mean(0), shift, atol=5 * scale)
    np.testing.assert_allclose(np.cov(away.T), cov, atol=6 * np.diag(cov).max() / np.sqrt(M))


def test_with_a_certain_pose_it_is_one_small_filter_for_each_landmark():
    motion, sensor = models("range_bearing")
    fast = FastSLAM(motion, sensor, particles=2, version=1)
    ekf = EKF(motion, sensor, iterations=1)
    rng = np.random.default_rng(3)
    start, none = np.array([6.0, 3.0, 0.0]), np.zeros((3, 3))
    a, b = fast.init(start, none, rng), ekf.init(start, none, rng)
    still = Control(np.zeros(3), 1.0, none)
    for k, (_, _, seen, ids) in enumerate(drive(sensor, np.random.default_rng(4), steps=5, step=0.0)):
        a, b = fast.predict(a, still, rng), ekf.predict(b, still, rng)
        if k == 0:
            a, b = fast.add(a, seen, [ids, ids], rng), ekf.add(b, seen, [ids], rng)
            a, b = fast.promote(a, ids), ekf.promote(b, ids)
        else:
            a, b = fast.update(a, seen, [ids, ids], rng), ekf.update(b, seen, [ids], rng)
    one, other = fast.estimate(a), ekf.estimate(b)
    np.testing.assert_array_equal(one.ids, other.ids)
    np.testing.assert_allclose(one.landmarks, other.landmarks, atol=1e-9)
    np.testing.assert_allclose(one.covs, other.covs, atol=1e-9)


def test_the_quick_path_names_by_maximum_likelihood():
    fast, belief, ahead, rng = grown(particles=5)
    _, control, seen, _ = ahead[0]
    belief = fast.predict(belief, control, rng)
    named = fast.name(belief, seen)
    gate2 = -2.0 * np.log(0.001)
    for p, predictions in enumerate(fast.expect(belief)):
        n = len(predictions)
        blocks = predictions.cov.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
        cost = np.full((len(seen), n), np.inf)
        for i in range(len(seen)):
            for k in range(n):
                nu = seen.z[i] - predictions.z_hat[k]
                nu[1] = geometry.wrap_angle(nu[1])
                S = blocks[k] + seen.R[i]
                d2 = nu @ np.linalg.solve(S, nu)
                cost[i, k] = d2 + np.linalg.slogdet(S)[1] if d2 < gate2 else np.inf
        best = cost.argmin(1)
        for i in range(len(seen)):
            value = cost[i, best[i]]
            rivals = [j for j in range(len(seen)) if best[j] == best[i] and cost[j, best[j]] < value]
            expected = -1 if not np.isfinite(value) or rivals else int(predictions.ids[best[i]])
            assert named[p, i] == expected


def test_quick_asks_for_the_heaviest_alone_and_ends_where_the_common_path_does():
    """Landmarks far apart: maximum likelihood and the truth agree, so both paths run the same filter."""
    motion, sensor = models("range_bearing")
    slow, quick = (
        FastSLAM(motion, sensor, particles=20),
        FastSLAM(motion, sensor, particles=20, quick=True, gate=1.0 - 1e-9),
    )
    beliefs, known = [], np.empty(0, np.int64)
    points = np.array([[2.0, 2.0], [2.0, -2.0], [3.2, 0.6], [3.0, -0.9]])
    sources = [np.random.default_rng(5), np.random.default_rng(5)]
    for est, rng in zip((slow, quick), sources, strict=True):
        beliefs.append(est.init(np.zeros(3), np.zeros((3, 3)), rng))
    noise = np.random.default_rng(6)
    pose, ids = np.zeros(3), np.arange(4)
    for _ in range(15):
        control = Control(np.array([0.1, 0.0, 0.02]), 1.0)
        pose = geometry.compose(pose, control.u)
        z = sensor.expect(pose, points)[0] + 0.01 * noise.standard_normal((4, 2))
        seen = Observations(z, np.tile(1e-4 * np.eye(2), (4, 1, 1)))
        for k, (est, rng) in enumerate(zip((slow, quick), sources, strict=True)):
            b = est.predict(beliefs[k], control, rng)
            asked = len(est.expect(b))
            assert asked == (20 if est is slow else 1)
            named = np.where(np.isin(ids, known), ids, -1)
            b = est.update(b, seen, [named] * asked, rng)
            b = est.add(b, seen, [np.where(named < 0, ids, -1)] * asked, rng)
            beliefs[k] = est.promote(b, ids)
        known = ids
    np.testing.assert_allclose(beliefs[1].pose, beliefs[0].pose, atol=1e-12)
    np.testing.assert_allclose(beliefs[1].log_weight, beliefs[0].log_weight, atol=1e-12)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_residuals_that_repeat_raise_the_noise_and_white_ones_do_not(rho):
    rng, heard = np.random.default_rng(3), echo.Echo()
    value, slots = rng.standard_normal((3, 2)), np.array([0, 5, 70])
    for _ in range(3000):
        value = rho * value + np.sqrt(1.0 - rho * rho) * rng.standard_normal((3, 2))
        raised = echo.listen(heard, slots, value)
    np.testing.assert_allclose(raised, 1.0 if rho == 0.0 else 19.0, rtol=0.3)
    echo.forget(heard, 5)
    assert np.isnan(heard.last[5]).all()


def test_crumbs_neither_weigh_nor_move_the_particles():
    fast, belief, ahead, rng = grown(particles=50, negative=False)
    belief.maps.stone[:] = False
    _, control, seen, ids = ahead[0]
    belief = fast.predict(belief, control, rng)
    twin = fast.fork(belief)
    known = np.where([i in belief.maps.slot for i in ids.tolist()], ids, -1)
    weights = belief.weights()
    belief = fast.update(belief, seen, [known] * 50, np.random.default_rng(5))
    twin = fast.update(twin, seen, [np.full(len(ids), -1)] * 50, np.random.default_rng(5))
    np.testing.assert_allclose(belief.weights(), weights, atol=1e-12)
    np.testing.assert_array_equal(belief.pose, twin.pose)
    assert (
        np.trace(fast.estimate(belief).covs, axis1=1, axis2=2).sum()
        < np.trace(fast.estimate(twin).covs, axis1=1, axis2=2).sum()
    )


def test_a_stone_that_should_be_seen_and_is_not_counts_against_a_particle():
    fast, belief, _, rng = grown("cartesian", particles=2)
    belief.pose[1] = belief.pose[0] + [60.0, 0.0, 0.0]  # sees nothing of what it knows
    belief.cov[:] = 0.0
    belief.log_weight[:] = 0.0
    belief.view = None
    nothing = Observations(np.empty((0, 2)), np.empty((0, 2, 2)))
    belief = fast.update(belief, nothing, [np.empty(0, int)] * 2, rng)
    assert belief.log_weight[1] > belief.log_weight[0] + 3.0


def test_merged_landmarks_are_fused_where_both_are_known():
    fast, belief, _, _rng = grown(particles=3)
    m = belief.maps
    a, b = sorted(m.slot)[:2]
    cov = [m.cov[m.table[0, m.slot[i] // pages.SIZE], m.slot[i] % pages.SIZE].copy() for i in (a, b)]
    full = [np.array([[c[0], c[1]], [c[1], c[2]]]) for c in cov]
    belief = fast.merge(belief, a, b)
    assert b not in m.slot
    check_pages(m)
    got = m.cov[m.table[0, m.slot[a] // pages.SIZE], m.slot[a] % pages.SIZE]
    expected = np.linalg.inv(np.linalg.inv(full[0]) + np.linalg.inv(full[1]))
    np.testing.assert_allclose(got, [expected[0, 0], expected[0, 1], expected[1, 1]], rtol=1e-9)


def test_forgotten_slots_serve_again():
    fast, belief, ahead, rng = grown(particles=3)
    gone = sorted(belief.maps.slot)[0]
    slot = belief.maps.slot[gone]
    belief = fast.forget(belief, np.array([gone]))
    assert gone not in fast.estimate(belief).ids
    seen = ahead[0][2].take(np.array([0]))
    belief = fast.add(belief, seen, [np.array([9999]), np.array([-1]), np.array([9999])], rng)
    assert belief.maps.slot[9999] == slot
    held = [9999 in p.ids for p in fast.expect(belief)]
    assert held == [True, False, True]


def test_divergence_and_bad_settings_are_named():
    fast, belief, ahead, rng = grown(particles=2)
    belief.pose[:] = np.nan
    with pytest.raises(Diverged):
        fast.update(belief, ahead[0][2], [np.full(len(ahead[0][3]), -1)] * 2, rng)
    with pytest.raises(TomThumbError, match="particles=0"):
        FastSLAM(*models("cartesian"), particles=0)
    with pytest.raises(TomThumbError, match="density"):
        FastSLAM(*models("cartesian"), density=0.0)
