"""Formula Student cone logs of Prom Racing (NTUA): velocities at 40 Hz, cones with colours from cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.geometry import between, compose, wrap
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.reading import Steps, floats, numbers, read_bytes, read_text, whole
from tomthumb.types import Array, Control, Ids, Observations, Prior, Scenario, Step

COLOURS = ("yellow", "blue", "orange", "large orange")
DT = 0.025  # s, one sample
SAMPLE = 13  # numbers
FRAME_STD = (0.02, 0.02, 0.003)  # m, m, rad a frame: the lap closes to 2 to 10 m after 250 m and 500 frames
# With dead reckoning cones within 8 m scatter by 0.2 to 0.4 m a lap; the range error grows with the distance.
RANGE_STD, RANGE_SHARE, BEARING_STD = 0.1, 0.02, math.radians(1.0)
FOV = math.radians(110.0)


@dataclass(frozen=True, slots=True)
class Block:
    """What one camera saw at one sample: colours, ranges m, bearings rad."""

    index: int
    labels: Ids
    z: Array


def cones(path: Path, *, log: str = "", r_max: float = 10.0) -> Scenario:
    """One lap: a folder with NAME_perceptionLog_N.txt and NAME_velocityLog_N*.txt, or one of the two.

    `log` names one of several as "NAME_N" (the first by name if empty). Labels are colours: 0 yellow, 1 blue,
    2 orange, 3 large orange. Detections beyond `r_max` m are left out, since they are poor. Each block of the log is a
    scan of its own, for two cameras may show one cone at one time. There is no truth. Angles keep the log's sign.

    Raises BrokenFile for files that are not such logs, TomThumbError for a `log` that is not there.
    """
    if not r_max > 0.0:
        raise TomThumbError(f"cones: r_max={r_max}: more than 0 m")
    seen_file, speed_file = _files(Path(path), log)
    samples = _samples(speed_file)
    blocks = [_near(block, r_max) for block in _blocks(seen_file)]
    if not blocks:
        raise BrokenFile(seen_file, "holds no detections")
    motions = _motions(samples, np.array([block.index for block in blocks]))
    R = [_noise(block.z[:, 0]) for block in blocks]

    def step(k: int) -> Step:
        block = blocks[k]
        same = k > 0 and block.index == blocks[k - 1].index
        dt = 0.0 if k == 0 else (block.index - blocks[k - 1].index) * DT
        cov = np.diag(np.square(FRAME_STD)) * dt / (8 * DT)
        control = None if k == 0 or same else Control(motions[k], dt, cov)
        return Step(block.index * DT, control, Observations(block.z, R[k], block.labels))

    return Scenario(
        name=seen_file.name.split(".")[0].replace("_perceptionLog", ""),
        motion=OdometryIncrement(std=FRAME_STD),
        sensor=RangeBearing(max_range=r_max, fov=FOV, std=(RANGE_STD, BEARING_STD), detect=0.5, clutter=5e-3),
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        steps=Steps(len(blocks), step),
        info={"file": str(seen_file), "labels": COLOURS},
    )


def _files(path: Path, log: str) -> tuple[Path, Path]:
    folder = path if path.is_dir() else path.parent
    found = {_key(p): p for p in sorted(folder.glob("*perceptionLog*.txt*"))}
    speeds = {_key(p): p for p in sorted(folder.glob("*velocityLog*.txt*"))}
    both = sorted(found.keys() & speeds.keys())
    if not both:
        raise BrokenFile(folder, "holds no perceptionLog with its velocityLog")
    key = log or (_key(path) if path.is_file() else both[0])
    if key not in both:
        raise TomThumbError(f"{folder}: no log {key!r}; valid: {', '.join(both)}")
    return found[key], speeds[key]


def _key(file: Path) -> str:
    """ "Testing4_10" of Testing4_velocityLog_10_corrected.txt.xz."""
    words = file.name.split(".")[0].replace("_corrected", "").split("_")
    return "_".join(word for word in words if word not in ("perceptionLog", "velocityLog"))


def _samples(file: Path) -> Array:
    """Rows (n, 13) of index, vx, vy, yaw rate and covariance; an unfinished last one is dropped."""
    flat = numbers(read_bytes(file), file)
    rows = flat[: len(flat) // SAMPLE * SAMPLE].reshape(-1, SAMPLE)
    if not len(rows) or (np.diff(whole(rows[:, 0], file, "a sample's index")) <= 0).any():
        raise BrokenFile(file, "the samples' indices do not increase")
    if (np.abs(rows[:, 1:4]) > 1e3).any():
        raise BrokenFile(file, "a velocity is beyond all reason")
    return rows


def _blocks(file: Path) -> list[Block]:
    lines = read_text(file).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    out: list[Block] = []
    for k in range(0, len(lines) - 3, 4):
        index, colour, r, b = (np.array(floats(lines[k + j].split(), file, k + j + 1)) for j in range(4))
        if len(index) != 1 or not len(colour) == len(r) == len(b):
            raise BrokenFile(file, "a block is not index, colours, ranges, bearings of one length", k + 1)
        labels = whole(colour, file, "a colour")
        if len(labels) and (labels.min() < 0 or labels.max() >= len(COLOURS) or r.min() < 0):
            raise BrokenFile(file, f"a colour is not 0 to {len(COLOURS) - 1}, or a range negative", k + 2)
        number = int(whole(index, file, "an index")[0])
        if out and number < out[-1].index:
            raise BrokenFile(file, f"the index runs back to {number}", k + 1)
        out.append(Block(number, labels, np.column_stack([r, wrap(b)])))
    return out


def _near(block: Block, r_max: float) -> Block:
    keep = (block.z[:, 0] < r_max) & (block.z[:, 0] > 0)
    return Block(block.index, block.labels[keep], block.z[keep])


def _noise(r: Array) -> Array:
    R = np.zeros((len(r), 2, 2))
    R[:, 0, 0], R[:, 1, 1] = np.square(RANGE_STD + RANGE_SHARE * r), BEARING_STD**2
    return R


def _motions(samples: Array, index: Ids) -> Array:
    """The increment (K, 3) from each block's sample to the next's, each sample's velocities held until the next."""
    steps = np.diff(samples[:, 0]) * DT
    poses = [np.zeros(3)]
    for (vx, vy, rate), dt in zip(samples[:-1, 1:4], steps, strict=True):
        half = 0.5 * rate * dt  # the velocity turns with the car: taken at the middle of the sample
        c, s = math.cos(half), math.sin(half)
        poses.append(compose(poses[-1], np.array([(c * vx - s * vy) * dt, (s * vx + c * vy) * dt, rate * dt])))
    at = np.array(poses)[np.clip(np.searchsorted(samples[:, 0], index), 0, len(samples) - 1)]
    out = np.zeros((len(index), 3))
    for k in range(1, len(index)):
        out[k] = between(at[k - 1], at[k])
    return out
