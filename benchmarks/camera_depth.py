"""MRCLAM's sightings against Vicon: are they ranges, or depths along the camera's axis? Residuals as either, by robot.

python benchmarks/camera_depth.py [--data FOLDER]      # the folder of the set, as `mrclam:FOLDER` takes it

For each robot: rms of the range's residual, of the numbers as they stand and of the ranges that the loader makes of them; the
share of the former's variance that r (1 - cos bearing) explains; the scale of depth that fits this robot best; rms and bias of
the bearing. Sightings off by 0.5 m or 6 deg are left out, and counted.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from tomthumb.geometry import wrap
from tomthumb.scenarios.mrclam import ROBOTS, mrclam
from tomthumb.types import Array, Scenario

GROSS = np.array([0.5, np.radians(6.0)])  # m, rad


def sightings(scenario: Scenario) -> tuple[Array, Array]:
    """Measured range and bearing, and those that Vicon's poses and landmarks give, (n, 2) each."""
    assert scenario.landmarks is not None
    measured, true = [], []
    for step in scenario.steps:
        if step.observations is None or step.truth is None or step.truth.pose is None or step.truth.ids is None:
            continue
        measured.append(step.observations.z)
        true.append(scenario.sensor.expect(step.truth.pose, scenario.landmarks[step.truth.ids])[0])
    return np.concatenate(measured), np.concatenate(true)


def fine(measured: Array, true: Array) -> tuple[Array, Array]:
    """Residuals (n, 2) and which of them (n,) are not gross."""
    away = measured - true
    away[:, 1] = wrap(away[:, 1])
    return away, (np.abs(away) < GROSS).all(1)


def told(folder: Path, robot: int) -> str:
    """One robot's line."""
    raw, true = sightings(mrclam(folder, robot=robot, depth=0))
    away, good = fine(raw, true)
    lost = (raw[:, 0] * (1.0 - np.cos(raw[:, 1])))[good]
    explained = np.corrcoef(lost, away[good, 0])[0, 1] ** 2
    ahead = true[good, 0] * np.cos(true[good, 1])
    scale = float(raw[good, 0] @ ahead / (ahead @ ahead))
    ranges, inside = fine(sightings(mrclam(folder, robot=robot))[0], true)
    rms = [float(np.sqrt(np.mean(a**2))) for a in (away[good, 0], ranges[inside, 0], ranges[inside, 1])]
    return (
        f"robot {robot}: range off by {rms[0]:.3f} m rms as it stands, {rms[1]:.3f} m made of depth; r (1 - cos bearing) explains "
        f"{explained:.0%}; depth is {scale:.3f} of the true; bearing off by {np.degrees(rms[2]):.2f} deg rms, "
        f"{np.degrees(ranges[inside, 1].mean()):+.2f} on average; gross {1.0 - inside.mean():.2%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("TOMTHUMB_DATA", "../shared/data")) / "utias_mrclam"
    parser.add_argument("--data", type=Path, default=default)
    folder = parser.parse_args().data
    for robot in range(1, ROBOTS + 1):
        print(told(folder, robot))


if __name__ == "__main__":
    main()
