"""The filter against a textbook one on full matrices, step by step."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.dense import Dense
from estimators.worlds import drive, models, ordered
from tomthumb.errors import Diverged, TomThumbError, UnknownName
from tomthumb.estimators import local
from tomthumb.estimators.ekf import EKF, InvariantEKF
from tomthumb.types import Control, Observations

RNG = np.random.default_rng(0)


def pair(kind, invariant, iterations, start=(6.0, 3.0, 0.0), **settings):
    motion, sensor = models(kind)
    cov = np.diag([0.1, 0.1, 0.05]) ** 2
    ekf = EKF(motion, sensor, invariant=invariant, iterations=iterations, fixed=True, **settings)
    dense = Dense(motion, sensor, invariant, iterations, np.array(start), cov.copy(), [], set())
    return ekf, ekf.init(np.array(start), cov, RNG), dense


def both(ekf, belief, dense, control, seen, ids, rng):
    """One step of both filters: predict, update of what is known, births, and now and then a promotion."""
    belief = ekf.predict(belief, control, rng)
    dense.predict(control)
    known = np.where(np.isin(ids, dense.ids), ids, -1)
    belief = ekf.update(belief, seen, [known], rng)
    dense.update(seen, known.tolist())
    new = np.where(known < 0, ids, -1)
    belief = ekf.add(belief, seen, [new], rng)
    dense.add(seen, new.tolist())
    crumbs = [i for i in dense.ids if i not in dense.stones]
    ready = [i for i in crumbs if rng.random() < 0.3]
    dense.stones.update(ready)
    return ekf.promote(belief, np.array(ready, np.int64))


def assert_same(belief, dense, tolerance=1e-9):
    x, P = ordered(belief, dense.ids)
    np.testing.assert_allclose(x, dense.x, atol=tolerance)
    np.testing.assert_allclose(P, dense.P, atol=tolerance)


@pytest.mark.parametrize("kind", ["range_bearing", "cartesian"])
@pytest.mark.parametrize("invariant", [False, True])
@pytest.mark.parametrize("iterations", [1, 4])
def test_equals_the_textbook_filter(kind, invariant, iterations):
    rng = np.random.default_rng(3)
    ekf, belief, dense = pair(kind, invariant, iterations)
    for _, control, seen, ids in drive(ekf.sensor, rng, steps=25):
        belief = both(ekf, belief, dense, control, seen, ids, rng)
        assert_same(belief, dense)
    assert len(dense.stones) > 10


@pytest.mark.parametrize("invariant", [False, True])
def test_forget_and_merge_equal_the_textbook_filter(invariant):
    rng = np.random.default_rng(4)
    ekf, belief, dense = pair("range_bearing", invariant, 2)
    for k, (_, control, seen, ids) in enumerate(drive(ekf.sensor, rng, steps=12)):
        belief = both(ekf, belief, dense, control, seen, ids, rng)
        if k % 4 == 3:
            gone = dense.ids[int(rng.integers(len(dense.ids)))]
            belief = ekf.forget(belief, np.array([gone]))
            dense.forget(gone)
            a, b = sorted(dense.stones)[:2]
            belief = ekf.merge(belief, a, b)
            dense.merge(a, b)
        assert_same(belief, dense, 1e-7)


def test_a_merged_pair_agrees_before_it_is_one():
    rng = np.random.default_rng(5)
    ekf, belief, dense = pair("cartesian", True, 3)
    for _, control, seen, ids in drive(ekf.sensor, rng, steps=5):
        belief = both(ekf, belief, dense, control, seen, ids, rng)
    a, b = sorted(dense.stones)[:2]
    ekf.core.unite(belief.active, a, b)
    x, P = ordered(belief, [a, b])
    np.testing.assert_allclose(x[3:5], x[5:7], atol=1e-8)
    np.testing.assert_allclose(P[3:5, 3:5], P[5:7, 5:7], atol=1e-9)


def test_a_crumb_never_moves_the_pose():
    rng = np.random.default_rng(6)
    ekf, belief, _ = pair("cartesian", True, 5)
    (_, control, seen, ids), (_, _, again, same) = list(drive(ekf.sensor, rng, steps=2, step=0.0))
    belief = ekf.predict(belief, control, rng)
    belief = ekf.add(belief, seen, [ids], rng)
    pose, cov = ekf.pose(belief)
    before = ekf.estimate(belief)
    belief = ekf.update(belief, again, [same], rng)
    after = ekf.estimate(belief)
    np.testing.assert_array_equal(pose, after.pose)
    np.testing.assert_array_equal(cov, after.pose_cov)
    assert (np.trace(after.covs, axis1=1, axis2=2) < np.trace(before.covs, axis1=1, axis2=2)).all()


def test_iterating_until_converged_equals_many_fixed_iterations():
    rng = np.random.default_rng(7)
    motion, sensor = models("range_bearing")
    few = InvariantEKF(motion, sensor, tolerance=1e-9, iterations=50)
    many = InvariantEKF(motion, sensor, iterations=50, fixed=True)
    a = few.init(np.array([6.0, 3.0, 0.0]), np.eye(3) * 0.01, rng)
    b = many.init(np.array([6.0, 3.0, 0.0]), np.eye(3) * 0.01, rng)
    known = np.empty(0, np.int64)
    for _, control, seen, ids in drive(sensor, rng, steps=20, noise=3.0):
        a, b = few.predict(a, control, rng), many.predict(b, control, rng)
        named = np.where(np.isin(ids, known), ids, -1)
        a, b = few.update(a, seen, [named], rng), many.update(b, seen, [named], rng)
        new = np.where(named < 0, ids, -1)
        a, b = few.add(a, seen, [new], rng), many.add(b, seen, [new], rng)
        known = np.union1d(known, ids)
        a, b = few.promote(a, known), many.promote(b, known)
    assert few.stats(a)["iterations"] < 50
    np.testing.assert_allclose(few.pose(a)[0], many.pose(b)[0], atol=1e-8)


def test_expect_holds_all_cross_terms():
    rng = np.random.default_rng(8)
    ekf, belief, dense = pair("range_bearing", True, 3)
    for _, control, seen, ids in drive(ekf.sensor, rng, steps=8):
        belief = both(ekf, belief, dense, control, seen, ids, rng)
    (p,) = ekf.expect(belief)
    z_hat, H = dense.jacobian(dense.x, p.ids.tolist())
    np.testing.assert_allclose(p.z_hat, z_hat, atol=1e-9)
    np.testing.assert_allclose(p.cov, H @ dense.P @ H.T, atol=1e-9)
    np.testing.assert_allclose(p.cross, H @ dense.P[:, :3], atol=1e-9)
    np.testing.assert_allclose(p.pose_cov, dense.P[:3, :3], atol=1e-9)
    assert p.stone.tolist() == [i in dense.stones for i in p.ids.tolist()]
    far = [i for i in dense.ids if i not in p.ids.tolist()]
    reach = [np.linalg.norm(dense.x[dense.rows(i)] - ekf.sensor.frame(dense.x[:3])[:2]) for i in far]
    assert min(reach) > ekf.sensor.max_range


def test_a_fork_shares_nothing():
    rng = np.random.default_rng(9)
    ekf, belief, dense = pair("cartesian", True, 2)
    runs = list(drive(ekf.sensor, rng, steps=6))
    for _, control, seen, ids in runs[:4]:
        belief = both(ekf, belief, dense, control, seen, ids, rng)
    twin = ekf.fork(belief)
    x, P = ordered(belief, dense.ids)
    for _, control, seen, ids in runs[4:]:
        twin = ekf.predict(twin, control, rng)
        twin = ekf.update(twin, seen, [np.where(np.isin(ids, dense.ids), ids, -1)], rng)
        twin = ekf.add(twin, seen, [np.where(np.isin(ids, dense.ids), -1, ids)], rng)
        twin = ekf.forget(
            twin, np.array(sorted(dense.ids)[:1]) if dense.ids[0] in twin.active.slot else np.empty(0, int)
        )
    np.testing.assert_array_equal(x, ordered(belief, dense.ids)[0])
    np.testing.assert_array_equal(P, ordered(belief, dense.ids)[1])


@pytest.mark.parametrize("invariant", [False, True])
@pytest.mark.parametrize("ranked", [False, True])
def test_working_by_regions_changes_nothing(invariant, ranked, monkeypatch):
    """A long way through a wide world, with forgetting and merging, against the filter that always works on all."""
    monkeypatch.setattr(local, "WORTH", 0 if ranked else 1000)
    motion, sensor = models("range_bearing")
    whole = EKF(motion, sensor, invariant=invariant, local=0)
    parts = EKF(motion, sensor, invariant=invariant, local=20, margin=0.6, crowd=0.0)
    rng = np.random.default_rng(10)
    start, cov = np.array([20.0, 10.0, 0.0]), np.diag([0.1, 0.1, 0.02]) ** 2
    a, b = whole.init(start, cov, rng), parts.init(start, cov, rng)
    known, dead, regions = np.empty(0, np.int64), [], 0
    for k, (_, control, seen, ids) in enumerate(drive(sensor, rng, steps=150, side=40.0, count=500)):
        was = b.work
        a, b = whole.predict(a, control, rng), parts.predict(b, control, rng)
        regions += b.work is not None and b.work is not was
        (p,), (q,) = whole.expect(a), parts.expect(b)
        order, other = np.argsort(p.ids), np.argsort(q.ids)
        np.testing.assert_array_equal(p.ids[order], q.ids[other])
        np.testing.assert_allclose(p.z_hat[order], q.z_hat[other], atol=1e-9)
        named = np.where(np.isin(ids, known), ids, -1)
        a, b = whole.update(a, seen, [named], rng), parts.update(b, seen, [named], rng)
        new = np.where((named < 0) & ~np.isin(ids, dead), ids, -1)
        a, b = whole.add(a, seen, [new], rng), parts.add(b, seen, [new], rng)
        known = np.setdiff1d(np.union1d(known, ids), dead)
        ready = known[known % 5 != k % 5]
        a, b = whole.promote(a, ready), parts.promote(b, ready)
        if k % 20 == 19:
            gone = known[:1] if k % 40 == 19 else np.intersect1d(ids, known)[:1]
            a, b = whole.forget(a, gone), parts.forget(b, gone)
            known, dead = np.setdiff1d(known, gone), [*dead, *gone.tolist()]
        if k == 100:
            a, b = whole.merge(a, int(ready[5]), int(ready[6])), parts.merge(b, int(ready[5]), int(ready[6]))
            known, dead = np.setdiff1d(known, ready[6]), [*dead, int(ready[6])]
    assert regions >= 5
    twin = parts.fork(b)
    local.leave(twin)
    ids = sorted(a.active.slot)
    for mine, theirs in zip(ordered(a, ids), ordered(twin, ids), strict=True):
        np.testing.assert_allclose(theirs, mine, atol=1e-9)
    one, other = whole.estimate(a), parts.estimate(b)
    np.testing.assert_array_equal(np.sort(one.ids), np.sort(other.ids))


def test_infinite_range_is_worked_on_as_a_whole():
    motion, _ = models("cartesian")
    from tomthumb.models.sensor import Cartesian

    ekf = EKF(motion, Cartesian(), local=1)
    belief = ekf.init(np.zeros(3), np.zeros((3, 3)), RNG)
    seen = Observations(np.arange(10.0).reshape(5, 2), np.tile(0.01 * np.eye(2), (5, 1, 1)))
    belief = ekf.add(belief, seen, [np.arange(5)], RNG)
    belief = ekf.predict(belief, Control(np.zeros(3), 1.0), RNG)
    assert belief.work is None
    assert len(ekf.expect(belief)[0]) == 5


def test_the_covariance_stays_positive_definite():
    rng = np.random.default_rng(11)
    for invariant in (False, True):
        ekf, belief, dense = pair("range_bearing", invariant, 5)
        for _, control, seen, ids in drive(ekf.sensor, rng, steps=60, noise=5.0):
            belief = both(ekf, belief, dense, control, seen, ids, rng)
        _, P = ordered(belief, dense.ids)
        assert np.linalg.eigvalsh(P)[0] > 0.0


def test_faithful_is_four_fixed_iterations_of_the_usual_filter():
    motion, sensor = models("cartesian")
    core = InvariantEKF(motion, sensor, faithful=True).core
    assert (core.invariant, core.iterations, core.fixed) == (False, 4, True)


def test_outliers_are_left_out():
    rng = np.random.default_rng(12)
    motion, sensor = models("cartesian")
    ekf = InvariantEKF(motion, sensor, outliers=0.999)
    belief = ekf.init(np.array([6.0, 3.0, 0.0]), np.eye(3) * 1e-4, rng)
    (_, control, seen, ids), (_, second, again, _) = list(drive(sensor, rng, steps=2, step=0.0))
    belief = ekf.add(ekf.predict(belief, control, rng), seen, [ids], rng)
    belief = ekf.predict(ekf.promote(belief, ids), second, rng)
    again.z[0] += 3.0
    clean = ekf.update(ekf.fork(belief), again, [np.where(np.arange(len(ids)) > 0, ids, -1)], rng)
    belief = ekf.update(belief, again, [ids], rng)
    assert ekf.stats(belief)["outliers"] == 1
    np.testing.assert_allclose(ekf.pose(belief)[0], ekf.pose(clean)[0], atol=1e-12)


def test_divergence_is_named():
    motion, sensor = models("cartesian")
    ekf = EKF(motion, sensor)
    belief = ekf.init(np.zeros(3), np.eye(3) * 1e-4, RNG)
    seen = Observations(np.ones((1, 2)), np.eye(2)[None] * 1e-4)
    belief = ekf.promote(ekf.add(belief, seen, [np.array([0])], RNG), np.array([0]))
    belief.active.P[3, 3] = -1.0
    with pytest.raises(Diverged, match="positive definite"):
        ekf.update(belief, seen, [np.array([0])], RNG)


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({"iterations": 0}, TomThumbError),
        ({"tolerance": 0.0}, TomThumbError),
        ({"outliers": 1.0}, TomThumbError),
        ({"local": -1}, TomThumbError),
        ({"crowd": -1.0}, TomThumbError),
        ({"calibrate": ("scale",)}, TomThumbError),
        ({"calibrate": ("steering_gain",), "calibrate_std": (0.1,)}, UnknownName),
    ],
)
def test_settings_that_cannot_be(settings, error):
    with pytest.raises(error):
        EKF(*models("cartesian"), **settings)
