"""Time of a filter step (predict, expect, update with 10 known observations) against the number of landmarks.

    OPENBLAS_NUM_THREADS=1 python benchmarks/step_cost.py [--sizes 100 200 500 1000 10000] [--peer mrpt.json ...]

"full": the map is worked on as a whole (`local=0`), every step passes over all of P. "tour": the robot circles among
nearby landmarks and moves on to the next place from time to time, regions on; amortised, with the costs of entering
and leaving them. "drive": it goes straight on for 25 m at 0.1 m a step, so that it leaves a region every few metres.
"usual" is the filter with the usual error, the others have the invariant one. The machine's limit stands beside: one
pass over the lower triangle of P, read and written. Times are CPU time, here and for the peers.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tomthumb import geometry
from tomthumb.estimators.ekf import EKF, InvariantEKF
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing
from tomthumb.types import Control, Observations

SPACING = 2.0  # m between landmarks on a grid
STD = np.array([0.1, 0.02])
MOVE = Control(np.array([0.1, 0.0, 0.05]), 1.0, np.diag([0.01, 0.01, 0.005]) ** 2)  # a circle of 2 m radius

DRIFT = np.diag([0.05, 0.05, 0.002]) ** 2


@dataclass
class Place:
    """A map of n landmarks on a grid, the robot in it; truth moves with the odometry's own noise left out."""

    n: int
    points: np.ndarray
    pose: np.ndarray
    rng: np.random.Generator

    def seen(self, count: int = 10) -> tuple[Observations, np.ndarray]:
        """The `count` nearest landmarks, observed."""
        away = ((self.points - self.pose[:2]) ** 2).sum(1)
        ids = np.argpartition(away, min(count, self.n - 1))[:count]
        local = geometry.to_frame(self.pose, self.points[ids])
        z = np.column_stack([np.hypot(*local.T), np.arctan2(local[:, 1], local[:, 0])])
        z = z + STD * self.rng.standard_normal(z.shape)
        return Observations(z, np.tile(np.diag(STD**2), (len(ids), 1, 1))), ids


def grown(n: int, make, rng, drift=DRIFT):
    """Place, filter and belief that knows all n landmarks, each seen once.

    After every 100 of them the odometry's `drift` (a covariance, or None) is added, so that their errors are those of
    a long drive: alike nearby, independent in part far away.
    """
    side = int(np.ceil(np.sqrt(n)))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)[:n] * SPACING
    points = grid + 0.3 * rng.standard_normal(grid.shape)
    place = Place(n, points, np.array([side * SPACING / 2, side * SPACING / 2, 0.0]), rng)
    sensor = RangeBearing(max_range=4.0, std=tuple(STD))
    ekf = make(OdometryIncrement(), sensor)
    belief = ekf.init(place.pose.copy(), np.diag([0.01, 0.01, 0.002]) ** 2, rng)
    for start in range(0, n, 100):
        ids = np.arange(start, min(start + 100, n))
        local = geometry.to_frame(place.pose, points[ids])
        z = np.column_stack([np.hypot(*local.T), np.arctan2(local[:, 1], local[:, 0])])
        R = np.tile(np.diag([0.05, 0.05 / np.hypot(side, side)]) ** 2, (len(ids), 1, 1))
        every = [ids] * getattr(ekf, "particles", 1)
        belief = ekf.promote(ekf.add(belief, Observations(z, R), every, rng), ids)
        if drift is not None:
            belief = replace(ekf, local=0).predict(belief, Control(np.zeros(3), 1.0, drift), rng)
    return place, ekf, belief


def step(place, ekf, belief, control, rng):
    """Belief after a motion and a scan, and the seconds that the filter took."""
    place.pose = geometry.compose(place.pose, control.u)
    seen, ids = place.seen()
    begin = time.process_time()
    belief = ekf.predict(belief, control, rng)
    ekf.expect(belief)
    belief = ekf.update(belief, seen, [ids], rng)
    return belief, time.process_time() - begin


def tour(place, ekf, belief, steps: int, stay: int, rng) -> np.ndarray:
    """Seconds of each step; after `stay` steps the robot is led 3 landmarks' spacing on."""
    seconds = np.empty(steps)
    centre = place.pose.copy()
    for k in range(steps):
        control = MOVE
        if k and k % stay == 0:
            target = np.array([centre[0] + 3 * SPACING * (k // stay % 2), centre[1], 0.0])
            control = Control(geometry.between(place.pose, target), 1.0, MOVE.cov)
        belief, seconds[k] = step(place, ekf, belief, control, rng)
    return seconds


def drive(place, ekf, belief, steps: int, rng) -> np.ndarray:
    """Seconds of each step of a straight way."""
    ahead, seconds = Control(np.array([0.1, 0.0, 0.0]), 1.0, MOVE.cov), np.empty(steps)
    for k in range(steps):
        belief, seconds[k] = step(place, ekf, belief, ahead, rng)
    return seconds


def one_pass(n: int) -> float:
    """Seconds to read and write the lower triangle of P once (a plain vector of that length)."""
    triangle = np.zeros((2 * n + 3) * (2 * n + 4) // 2)
    best = np.inf
    for _ in range(7):
        begin = time.process_time()
        triangle += 1e-9
        best = min(best, time.process_time() - begin)
    return best


def measure(n: int, steps: int, stay: int) -> dict[str, float]:
    """One row of the table, ms."""
    row = {"landmarks": n, "one_pass_ms": 1e3 * one_pass(n)}
    whole = {"local": 0}
    kinds = {
        "full": (InvariantEKF, whole, 12),
        "full_usual": (EKF, whole, 12),
        "tour": (InvariantEKF, {}, steps),
        "tour_usual": (EKF, {}, steps),
    }
    for name, (make, settings, count) in kinds.items():
        rng = np.random.default_rng(0)
        place, ekf, belief = grown(n, lambda m, s, make=make, settings=settings: make(m, s, **settings), rng)
        seconds = tour(place, ekf, belief, count + 3, stay, rng)[3:]
        row[f"{name}_ms"] = 1e3 * float(np.median(seconds) if count == 12 else seconds.mean())
        if count != 12:
            row[f"{name}_p50_ms"] = 1e3 * float(np.median(seconds))
        if name == "tour":
            row["drive_ms"] = 1e3 * float(drive(place, ekf, belief, 250, rng).mean())
        del belief
    row["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return row


def main() -> None:
    """The table, and peers' times beside it where their JSON files ({"name": ..., "ms": {"1000": ...}}) are given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 200, 500, 1000])
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--stay", type=int, default=200, help="steps among the same landmarks")
    parser.add_argument("--peer", type=Path, nargs="*", default=[])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    peers = [json.loads(path.read_text()) for path in options.peer]
    measure(300, 20, 10)  # compiles
    rows = []
    for n in options.sizes:
        row = measure(n, options.steps, options.stay)
        rows.append(row)
        print("  ".join(f"{k} {v:.3g}" for k, v in row.items()), flush=True)
        for peer in peers:
            if str(n) in peer["ms"]:
                ms = peer["ms"][str(n)]
                ratio = f"{ms / row['full_ms']:.0f} x full, {ms / row['tour_ms']:.0f} x tour"
                print(f"    {peer['name']}: {ms:.3g} ms = {ratio}")
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
