"""MRCLAM's commands against Vicon: after which delay they act, how much of a turn and a way is made, the worst slips.

python benchmarks/command_delay.py [--data FOLDER]      # the folder of the set, with RobotN_*.dat or .dat.xz
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from tomthumb.scenarios.reading import read_bytes, table
from tomthumb.types import Array

DELAYS = np.arange(0.0, 0.61, 0.05)  # s
TURNS = (1.0, 0.97, 0.95, 0.93, 0.91)
SPANS = (1, 5, 20, 60)  # s


def read(folder: Path, name: str, columns: int) -> Array:
    """A file of the set, packed or not."""
    file = next(f for f in (folder / f"{name}.dat", folder / f"{name}.dat.xz") if f.exists())
    return table(read_bytes(file), file, columns)


def heading_error(folder: Path, robot: int, delay: float, turn: float) -> Array:
    """Commanded minus true heading at every second, rad; only its differences mean anything."""
    odometry, truth = read(folder, f"Robot{robot}_Odometry", 3), read(folder, f"Robot{robot}_Groundtruth", 4)
    made = np.append(0.0, np.cumsum(odometry[:-1, 2] * np.diff(odometry[:, 0])))
    t = np.arange(max(odometry[0, 0], truth[0, 0]) + 5, min(odometry[-1, 0], truth[-1, 0]) - 5)
    found: Array = turn * np.interp(t - delay, odometry[:, 0], made)
    return found - np.interp(t, truth[:, 0], np.unwrap(truth[:, 3]))


def rms_deg(error: Array, span: int) -> float:
    """RMS error of the turn over `span` s, degrees."""
    return float(np.degrees(np.sqrt(np.mean((error[span:] - error[:-span]) ** 2))))


def as_noise(folder: Path, robot: int, delay: float = 0.25, turn: float = 0.95, speed: float = 0.91) -> str:
    """Share of the commanded distance that is made, and the noise of each command that gives the errors over SPANS."""
    odometry, truth = read(folder, f"Robot{robot}_Odometry", 3), read(folder, f"Robot{robot}_Groundtruth", 4)
    held = np.diff(odometry[:, 0])
    t = np.arange(max(odometry[0, 0], truth[0, 0]) + 5, min(odometry[-1, 0], truth[-1, 0]) - 5)
    told = np.interp(t - delay, odometry[:, 0], np.append(0.0, np.cumsum(odometry[:-1, 1] * held)))
    x, y = (np.interp(t, truth[:, 0], truth[:, k]) for k in (1, 2))
    made = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    per_second = np.sqrt((held**2).sum() / held.sum())  # std of a second's sum for commands of std 1
    heading = np.radians([rms_deg(heading_error(folder, robot, delay, turn), span) for span in SPANS])
    gap = speed * told - made
    distance = [np.sqrt(np.mean((gap[span:] - gap[:-span]) ** 2)) for span in SPANS]
    v, w = (np.array(rms) / np.sqrt(SPANS) / per_second for rms in (distance, heading))
    share = made[-1] / (told[-1] - told[0])
    return f"{share:.2f} of the distance is made; noise over {SPANS} s: {v.round(2)} m/s, {w.round(2)} rad/s"


def slips(error: Array, span: int = 10, count: int = 3) -> str:
    """The largest errors of the turn over `span` s, at least 20 s apart: when (s from the start), how much (deg)."""
    made = np.degrees(error[span:] - error[:-span])
    told = []
    for _ in range(count):
        k = int(np.argmax(np.abs(made)))
        told.append(f"{made[k]:+.0f} deg at {k + span // 2 + 5} s")
        made[max(0, k - 20) : k + 20] = 0.0
    return ", ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("TOMTHUMB_DATA", "../shared/data")) / "utias_mrclam" / "MRCLAM_Dataset7"
    parser.add_argument("--data", type=Path, default=default)
    folder = parser.parse_args().data
    for robot in range(1, 6):
        errors = {delay: rms_deg(heading_error(folder, robot, delay, 1.0), 1) for delay in DELAYS.tolist()}
        best = min(errors, key=lambda delay: errors[delay])
        print(f"robot {robot}: turn over 1 s off by {errors[0.0]:.1f} deg; delay {best:.2f} s: {errors[best]:.1f} deg")
    for turn in TURNS:
        robots = [heading_error(folder, robot, 0.25, turn) for robot in range(1, 6)]
        told = [f"{span} s " + "/".join(f"{rms_deg(error, span):.1f}" for error in robots) for span in SPANS]
        print(f"delay 0.25 s, turn {turn}: off by (robots 1 to 5, deg) {', '.join(told)}")
    for robot in range(1, 6):
        print(f"robot {robot}: {as_noise(folder, robot)}")
        print(f"robot {robot}: largest slips over 10 s: {slips(heading_error(folder, robot, 0.25, 0.95))}")


if __name__ == "__main__":
    main()
