"""The smoother against gtsam, its derivatives against differences, its files against themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tomthumb import geometry
from tomthumb.errors import BrokenFile, TomThumbError, UnknownName
from tomthumb.estimators.ekf import InvariantEKF
from tomthumb.runner import run
from tomthumb.scenarios.cloister import cloister
from tomthumb.smoothing import graph_of, load_g2o, save_g2o, solve
from tomthumb.smoothing.graph import Graph
from tomthumb.smoothing.solver import KERNELS, _normal, _Scales


def made_up(polar, rng, poses=12, points=8, outliers=0):
    """A small graph of a robot going round, everything noisy."""
    true = [np.array([0.0, 0.0, 0.3])]
    delta = np.array([1.0, 0.1, 0.5])
    for _ in range(poses - 1):
        true.append(geometry.compose(true[-1], delta))
    true = np.array(true)
    landmarks = rng.uniform(-3, 4, (points, 2))
    cov = np.diag([0.05, 0.03, 0.02]) ** 2
    cov[0, 2] = cov[2, 0] = 0.3 * 0.05 * 0.02
    moved = np.tile(delta, (poses - 1, 1)) + rng.multivariate_normal(np.zeros(3), cov, poses - 1)
    edges = np.column_stack([np.arange(poses - 1), np.arange(1, poses)])
    pairs = np.array([(k, n) for k in range(poses) for n in range(points) if rng.random() < 0.5])
    z = np.array([geometry.to_frame(true[k], landmarks[n : n + 1])[0] for k, n in pairs])
    if polar:
        z = np.column_stack([np.hypot(*z.T), np.arctan2(z[:, 1], z[:, 0])])
    std = np.array([0.05, 0.03])
    z = z + std * rng.standard_normal(z.shape)
    if polar:
        z[:, 1] = geometry.wrap(z[:, 1])
    z[rng.permutation(len(z))[:outliers], 0] += 2.0
    guess = [true[0]]
    for d in moved:
        guess.append(geometry.compose(guess[-1], d))
    graph = Graph(
        np.array(guess), landmarks + 0.2 * rng.standard_normal(landmarks.shape), np.arange(poses), np.arange(points),
        true[0], np.diag([1e-3, 1e-3, 1e-4]) ** 2, edges, moved, np.tile(cov, (poses - 1, 1, 1)), pairs, z,
        np.tile(np.diag(std**2), (len(z), 1, 1)), polar,
    )  # fmt: skip
    return graph, true, landmarks


@pytest.mark.parametrize("robust", ["none", "huber"])
def test_equals_gtsam(robust):
    pytest.importorskip("gtsam")
    from tomthumb.smoothing.with_gtsam import solve_with_gtsam

    graph, _, _ = made_up(True, np.random.default_rng(0), outliers=3 if robust == "huber" else 0)
    mine = solve(graph, robust=robust, tolerance=1e-15)
    poses, points = solve_with_gtsam(graph, robust=robust)
    np.testing.assert_allclose(mine.graph.poses, poses, atol=1e-6)
    np.testing.assert_allclose(mine.landmarks, points, atol=1e-6)


def test_a_pose_graph_equals_gtsams_reading_of_our_file(tmp_path):
    gtsam = pytest.importorskip("gtsam")
    graph, true, _ = made_up(False, np.random.default_rng(1))
    closing = geometry.between(true[0], true[-1])[None] + [[0.02, -0.03, 0.01]]
    graph = replace(
        graph, edges=np.vstack([graph.edges, [[0, len(true) - 1]]]), delta=np.vstack([graph.delta, closing]),
        delta_cov=np.concatenate([graph.delta_cov, graph.delta_cov[:1]]), landmarks=np.empty((0, 2)),
        ids=np.empty(0, np.int64), sightings=np.empty((0, 2), np.int64), z=np.empty((0, 2)), R=np.empty((0, 2, 2)),
    )  # fmt: skip
    save_g2o(graph, tmp_path / "graph.g2o")
    theirs, initial = gtsam.readG2o(str(tmp_path / "graph.g2o"), False)
    theirs.add(
        gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.prior), gtsam.noiseModel.Gaussian.Covariance(graph.prior_cov))
    )
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-15)
    parameters.setAbsoluteErrorTol(1e-15)
    result = gtsam.LevenbergMarquardtOptimizer(theirs, initial, parameters).optimize()
    expected = np.array([[p.x(), p.y(), p.theta()] for p in (result.atPose2(k) for k in range(len(true)))])
    mine = solve(load_g2o(tmp_path / "graph.g2o"), tolerance=1e-15)
    np.testing.assert_allclose(mine.poses, expected, atol=1e-6)


@pytest.mark.parametrize("polar", [False, True])
def test_the_gradient_equals_finite_differences(polar):
    from tomthumb.smoothing.solver import _cost

    graph, _, _ = made_up(polar, np.random.default_rng(2), poses=5, points=4)
    scales = _Scales(*(np.linalg.inv(np.linalg.cholesky(c)) for c in (graph.prior_cov, graph.delta_cov, graph.R)))
    x = np.concatenate([graph.poses.ravel(), graph.landmarks.ravel()])
    x[:3] += 1e-4
    _, g = _normal(graph, scales, x, KERNELS["none"])
    for k in range(len(x)):
        e = np.zeros_like(x)
        e[k] = 1e-6
        slope = (_cost(graph, scales, x + e, KERNELS["none"]) - _cost(graph, scales, x - e, KERNELS["none"])) / 2e-6
        assert g[k] == pytest.approx(slope, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("robust", ["huber", "cauchy"])
def test_a_robust_kernel_resists_outliers(robust):
    graph, true, _ = made_up(True, np.random.default_rng(3), poses=20, points=12, outliers=15)
    plain = np.abs(solve(graph).poses - true)[:, :2].max()
    better = np.abs(solve(graph, robust=robust).poses - true)[:, :2].max()
    assert better < 0.7 * plain


def test_weights_are_the_slopes_of_the_losses():
    e = np.linspace(0.01, 6.0, 200)
    for loss, weight in KERNELS.values():
        np.testing.assert_allclose((loss(e + 1e-6) - loss(e - 1e-6)) / 2e-6, weight(e) * e, atol=1e-6)


def test_a_g2o_file_keeps_everything(tmp_path):
    graph, _, _ = made_up(False, np.random.default_rng(4))
    save_g2o(graph, tmp_path / "graph.g2o")
    again = load_g2o(tmp_path / "graph.g2o")
    for name in ("poses", "landmarks", "prior", "edges", "delta", "sightings", "z"):
        np.testing.assert_array_equal(getattr(again, name), getattr(graph, name))
    for name in ("prior_cov", "delta_cov", "R"):
        np.testing.assert_allclose(getattr(again, name), getattr(graph, name), rtol=1e-9, atol=1e-15)


def test_range_and_bearing_are_written_as_points(tmp_path):
    graph, _, _ = made_up(True, np.random.default_rng(5))
    save_g2o(graph, tmp_path / "graph.g2o")
    again = load_g2o(tmp_path / "graph.g2o")
    assert len(again.sightings) == len(graph.sightings)
    np.testing.assert_allclose(np.hypot(*again.z.T), graph.z[:, 0], rtol=1e-12)
    assert np.abs(solve(again).poses - solve(graph).poses).max() < 0.02


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE3 0 1 2\n", "2: EDGE_SE3"),
        ("VERTEX_SE2 0 0 0\n", "1: VERTEX_SE2 has 3 fields"),
        ("VERTEX_SE2 0 0 0 x\n", "1: VERTEX_SE2"),
        ("VERTEX_SE2 0 0 0 nan\n", "not finite"),
        ("VERTEX_XY 0 1 2\n", "no VERTEX_SE2"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2_XY 0 7 1 1 1 0 1\n", "2: an edge names vertex 7"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_XY 1 0 0\nEDGE_SE2_XY 0 1 1 1 1 2 1\n", "3: an information matrix"),
    ],
)
def test_broken_files_are_named(tmp_path, text, what):
    path = tmp_path / "broken.g2o"
    path.write_text(text)
    with pytest.raises(BrokenFile, match=what):
        load_g2o(path)


def test_a_run_is_smoothed():
    world = cloister(np.random.default_rng(6), odometry_noise=2.0)
    trace = run(world, associator="oracle", estimator=InvariantEKF(world.motion, world.sensor))
    graph = graph_of(trace, world)
    assert len(graph.poses) == len(world.steps)
    assert len(graph.sightings) == np.isin(trace.final_ids, graph.ids).sum()
    assert set(trace.final.ids[trace.final.stone]) <= set(graph.ids.tolist())
    smoothed = solve(graph)
    truth = np.array([s.truth.pose for s in world.steps])
    error = [np.sqrt(((p - truth)[:, :2] ** 2).sum(1).mean()) for p in (trace.pose, smoothed.poses)]
    assert error[1] < error[0]
    assert smoothed.cost[1] < smoothed.cost[0]


def test_a_landmark_of_an_old_map_that_was_never_seen_is_left_out():
    world = cloister(np.random.default_rng(6), laps=1)
    final = run(world, associator="oracle").final
    old = replace(
        final, ids=np.append(final.ids, final.ids.max() + 1), landmarks=np.vstack([final.landmarks, [[500.0, 500.0]]]),
        stone=np.append(final.stone, True), covs=np.concatenate([final.covs, np.eye(2)[None]]),
    )  # fmt: skip
    graph = graph_of(run(world, associator="jcbb", start_map=old), world)
    assert np.abs(graph.landmarks).max() < 100.0
    assert np.isfinite(solve(graph).poses).all()


def test_sightings_that_repeat_themselves_weigh_less():
    world = cloister(np.random.default_rng(6), laps=1)
    trace = run(world, associator="oracle", estimator=InvariantEKF(world.motion, world.sensor))
    plain = graph_of(trace, world)
    told = graph_of(trace, replace(world, sensor=replace(world.sensor, memory=(1e9, 0.0))))
    first = plain.sightings[:, 0] == plain.sightings[:, 0].min()
    np.testing.assert_array_equal(told.R[first], plain.R[first])
    assert (told.R[~first, 0, 0] > 1e3 * plain.R[~first, 0, 0]).all()
    np.testing.assert_array_equal(told.R[:, 1, 1], plain.R[:, 1, 1])


def test_a_mounted_sensor_gives_the_robots_poses():
    from tomthumb.models.sensor import RangeBearing
    from tomthumb.types import Control, Observations, Prior, Scenario, Step

    rng = np.random.default_rng(7)
    sensor = RangeBearing(mount=(1.5, 0.4, 0.7), std=(0.01, 0.005))
    points = rng.uniform(-5, 8, (10, 2))
    from tomthumb.models.motion import OdometryIncrement

    true, steps = np.zeros(3), []
    R = np.tile(np.diag(np.square(sensor.std)), (10, 1, 1))
    for k in range(15):
        move = np.array([0.5, 0.0, 0.2]) if k else np.zeros(3)
        true = geometry.compose(true, move)
        control = Control(move + [0.02, 0.02, 0.01] * rng.standard_normal(3) * bool(k), 1.0) if k else None
        z = sensor.expect(true, points)[0] + np.array(sensor.std) * rng.standard_normal((10, 2))
        steps.append((k, control, Observations(z, R), true))
    world = Scenario(
        "mounted", OdometryIncrement(std=(0.02, 0.02, 0.01)), sensor, Prior(np.zeros(3), np.eye(3) * 1e-8),
        [Step(float(k), c, o) for k, c, o, _ in steps],
    )  # fmt: skip
    trace = run(world, associator="jcbb", estimator=InvariantEKF(world.motion, sensor))
    smoothed = solve(graph_of(trace, world))
    truth = np.array([t for *_, t in steps])
    assert np.abs(smoothed.poses - truth).max() < 0.02


def test_what_cannot_be_is_named():
    graph, _, _ = made_up(True, np.random.default_rng(8))
    with pytest.raises(UnknownName, match="hubber"):
        solve(graph, robust="hubber")
    world = cloister(np.random.default_rng(9))
    trace = run(world, associator="oracle", estimator=InvariantEKF(world.motion, world.sensor))
    with pytest.raises(TomThumbError, match="scans"):
        graph_of(trace, replace(world, steps=[replace(s, observations=None) for s in world.steps]))
