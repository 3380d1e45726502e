"""What the Python peers are given: n landmarks, the ten nearest seen by range and bearing, and the loop that times them."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

NOISE = np.array([0.1, 0.02] * 10)  # m, rad
MOTION = np.array([0.01, 0.01, 0.005])  # m, m, rad


@dataclass(frozen=True)
class Scene:
    """The first state x (3 + 2 n,), pose first, the landmarks `near` (10,) that are seen, and a random stream."""

    x: np.ndarray
    near: np.ndarray
    rng: np.random.Generator

    def expected(self, x: np.ndarray) -> np.ndarray:
        """Range and bearing (20,) of what is seen from the state x."""
        away = x[3:].reshape(-1, 2)[self.near] - x[:2]
        return np.column_stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - x[2]]).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Its derivative (20, 3 + 2 n), dense, as these libraries want it."""
        H = np.zeros((20, len(x)))
        for k, i in enumerate(self.near):
            dx, dy = x[3 + 2 * i : 5 + 2 * i] - x[:2]
            q = dx * dx + dy * dy
            r = np.sqrt(q)
            D = np.array([[dx / r, dy / r], [-dy / q, dx / q]])
            H[2 * k : 2 * k + 2, :2], H[2 * k + 1, 2] = -D, -1.0
            H[2 * k : 2 * k + 2, 3 + 2 * i : 5 + 2 * i] = D
        return H

    def process_noise(self) -> np.ndarray:
        """Covariance (3 + 2 n, 3 + 2 n) of a motion."""
        Q = np.zeros((len(self.x), len(self.x)))
        Q[:3, :3] = np.diag(MOTION**2)
        return Q

    def observed(self, x: np.ndarray) -> np.ndarray:
        """The ten landmarks as they are seen, with noise (20,)."""
        return self.expected(x) + NOISE * self.rng.standard_normal(20)


def scene(n: int) -> Scene:
    """n landmarks in a square of 100 m, the robot in the middle."""
    rng = np.random.default_rng(0)
    landmarks = rng.uniform(-50, 50, (n, 2))
    near = np.argsort((landmarks**2).sum(1))[:10]
    return Scene(np.concatenate([np.zeros(3), landmarks.ravel()]), near, rng)


def told(
    name: str, filter_of: Callable[[Scene], tuple[Callable[[], np.ndarray], Callable[[np.ndarray], None]]]
) -> None:
    """JSON for step_cost.py --peer, of the sizes on the command line: median ms of predict and update.

    `filter_of` gives the filter's state (3 + 2 n,) when asked, and its step with an observation (20,).
    """
    print(json.dumps({"name": name, "ms": {n: _measured(int(n), filter_of) for n in sys.argv[1:]}}))


def _measured(
    n: int, filter_of: Callable[[Scene], tuple[Callable[[], np.ndarray], Callable[[np.ndarray], None]]]
) -> float:
    place = scene(n)
    state, step = filter_of(place)
    seconds = []
    for _ in range(5 if n >= 500 else 20):
        z = place.observed(state())
        begin = time.process_time()
        step(z)
        seconds.append(time.process_time() - begin)
    return 1e3 * float(np.median(seconds))
