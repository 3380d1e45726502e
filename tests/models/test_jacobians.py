"""Every analytic Jacobian against central differences, and the models against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tomthumb.geometry import align, between, compose, compose_jacobians, inverse, to_frame, to_world, wrap
from tomthumb.kernels.ekf import move
from tomthumb.kernels.odometry import arc
from tomthumb.models.motion import Ackermann, OdometryIncrement, Velocity
from tomthumb.models.sensor import Cartesian, RangeBearing
from tomthumb.types import Control

STEP = 1e-6
SENSORS = [
    RangeBearing(mount=(0.3, -0.2, 0.4)),
    Cartesian(mount=(0.3, -0.2, 0.4)),
    RangeBearing(),
    Cartesian(facing=-np.pi / 2),
]


def numeric(f, x):
    """Derivative of f by x, (..., len(x)), by central differences."""
    return np.stack([(f(x + STEP * e) - f(x - STEP * e)) / (2 * STEP) for e in np.eye(len(x))], -1)


@pytest.mark.parametrize("sensor", SENSORS, ids=repr)
def test_sensor_jacobians(sensor):
    rng = np.random.default_rng(4)
    for _ in range(20):
        check_sensor(sensor, rng.normal(size=3), rng.normal(size=(5, 2)) * 4 + 5)


def check_sensor(sensor, pose, points):
    z, by_pose, by_point = sensor.expect(pose, points)
    assert_allclose(by_pose, numeric(lambda p: sensor.expect(p, points)[0], pose), atol=1e-6)
    assert_allclose(by_point, numeric(lambda d: sensor.expect(pose, points + d)[0], np.zeros(2)), atol=1e-6)
    back, from_pose, from_z = sensor.locate(pose, z)
    assert_allclose(back, points, atol=1e-12)
    assert_allclose(from_pose, numeric(lambda p: sensor.locate(p, z)[0], pose), atol=1e-6)
    assert_allclose(from_z, numeric(lambda d: sensor.locate(pose, z + d)[0], np.zeros(2)), atol=1e-5)


MOTIONS = [
    (Velocity(std=(0.3, 0.2)), np.array([1.3, 0.7])),
    (Velocity(std=(0.3, 0.2)), np.array([1.3, 1e-9])),
    (Ackermann(std=(0.3, 0.1)), np.array([3.0, 0.25])),
    (Ackermann(std=(0.3, 0.1), ahead=3.78, left=0.5), np.array([3.0, -0.25])),
    (OdometryIncrement(std=(0.1, 0.2, 0.3)), np.array([0.3, 0.1, -0.2])),
]


@pytest.mark.parametrize(("motion", "u"), MOTIONS)
def test_motion_covariance_is_the_propagated_noise(motion, u):
    dt = 0.2
    _, cov = motion.increment(Control(u, dt))
    J = numeric(lambda v: motion.increment(Control(v, dt))[0], u)
    assert_allclose(cov, J @ np.diag(np.square(motion.std)) @ J.T, atol=1e-8)


def test_ackermann_point_moves_as_the_published_equations():
    car, dt = Ackermann(ahead=3.78, left=0.5), 1e-4
    speed, steering, phi = 4.0, 0.3, 0.8
    v = speed / (1 - np.tan(steering) * car.encoder_offset / car.wheel_base)
    turn = v / car.wheel_base * np.tan(steering)
    rate = [
        v * np.cos(phi) - turn * (3.78 * np.sin(phi) + 0.5 * np.cos(phi)),
        v * np.sin(phi) + turn * (3.78 * np.cos(phi) - 0.5 * np.sin(phi)),
        turn,
    ]
    pose = np.array([1.0, 2.0, phi])
    delta, _ = car.increment(Control(np.array([speed, steering]), dt))
    assert_allclose((compose(pose, delta) - pose) / dt, rate, rtol=1e-3)


@given(st.floats(-6, 6), st.floats(-3, 3))
def test_arc_is_the_limit_of_small_straight_steps(distance, turn):
    n = 2000
    heading = turn * (np.arange(n) + 0.5) / n
    straight = distance / n * np.array([np.cos(heading).sum(), np.sin(heading).sum()])
    assert_allclose(arc(distance, turn)[0][:2], straight, atol=1e-5)


poses = st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3)).map(np.array)


@given(poses, poses, poses)
def test_group_laws(a, b, c):
    assert_allclose(compose(compose(a, b), c)[:2], compose(a, compose(b, c))[:2], atol=1e-9)
    assert_allclose(compose(a, inverse(a)), 0.0, atol=1e-9)
    again = compose(a, between(a, b)) - b
    assert_allclose([*again[:2], wrap(again[2])], 0.0, atol=1e-9)


@given(poses, poses)
def test_compose_jacobians(a, b):
    by_a, by_b = compose_jacobians(a, b)

    def change(x, y):
        d = compose(x, y) - compose(a, b)
        return np.array([d[0], d[1], float(wrap(d[2]))])

    assert_allclose(by_a, numeric(lambda x: change(x, b), a), atol=1e-6)
    assert_allclose(by_b, numeric(lambda y: change(a, y), b), atol=1e-6)


def test_align_finds_the_motion():
    rng = np.random.default_rng(0)
    points, pose = rng.normal(size=(30, 2)), np.array([3.0, -2.0, 2.5])
    assert_allclose(align(points, to_world(pose, points)), pose, atol=1e-12)
    assert_allclose(to_frame(pose, to_world(pose, points)), points, atol=1e-12)


def test_field_of_view_follows_the_uncertainty():
    sensor = RangeBearing(max_range=5.0, fov=np.pi)
    z, sure = np.array([[3.0, 0.1], [5.5, 0.0], [3.0, 2.0], [5.0, 0.0]]), np.full((4, 2), 1e-8)
    assert_allclose(sensor.in_view(z, sure), [1, 0, 0, 0.5], atol=1e-9)
    assert 0.1 < sensor.in_view(z, np.full((4, 2), 0.5))[1] < 0.5
    flat = Cartesian(max_range=5.0, fov=np.pi)
    points = np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])
    assert_allclose(flat.in_view(points, sure), [1, 0, 0, 0.5], atol=1e-9)


@given(st.floats(-4, 8), st.floats(-0.6, 0.6), st.floats(0.001, 0.3), st.floats(-3, 3))
def test_moving_the_filter_is_composing(speed, steering, dt, heading):
    car = Ackermann(ahead=1.0, left=0.2, pose_std=(0.02, 0.03, 0.01))
    delta, cov = car.increment(Control(np.array([speed, steering]), dt))
    rng = np.random.default_rng(3)
    A = rng.normal(size=(7, 7))
    P, x = np.asfortranarray(A @ A.T), np.array([1.0, 2.0, heading, *rng.normal(size=4)])
    F, G = compose_jacobians(x[:3], delta)
    J = rng.normal(size=(3, 2))
    D = np.eye(7)
    D[:3, :3], D[:3, 3:5] = F, G @ J
    wanted, pose = D @ P @ D.T, compose(x[:3], delta)
    wanted[:3, :3] += G @ cov @ G.T
    move(P, x, 7, *delta.tolist(), cov, J)
    assert_allclose(np.tril(P), np.tril(wanted), atol=1e-12)
    assert_allclose(x[:3], pose, atol=1e-14)
