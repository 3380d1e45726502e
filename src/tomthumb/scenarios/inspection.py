"""What is in a log, and what noise, detection and clutter it shows: plain dictionaries, in one pass over its steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tomthumb.geometry import between, compose, compose_jacobians, wrap
from tomthumb.types import Array, Mask, Scenario, Step

SEEN_FROM = 0.5  # a landmark counts as in view where the sensor model says so with this probability
MAX_KEPT = 200_000  # residuals kept of a very long log
CHI2_2 = 1.386  # median of chi-square with 2 degrees of freedom


@dataclass(slots=True)
class _Tally:
    """What one pass counts."""

    steps: int = 0
    scans: int = 0
    counts: list[int] = field(default_factory=list)
    t: list[float] = field(default_factory=list)
    truth_poses: int = 0
    ids: dict[int, int] = field(default_factory=dict)
    labels: set[int] = field(default_factory=set)
    drift: list[tuple[float, float]] = field(default_factory=list)
    driven: float = 0.0
    reach: float = 0.0
    fov: float = 0.0
    sigma: list[float] = field(default_factory=list)


def info(scenario: Scenario) -> dict[str, Any]:
    """What a scenario holds; None where it cannot be known.

    Keys: name, steps, scans, duration_s, observations, observations_per_scan (mean, max), landmarks,
    observed_landmarks, spacing_m (min and median distance of a landmark to the next), spacing_in_sigma (the median, in
    standard deviations of a median observation), driven_m by odometry, dead_reckoning_m (mean, max, end, after_60_s),
    max_range_m, fov_deg (of what was seen), truth (scans with a pose and labelled observations, as shares),
    clutter_share, classes.
    """
    tally = _Tally()
    pose: Array | None = scenario.prior.pose
    for step in scenario.steps:
        pose = _count(tally, scenario, step, pose)
    known = sum(n for i, n in tally.ids.items() if i >= -1)
    total = sum(tally.counts)
    spacing = _spacing(scenario, tally)
    sigma = float(np.median(tally.sigma)) if tally.sigma else None
    return {
        "name": scenario.name,
        "steps": tally.steps,
        "scans": tally.scans,
        "duration_s": tally.t[-1] - tally.t[0] if tally.t else 0.0,
        "observations": total,
        "observations_per_scan": {"mean": total / max(tally.scans, 1), "max": max(tally.counts, default=0)},
        "landmarks": None if scenario.landmarks is None else int(np.isfinite(scenario.landmarks).all(1).sum()),
        "observed_landmarks": sum(i >= 0 for i in tally.ids) or None,
        "spacing_m": spacing,
        "spacing_in_sigma": None if spacing is None or not sigma else spacing["median"] / sigma,
        "driven_m": tally.driven,
        "dead_reckoning_m": _drift(tally),
        "max_range_m": tally.reach,
        "fov_deg": math.degrees(tally.fov),
        "truth": {"poses": tally.truth_poses / max(tally.scans, 1), "labelled": known / max(total, 1)},
        "clutter_share": tally.ids.get(-1, 0) / known if known else None,
        "classes": sorted(tally.labels - {-1}) or None,
    }


def _count(tally: _Tally, scenario: Scenario, step: Step, pose: Array | None) -> Array | None:
    """Take one step into the tally; gives the dead-reckoned pose after it."""
    tally.steps += 1
    tally.t[1:] = [step.t]
    if step.control is not None and pose is not None:
        delta = scenario.motion.increment(step.control)[0]
        tally.driven += math.hypot(delta[0], delta[1])
        pose = compose(pose, delta)
    if step.truth is not None and step.truth.pose is not None:
        tally.truth_poses += step.observations is not None
        if pose is not None:
            tally.drift.append((step.t, float(np.hypot(*(pose - step.truth.pose)[:2]))))
    if step.observations is not None:
        _count_scan(tally, scenario, step)
    return pose


def _count_scan(tally: _Tally, scenario: Scenario, step: Step) -> None:
    scan = step.observations
    assert scan is not None
    tally.scans += 1
    tally.counts.append(len(scan))
    ids = np.full(len(scan), -2) if step.truth is None or step.truth.ids is None else step.truth.ids
    for i, n in zip(*np.unique(ids, return_counts=True), strict=True):
        tally.ids[int(i)] = tally.ids.get(int(i), 0) + int(n)
    if scan.labels is not None:
        tally.labels |= set(scan.labels.tolist())
    if not len(scan):
        return
    z = _polar(scenario, scan.z)
    tally.reach = max(tally.reach, float(z[:, 0].max()))
    tally.fov = max(tally.fov, 2 * float(np.abs(z[:, 1]).max()))
    if len(tally.sigma) < MAX_KEPT:
        across = np.ones(len(z)) if not scenario.sensor.angles else z[:, 0]
        tally.sigma += np.sqrt((scan.R[:, 0, 0] + scan.R[:, 1, 1] * across**2) / 2).tolist()


def _polar(scenario: Scenario, z: Array) -> Array:
    """Range m and bearing rad about the sensor's axis of observations in the sensor's units."""
    if scenario.sensor.angles:
        return np.column_stack([z[:, 0], wrap(z[:, 1])])
    facing = float(getattr(scenario.sensor, "facing", 0.0))
    return np.column_stack([np.hypot(z[:, 0], z[:, 1]), wrap(np.arctan2(z[:, 1], z[:, 0]) - facing)])


def _spacing(scenario: Scenario, tally: _Tally) -> dict[str, float] | None:
    if scenario.landmarks is None:
        return None
    points = scenario.landmarks[np.isfinite(scenario.landmarks).all(1)]
    if len(points) < 2:
        return None
    from scipy.spatial import cKDTree

    nearest = cKDTree(points).query(points, 2)[0][:, 1]
    return {"min": float(nearest.min()), "median": float(np.median(nearest))}


def _drift(tally: _Tally) -> dict[str, float | None] | None:
    if not tally.drift:
        return None
    t, error = np.array(tally.drift).T
    late = np.flatnonzero(t >= t[0] + 60.0)
    after = float(error[late[0]]) if len(late) else None
    return {"mean": float(error.mean()), "max": float(error.max()), "end": float(error[-1]), "after_60_s": after}


@dataclass(slots=True)
class _Evidence:
    """What is compared with the truth in one pass."""

    residuals: list[Array] = field(default_factory=list)
    d2: list[Array] = field(default_factory=list)
    motion_d2: list[float] = field(default_factory=list)
    expected: float = 0.0
    seen: int = 0
    false: int = 0
    scans: int = 0
    ranges: list[float] = field(default_factory=list)
    bearings: list[float] = field(default_factory=list)


def suggest(scenario: Scenario) -> dict[str, Any]:
    """Noise, detection and clutter as the log shows them against its truth, and the settings that follow.

    Keys: `sensor_std` of the two components of z, robust (MAD) and plain, and their `bias`; `outlier_share` beyond the
    99.9 % gate of the log's own R; `r_scale`, `q_scale`: factors on the standard deviations of R and of the odometry
    (along and in heading, between true poses) that would bring half of the errors within the median of chi-square;
    `detect`; `clutter` per m2 and scan; `max_range_m`, `fov_deg` that hold 99.9 % of what was seen; `settings`, in the
    words of scenario.toml; `notes`, why what is missing is missing. Without true poses and landmarks only range and
    field of view can be told.
    """
    evidence = _Evidence()
    before: tuple[Array, Array, Array] | None = None
    for step in scenario.steps:
        before = _compare_motion(evidence, scenario, step, before)
        if step.observations is not None:
            _compare_scan(evidence, scenario, step)
    return _suggestion(evidence, scenario)


def _compare_motion(
    evidence: _Evidence, scenario: Scenario, step: Step, before: tuple[Array, Array, Array] | None
) -> tuple[Array, Array, Array] | None:
    """Chain odometry since the last true pose (pose, increment, covariance) and judge it at the next."""
    if before is not None and step.control is not None:
        delta, cov = scenario.motion.increment(step.control)
        A, B = compose_jacobians(before[1], delta)
        before = before[0], compose(before[1], delta), A @ before[2] @ A.T + B @ cov @ B.T
    if step.truth is None or step.truth.pose is None:
        return before
    if before is not None:
        error = before[1] - between(before[0], step.truth.pose)
        error[2] = (error[2] + math.pi) % (2 * math.pi) - math.pi
        along_and_turn = np.ix_((0, 2), (0, 2))  # many models have no noise sideways, where nothing could be judged
        cov, error = before[2][along_and_turn], error[[0, 2]]
        if len(evidence.motion_d2) < MAX_KEPT and np.linalg.det(cov) > 0:
            evidence.motion_d2.append(float(error @ np.linalg.solve(cov, error)))
    return step.truth.pose, np.zeros(3), np.zeros((3, 3))


def _compare_scan(evidence: _Evidence, scenario: Scenario, step: Step) -> None:
    scan, truth = step.observations, step.truth
    assert scan is not None
    if len(scan) and len(evidence.ranges) < MAX_KEPT:
        z = _polar(scenario, scan.z)
        evidence.ranges += z[:, 0].tolist()
        evidence.bearings += np.abs(z[:, 1]).tolist()
    if truth is None or truth.ids is None:
        return
    evidence.scans += 1
    evidence.false += int((truth.ids == -1).sum())
    if truth.pose is None or scenario.landmarks is None:
        return
    mapped: Mask = np.asarray(np.isfinite(scenario.landmarks).all(1))
    z_hat = scenario.sensor.expect(truth.pose, scenario.landmarks[mapped])[0]
    evidence.expected += float((scenario.sensor.in_view(z_hat, np.full(z_hat.shape, 1e-12)) > SEEN_FROM).sum())
    named = np.flatnonzero((truth.ids >= 0) & mapped[np.maximum(truth.ids, 0)])
    evidence.seen += len(np.unique(truth.ids[named]))
    if not len(named) or len(evidence.residuals) > MAX_KEPT:
        return
    nu = scan.z[named] - scenario.sensor.expect(truth.pose, scenario.landmarks[truth.ids[named]])[0]
    for k in scenario.sensor.angles:
        nu[:, k] = wrap(nu[:, k])
    evidence.residuals.append(nu)
    evidence.d2.append(np.einsum("mi,mij,mj->m", nu, np.linalg.inv(scan.R[named]), nu))


def _suggestion(evidence: _Evidence, scenario: Scenario) -> dict[str, Any]:
    out: dict[str, Any] = dict.fromkeys(
        ("sensor_std", "outlier_share", "r_scale", "q_scale", "detect", "clutter", "max_range_m", "fov_deg")
    )
    notes: list[str] = []
    sensor: dict[str, Any] = {}
    motion: dict[str, Any] = {}
    if evidence.ranges:
        out["max_range_m"] = float(np.quantile(evidence.ranges, 0.999)) * 1.02
        fov = min(2 * math.pi, 2.02 * float(np.quantile(evidence.bearings, 0.999)))
        out["fov_deg"] = math.degrees(fov)
        sensor |= {"max_range": out["max_range_m"], "fov_deg": out["fov_deg"]}
    if evidence.residuals:
        nu, d2 = np.vstack(evidence.residuals), np.concatenate(evidence.d2)
        robust = 1.4826 * np.median(np.abs(nu - np.median(nu, axis=0)), axis=0)
        out["sensor_std"] = {"robust": robust.tolist(), "plain": nu.std(0).tolist(), "bias": nu.mean(0).tolist()}
        out["outlier_share"] = float((d2 > 13.82).mean())
        out["r_scale"] = math.sqrt(float(np.median(d2)) / CHI2_2)
        sensor["std"] = nu.std(0).tolist()
    else:
        notes.append("no sensor noise: it needs true poses, landmarks and ids of observations")
    if evidence.expected:
        out["detect"] = min(evidence.seen / evidence.expected, 0.99)
        sensor["detect"] = out["detect"]
    if evidence.scans and evidence.ranges:
        area = 0.5 * math.radians(out["fov_deg"]) * out["max_range_m"] ** 2
        out["clutter"] = max(evidence.false / evidence.scans / area, 1e-4)
        sensor["clutter"] = out["clutter"]
    else:
        notes.append("no clutter: it needs ids of observations")
    if len(evidence.motion_d2) > 10:
        out["q_scale"] = math.sqrt(float(np.median(evidence.motion_d2)) / CHI2_2)
        std = getattr(scenario.motion, "std", None)
        motion = {} if std is None else {"std": [float(s) * out["q_scale"] for s in std]}
    else:
        notes.append("no odometry noise: it needs true poses")
    return {**out, "settings": {"motion": motion, "sensor": sensor}, "notes": notes}
