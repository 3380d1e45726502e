"""A run as a factor graph: a pose for every scan, odometry between them, sightings of the landmarks that survived."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tomthumb import geometry
from tomthumb.errors import TomThumbError
from tomthumb.models.calibration import check, corrected
from tomthumb.protocols import Motion, Sensor
from tomthumb.sensing import news, travelled
from tomthumb.types import Array, Control, Ids, Observations, Scenario, Step, Trace

FLOOR = np.array([1e-3, 1e-3, 1e-4])  # m, m, rad: wheels slip; and every factor needs a weight


@dataclass(frozen=True)
class Graph:
    """Poses are those of the sensor in the world; `mount` is the sensor on the robot.

    poses (K, 3), landmarks (n, 2): first guess. steps (K,): the run's step of each pose; ids (n,) of landmarks.
    prior (3,) of pose 0, with prior_cov (3, 3) in its own frame. edges (E, 2): from pose, to pose, with the motion
    delta (E, 3) and its covariance (E, 3, 3) in the frame at its end (the convention of g2o and gtsam). sightings
    (M, 2): pose, landmark, with z (M, 2) and R (M, 2, 2): (range m, bearing rad) if `polar`, else a point in m.
    """

    poses: Array
    landmarks: Array
    steps: Ids
    ids: Ids
    prior: Array
    prior_cov: Array
    edges: Ids
    delta: Array
    delta_cov: Array
    sightings: Ids
    z: Array
    R: Array
    polar: bool = False
    mount: Array | None = None

    def robot(self, poses: Array) -> Array:
        """The robot's poses (K, 3) that belong to these of the sensor."""
        if self.mount is None:
            return poses
        back = geometry.inverse(self.mount)
        return np.array([geometry.compose(pose, back) for pose in poses]).reshape(-1, 3)


def graph_of(trace: Trace, scenario: Scenario, *, calibration: Mapping[str, float] | None = None) -> Graph:
    """The graph of a finished run, started from its estimates; sightings as the run named them in the end.

    All landmarks that ever were stones and were seen are in it, also those forgotten since. A sighting has the noise
    of what was news in it, as in the filter: raised where the sensor's errors repeat themselves (`sensor.memory`).
    `calibration` gives systematic errors of the odometry, by name, that are taken out of it (`models.calibration`).
    Raises TomThumbError for a run without a scan or a sensor of another kind.
    """
    steps = list(scenario.steps)[: len(trace.t)]
    scans = np.array([k for k, step in enumerate(steps) if step.observations is not None], np.int64)
    if not len(scans) or tuple(scenario.sensor.angles) not in ((), (1,)):
        raise TomThumbError(f"{scenario.name}: a graph needs scans of points, Cartesian or range and bearing")
    mount = scenario.sensor.frame(np.zeros(3))
    known = dict(calibration or {})
    check(scenario.motion, list(known), [1.0] * len(known))
    first, *between = _motions(steps, scans, scenario.motion, known)
    start = geometry.compose(scenario.prior.pose, first[0])
    F, G = geometry.compose_jacobians(scenario.prior.pose, first[0])
    prior_cov = _floored(_in_frame(F @ scenario.prior.cov @ F.T + G @ first[1] @ G.T, start[2]))
    moved = [_at_sensor(delta, cov, mount) for delta, cov in between]
    poses = trace.pose if trace.final_pose is None or len(trace.final_pose) != len(trace.t) else trace.final_pose
    at_sensor = np.array([geometry.compose(poses[k], mount) for k in scans])
    ids = _stones(trace)
    path = [np.inf, *(travelled(delta) for delta, _ in between)]
    new = [_news(steps[k], scenario.sensor, moved) for k, moved in zip(scans.tolist(), path, strict=True)]
    pairs, z, R = _sightings(trace, new, scans, ids)
    polar = tuple(scenario.sensor.angles) == (1,)
    return Graph(
        poses=at_sensor,
        landmarks=_places(trace, ids, pairs, _points(at_sensor, pairs, z, polar)),
        steps=scans,
        ids=ids,
        prior=geometry.compose(start, mount),
        prior_cov=_carried(prior_cov, mount),
        edges=np.column_stack([np.arange(len(scans) - 1), np.arange(1, len(scans))]),
        delta=np.array([m[0] for m in moved]).reshape(-1, 3),
        delta_cov=np.array([m[1] for m in moved]).reshape(-1, 3, 3),
        sightings=pairs, z=z, R=R, polar=polar, mount=mount,
    )  # fmt: skip


def controls(steps: list[Step], motion: Motion) -> Iterator[tuple[int, Control]]:
    """The controls as the loop applies them: cut to the time that is left, held over scans that bring none."""
    last, now = None, -np.inf
    for k, step in enumerate(steps):
        control = step.control
        if control is None:
            if last is not None and motion.rates and step.t > now:
                yield k, replace(last, dt=step.t - now)
        else:
            last, left = control, step.t - now
            if motion.rates and 0.0 < left < control.dt * (1.0 - 1e-9):
                control = replace(control, dt=left)
            if control.dt > 0.0 or not motion.rates:
                yield k, control
        now = step.t


