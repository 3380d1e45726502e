"""How the camera of the DLR log bends the plane, from the log's own sightings of the same circle; no truth is used.

    python benchmarks/dlr_camera.py DATA/dlr_spatial_cognition [--gap 30]

Two sightings of one circle, 3 to `gap` steps apart, must agree once the odometry between them is taken into account. Fitted
together by robust least squares: the odometry's scale and heading bias, and how far a circle seen f m ahead and x m
aside really is, f + c0 + c1 (f - 2) + c2 (f - 2)^2 and x (1 + c3 (f - 2)): what a camera with an error of pitch and height
does. Sideways distances 2 m ahead are taken as they are, so they define the metre. Standard errors are those of
independent sightings, so too small.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.optimize import least_squares

from tomthumb.scenarios.catalogue import load
from tomthumb.scenarios.dlr import rectified

NAMES = ("scale", "heading_bias rad", "c0 m", "c1", "c2 1/m", "c3 1/m")
STD = 0.05  # m, where the robust loss begins to bend


def sightings(steps, gap: int):
    """Steps (n,) and places (n, 2) m of the first and of the second sighting of each pair."""
    seen: dict[int, list] = {}
    for k, step in enumerate(steps):
        if step.truth is not None and step.truth.ids is not None:
            for i, z in zip(step.truth.ids.tolist(), step.observations.z, strict=True):
                if i >= 0:
                    seen.setdefault(i, []).append((k, z))
    pairs = [
        (a, b)
        for track in seen.values()
        for n, a in enumerate(track)
        for b in track[n + 1 :]
        if 3 <= b[0] - a[0] <= gap
    ]
    columns = [np.array([p[side][part] for p in pairs]) for side in (0, 1) for part in (0, 1)]
    return columns[0], columns[2], columns[1], columns[3]


def reckoned(u: np.ndarray, scale: float, bias: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (K, 2) and headings (K,) by odometry with its errors taken out."""
    heading = np.cumsum(u[:, 2] + bias)
    before = np.concatenate([[0.0], heading[:-1]])
    return np.cumsum((1.0 + scale) * turned(u[:, :2], before), 0), heading


def turned(points: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors (n, 2), each turned by its angle (n,)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]])


def main() -> None:
    """The fit without and with the camera's errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log")
    parser.add_argument("--gap", type=int, default=30, help="steps between two sightings, at most")
    options = parser.parse_args()
    steps = list(load(options.log).steps)
    u = np.array([np.zeros(3) if s.control is None else s.control.u for s in steps])
    first, second, one, other = sightings(steps, options.gap)

    def residual(v: np.ndarray) -> np.ndarray:
        place, heading = reckoned(u, v[0], v[1])
        camera = np.concatenate([v[2:], np.zeros(6 - len(v))])
        world = []
        for k, z in ((first, one), (second, other)):
            world.append(place[k] + turned(rectified(z, camera), heading[k]))
        return (turned(world[0] - world[1], -heading[first]) / STD).ravel()  # in the robot's frame: a turn is no error

    for size, title in ((2, "odometry alone"), (6, "with the camera")):
        fit = least_squares(residual, np.zeros(size), loss="soft_l1")
        error = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
        print(f"{title}, {len(first)} pairs, cost {fit.cost:.0f}")
        for name, value, std in zip(NAMES, fit.x, error, strict=False):
            print(f"  {name:16s} {value:+.5f} +- {std:.5f}")


if __name__ == "__main__":
    main()
