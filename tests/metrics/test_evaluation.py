"""The dictionary of all metrics."""

from __future__ import annotations

import json

import numpy as np
import pytest

from handmade import estimate, trace, truth
from tomthumb.errors import TomThumbError
from tomthumb.metrics import collect, evaluate, score
from tomthumb.types import Observations, Prior, Scenario, Step, Truth

PROMISED = ["match_rate", "precision", "recall", "wrong_ids", "purity", "idf1", "duplicates", "match_rate_final"]
PROMISED += ["ate_m", "ate_raw_m", "ate_final_m", "rmse_x_m", "rmse_y_m", "nees", "map_rmse_m", "landmarks"]
PROMISED += ["steps", "step_ms_p50", "associate_us_p50", "associate_us_p99", "failure"]


def scenario(labels, **other) -> Scenario:
    """One scan for each list of labels; poses are all known and zero, or all unknown when labels are None."""
    steps = []
    for k, ids in enumerate(labels):
        m = 1 if ids is None else len(ids)
        told = None if ids is None else Truth(np.zeros(3), np.array(ids))
        steps.append(Step(float(k), None, Observations(np.zeros((m, 2)), np.tile(np.eye(2), (m, 1, 1))), told))
    prior = Prior(np.zeros(3), np.zeros((3, 3)))
    return Scenario("by hand", None, None, prior, steps, **other)  # type: ignore[arg-type]


def test_the_promised_keys_are_there_and_the_row_is_json():
    run = trace([[0, 1], [0, 1], []], estimate([0, 1], points=[[1, 0], [0, 1]]))
    row = evaluate(run, scenario([[0, 1], [0, 1], []], landmarks=np.array([[1.0, 0.0], [0.0, 1.0]])))
    assert set(PROMISED) <= set(row)
    json.dumps(row, allow_nan=False)
    assert row["match_rate"] == row["precision"] == row["recall"] == row["purity"] == row["idf1"] == 1.0
    assert row["ate_m"] == row["gospa_m"] == row["map_rmse_m"] == 0.0
    assert (row["tp"], row["tn"], row["fp"], row["fn"], row["duplicates"], row["ghosts"]) == (2, 0, 0, 0, 0, 0)
    assert row["scans_right"] == 1.0


def test_without_any_truth_every_score_is_null():
    row = evaluate(trace([[0], [0]], estimate([0])), scenario([None, None]))
    for key in [*PROMISED[:15], "tp", "reference_score_tp", "ghosts", "rpe_m", "gospa_m"]:
        assert row[key] is None, key
    assert row["landmarks"] == 1
    assert row["steps"] == 2


def test_a_run_that_found_nothing_is_scored_not_crashed():
    row = score(trace([[], [], []], estimate(), failure="diverged"), truth([], 3, landmarks=np.zeros((0, 2))))
    assert row["failure"] == "diverged"
    assert row["match_rate"] is None


def test_a_run_that_stopped_early_is_scored_as_far_as_it_went():
    row = evaluate(trace([[0], [0]], estimate([0])), scenario([[5], [5], [5], [5]]))
    assert (row["steps"], row["scored"], row["match_rate"]) == (2, 1, 1.0)


def test_a_trace_of_another_scenario_is_refused():
    run = trace([[0], [0]], estimate([0]))
    with pytest.raises(TomThumbError, match="1 observations in step 0, the scenario 2"):
        evaluate(run, scenario([[5, 6], [5]]))
    with pytest.raises(TomThumbError, match="only 1"):
        evaluate(run, scenario([[5]]))


def test_lazy_steps_are_walked_once():
    steps = list(scenario([[5], [5]]).steps)

    class Once:
        walks = 0

        def __iter__(self):
            Once.walks += 1
            return iter(steps)

    lazy = scenario([])
    lazy = Scenario(lazy.name, lazy.motion, lazy.sensor, lazy.prior, Once())  # type: ignore[arg-type]
    collect(lazy, trace([[0], [0]], estimate([0])))
    assert Once.walks == 1
