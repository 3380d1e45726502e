"""Controls and scans, each at their own times, brought into one order of steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tomthumb.geometry import compose, to_world
from tomthumb.scenarios.reading import Steps
from tomthumb.types import Array, Control, Ids, Observations, Step, Truth

Scan = Callable[[int], tuple[Observations, Truth | None]]


@dataclass(frozen=True, slots=True)
class Timeline:
    """The events: by `t (K,)` s control row `held (K,)` was at work, and scan `scan (K,)` is taken (-1 none)."""

    t: Array
    held: Ids
    scan: Ids


def timeline(control_t: Array, scan_t: Array, start: float, *, skip_first: bool = False) -> Timeline:
    """Merge the times of controls and of scans (both increasing) from `start` s on.

    A control holds from its own time until the next: what moved the robot up to an event is the last control at or
    before the event before it. A scan at the very time of a control shares its event. With `skip_first` no
    event is made for `start` itself.
    """
    t = np.unique(np.concatenate([control_t, scan_t, [start]]))
    t = t[t > start] if skip_first else t[t >= start]
    before = np.concatenate([[start], t[:-1]])
    held = np.maximum(np.searchsorted(control_t, before, side="right") - 1, 0)
    at = np.searchsorted(scan_t, t)
    scan = np.where((at < len(scan_t)) & (np.append(scan_t, np.inf)[at] == t), at, -1)
    return Timeline(t, held, scan)


def steps(line: Timeline, u: Array, scan: Scan, cov: Array | None = None) -> Steps:
    """The lazy steps of a timeline: controls `u (n, k)`, ``scan(i)`` the i-th scan; the first event has no control."""

    def make(k: int) -> Step:
        t = float(line.t[k])
        control = Control(u[line.held[k]], t - float(line.t[k - 1]), cov) if k else None
        if line.scan[k] < 0:
            return Step(t, control, None)
        return Step(t, control, *scan(int(line.scan[k])))

    return Steps(len(line.t), make)


@dataclass(frozen=True, slots=True)
class Scans:
    """Rows of observations grouped by time: scan i is rows `cuts[i]` to `cuts[i + 1]`, taken at `t[i]` s."""

    t: Array
    cuts: Ids

    def rows(self, i: int) -> slice:
        return slice(int(self.cuts[i]), int(self.cuts[i + 1]))


def group(t: Array) -> Scans:
    """Rows with equal times `t (n,)` (not decreasing) make one scan."""
    times, starts = np.unique(t, return_index=True)
    return Scans(times, np.append(starts, len(t)))


def stack(t: Array, counts: Sequence[int]) -> Scans:
    """Scans at `t (n,)` s with so many rows each, one after the other."""
    return Scans(t, np.concatenate([[0], np.cumsum(np.asarray(counts, np.int64))]).astype(np.int64))


def name_by_place(
    pose: Array, z: Array, landmarks: Array, within: float, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Ids:
    """The nearest landmark at most `within` m from each observation (range m, bearing rad) made at `pose`, or -1.

    All -2 (not known) where the pose is not known.
    """
    if not np.isfinite(pose).all():
        return np.full(len(z), -2, np.int64)
    points = np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])
    places = to_world(compose(pose, np.array(mount)), points)
    apart = np.linalg.norm(places[:, None] - landmarks[None], axis=2)
    nearest = np.argmin(apart, axis=1) if len(landmarks) else np.full(len(z), -1)
    close = apart.min(axis=1, initial=np.inf) <= within
    return np.where(close, nearest, -1).astype(np.int64)
