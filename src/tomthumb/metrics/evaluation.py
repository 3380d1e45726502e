"""All the metrics of one run as one plain dictionary: what ``--json`` prints and what a benchmark row holds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.metrics.consistency import innovation_consistency, pose_consistency
from tomthumb.metrics.decisions import FN, FP, TN, TP, Decisions, decide, decide_as_reference, decide_final
from tomthumb.metrics.golden import golden_metrics
from tomthumb.metrics.identity import duplicates_and_ghosts, identify, purity_and_idf1
from tomthumb.metrics.lifetimes import step_of_observation
from tomthumb.metrics.mapping import gospa, map_errors
from tomthumb.metrics.trajectory import relative_errors, trajectory_errors
from tomthumb.metrics.truth import TruthTable, collect
from tomthumb.types import Array, Scenario, Trace

Row = dict[str, Any]


def evaluate(trace: Trace, scenario: Scenario) -> Row:
    """Every metric of `trace` against the truth of `scenario`, by the keys of `docs/metrics.md`; None where unknown.

    Raises TomThumbError when the trace is not of this scenario.
    """
    row = score(trace, collect(scenario, trace))
    if "golden" in scenario.info:
        row |= {key: _plain(value) for key, value in golden_metrics(trace, scenario.info["golden"]).items()}
    return row


def score(trace: Trace, truth: TruthTable) -> Row:
    """The same from a truth already collected (a saved run carries one)."""
    row: Row = {}
    row |= association_metrics(trace, truth)
    row |= trajectory_metrics(trace, truth)
    row |= consistency_metrics(trace, truth)
    row |= map_metrics(trace, truth)
    row |= cost_metrics(trace)
    row |= {"failure": trace.failure}
    return {key: _plain(value) for key, value in row.items()}


def association_metrics(trace: Trace, truth: TruthTable) -> Row:
    """Keys about who was named what; all None when nothing is labelled."""
    online, final = decide(trace, truth), decide_final(trace, truth)
    known = online.scored > 0
    purity, idf1 = purity_and_idf1(trace, truth)
    row = {
        "match_rate": online.match_rate,
        "precision": online.precision,
        "recall": online.recall,
        "wrong_ids": int(online.wrong_id.sum()) if known else None,
        "purity": purity,
        "idf1": idf1,
        "match_rate_final": final.match_rate,
        "scans_right": _scans_right(online, trace),
        "scored": online.scored,
    }
    return row | _counts("", online) | _counts("reference_score_", decide_as_reference(trace, truth))


def _counts(prefix: str, decisions: Decisions) -> Row:
    known = decisions.scored > 0
    outcomes = {"tp": TP, "tn": TN, "fp": FP, "fn": FN}
    return {prefix + name: decisions.count(outcome) if known else None for name, outcome in outcomes.items()}


def _scans_right(decisions: Decisions, trace: Trace) -> float:
    """Share of the scored scans in which every decision is right."""
    step = step_of_observation(trace.offsets)
    outcome = decisions.outcome
    scored = np.unique(step[np.isin(outcome, (TP, TN, FP, FN))])
    wrong = np.unique(step[np.isin(outcome, (FP, FN))])
    return 1.0 - len(wrong) / len(scored) if len(scored) else math.nan


def trajectory_metrics(trace: Trace, truth: TruthTable) -> Row:
    """Keys about the pose."""
    scored = truth.scored_steps()
    errors = trajectory_errors(trace.pose, truth.pose, scored)
    final_pose = trace.pose if trace.final_pose is None else trace.final_pose
    final = trajectory_errors(final_pose, truth.pose, scored)
    rpe, rpe_heading = relative_errors(trace.pose, truth.pose, scored)
    return {
        "ate_m": errors.ate,
        "ate_raw_m": errors.ate_raw,
        "ate_final_m": final.ate,
        "rmse_x_m": errors.x,
        "rmse_y_m": errors.y,
        "rmse_heading_deg": math.degrees(errors.heading),
        "rpe_m": rpe,
        "rpe_heading_deg": math.degrees(rpe_heading),
        "end_error_m": errors.final,
        "largest_error_m": errors.largest,
    }


def consistency_metrics(trace: Trace, truth: TruthTable) -> Row:
    """Keys about what the filter claims to know."""
    scored = truth.scored_steps()
    pose = pose_consistency(trace.pose, trace.pose_cov, truth.pose, scored)
    innovation = innovation_consistency(trace.nis, trace.dof, scored)
    return {
        "nees": pose.mean,
        "nees_low": pose.low,
        "nees_high": pose.high,
        "nees_inside": pose.inside,
        "nis": innovation.mean,
        "nis_low": innovation.low,
        "nis_high": innovation.high,
        "nis_inside": innovation.inside,
    }


def map_metrics(trace: Trace, truth: TruthTable) -> Row:
    """Keys about the map; duplicates and ghosts need labels, the errors true positions as well."""
    points, identity, support = identify(trace, truth)
    duplicates, ghosts = duplicates_and_ghosts(identity)
    row: Row = {
        "duplicates": duplicates if truth.has_ids else None,
        "ghosts": ghosts if truth.has_ids else None,
        "landmarks": len(points),
        "crumbs": int((~trace.final.stone).sum()),
        "map_rmse_m": math.nan,
        "map_rmse_raw_m": math.nan,
        "gospa_m": math.nan,
    }
    if truth.landmarks is None:
        return row
    row["map_rmse_m"], row["map_rmse_raw_m"] = map_errors(points, identity, support, truth.landmarks)
    row["gospa_m"] = gospa(points, seen_landmarks(truth)).distance
    return row


def seen_landmarks(truth: TruthTable) -> Array:
    """The true landmarks (k, 2) that were observed at least once; all of them where nothing is labelled."""
    assert truth.landmarks is not None
    known = truth.landmarks
    if truth.has_ids:
        seen = np.unique(truth.ids[truth.ids >= 0])
        known = known[seen[seen < len(known)]]
    found: Array = known[np.isfinite(known).all(1)]
    return found


def cost_metrics(trace: Trace) -> Row:
    """Keys about the time taken, by the wall clock: associate over steps that had observations."""
    total = trace.seconds.sum(1)
    scans = trace.seconds[np.diff(trace.offsets) > 0, 1]
    duration = float(trace.t[-1] - trace.t[0]) if len(trace.t) else math.nan
    return {
        "steps": len(trace.t),
        "observations": len(trace.ids),
        "step_ms_p50": 1e3 * _quantile(total, 0.5),
        "associate_us_p50": 1e6 * _quantile(scans, 0.5),
        "associate_us_p99": 1e6 * _quantile(scans, 0.99),
        "run_s": float(total.sum()),
        "real_time_factor": duration / float(total.sum()) if total.sum() > 0.0 else math.nan,
    }


def _quantile(values: Array, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan


def _plain(value: Any) -> Any:
    """JSON-safe: numpy scalars to Python's, NaN and infinities to None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