def _motions(
    steps: list[Step], scans: Ids, motion: Motion, calibration: Mapping[str, float]
) -> list[tuple[Array, Array]]:
    """The motion up to the first scan, then that between each scan and the next: (3,) and covariance (3, 3)."""
    names, values = list(calibration), np.array(list(calibration.values()), float)
    out = [(np.zeros(3), np.zeros((3, 3))) for _ in scans]
    into = np.searchsorted(scans, np.arange(len(steps)))
    for k, control in controls(steps, motion):
        if into[k] >= len(scans):
            break
        model, reading = corrected(motion, control, names, values) if names else (motion, control)
        step, step_cov = model.increment(reading)
        delta, cov = out[into[k]]
        F, G = geometry.compose_jacobians(delta, step)
        out[into[k]] = geometry.compose(delta, step), F @ cov @ F.T + G @ step_cov @ G.T
    return out


def _at_sensor(delta: Array, cov: Array, mount: Array) -> tuple[Array, Array]:
    """The robot's motion as the sensor's: mount^-1 (+) delta (+) mount, covariance in the frame at the end."""
    moved = geometry.compose(geometry.compose(geometry.inverse(mount), delta), mount)
    return moved, _carried(_floored(_in_frame(cov, delta[2])), mount)


def _in_frame(cov: Array, heading: float) -> Array:
    """A covariance of a pose's error, turned into the frame of that heading."""
    turn = np.eye(3)
    turn[:2, :2] = geometry.rotation(heading)
    local: Array = turn.T @ cov @ turn
    return local


def _carried(cov: Array, mount: Array) -> Array:
    """The covariance of the robot's error in its frame, as that of the sensor's in its own."""
    by_pose, _ = geometry.compose_jacobians(np.zeros(3), mount)
    return _in_frame(by_pose @ cov @ by_pose.T, mount[2])


def _floored(cov: Array) -> Array:
    even: Array = 0.5 * (cov + cov.T) + np.diag(FLOOR**2)
    return even


def _names(trace: Trace) -> Ids:
    """The landmark of every observation, as the run had it in the end."""
    return trace.ids if trace.final_ids is None else trace.final_ids


def _stones(trace: Trace) -> Ids:
    """Every landmark that is a stone, or was one when it was seen."""
    ever = np.concatenate([_names(trace)[trace.with_stone], trace.final.ids[trace.final.stone]])
    stones: Ids = np.intersect1d(ever[ever >= 0], _names(trace))  # of a map it began with, only what was seen
    return stones


def _news(step: Step, sensor: Sensor, moved: float) -> Observations:
    """The scan of a step, as the filter takes it in."""
    assert step.observations is not None
    return news(step.observations, sensor.memory, moved)


def _sightings(trace: Trace, seen: list[Observations], scans: Ids, ids: Ids) -> tuple[Ids, Array, Array]:
    """(pose, landmark) (M, 2), z (M, 2), R (M, 2, 2) of the observations of the landmarks `ids`."""
    names = _names(trace)
    place = {i: n for n, i in enumerate(ids.tolist())}
    rows, z, R = [], [np.empty((0, 2))], [np.empty((0, 2, 2))]
    for pose, k in enumerate(scans.tolist()):
        mine = [place.get(i, -1) for i in names[trace.offsets[k] : trace.offsets[k + 1]].tolist()]
        held = [j for j, n in enumerate(mine) if n >= 0]
        rows += [(pose, mine[j]) for j in held]
        z.append(seen[pose].z[held])
        R.append(seen[pose].R[held])
    return np.array(rows, np.int64).reshape(-1, 2), np.concatenate(z), np.concatenate(R)


def _points(poses: Array, pairs: Ids, z: Array, polar: bool) -> Array:
    """Where each sighting points, (M, 2) m in the world."""
    x, y = (z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])) if polar else z.T
    seen_from = poses[pairs[:, 0]]
    c, s = np.cos(seen_from[:, 2]), np.sin(seen_from[:, 2])
    points: Array = seen_from[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])
    return points


def _places(trace: Trace, ids: Ids, pairs: Ids, points: Array) -> Array:
    """First guess (n, 2) of the landmarks: the final map's, or where sightings of forgotten ones point on average."""
    known = {int(i): place for i, place in zip(trace.final.ids, trace.final.landmarks, strict=True)}
    count = np.maximum(np.bincount(pairs[:, 1], minlength=len(ids)), 1)
    mean = [np.bincount(pairs[:, 1], points[:, k], len(ids)) / count for k in range(2)]
    guess = np.column_stack(mean)
    for n, i in enumerate(ids.tolist()):
        guess[n] = known.get(i, guess[n])
    return guess
