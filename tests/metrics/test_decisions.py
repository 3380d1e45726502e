"""Each rule of docs/metrics.md, Associations, on a trace small enough to score by hand."""

from __future__ import annotations

import numpy as np
import pytest

from handmade import estimate, trace, truth
from tomthumb.metrics.decisions import FN, FP, SKIPPED, TN, TP, decide, decide_as_reference, decide_final
from tomthumb.metrics.lifetimes import Lifetimes


def outcomes(run, real):
    return decide(run, real).outcome.tolist()


def test_the_first_scan_is_not_scored():
    run = trace([[0, 1], [0, 1]], estimate([0, 1]))
    assert outcomes(run, truth([7, 8, 7, 8], 2)) == [SKIPPED, SKIPPED, TP, TP]


def test_pairing_with_another_landmark_is_a_wrong_identity():
    run = trace([[0, 1], [1, 0]], estimate([0, 1]))
    decisions = decide(run, truth([7, 8, 7, 8], 2))
    assert decisions.outcome.tolist()[2:] == [FP, FP]
    assert decisions.wrong_id.tolist() == [False, False, True, True]


def test_new_is_right_only_while_the_landmark_is_not_in_the_map():
    run = trace([[0], [1], [2]], estimate([0, 1, 2]))
    assert outcomes(run, truth([7, 8, 7], 3)) == [SKIPPED, TN, FN]


def test_a_duplicate_of_the_right_landmark_is_right_by_identity_and_wrong_by_the_reference():
    run = trace([[0], [1], [1]], estimate([0, 1]))
    real = truth([7, 7, 7], 3)
    assert outcomes(run, real) == [SKIPPED, FN, TP]
    assert decide_as_reference(run, real).outcome.tolist() == [SKIPPED, FN, FP]


@pytest.mark.parametrize(("died_at", "expected"), [(0, TN), (1, FN), (2, FN)])
def test_a_landmark_that_died_may_be_found_anew(died_at, expected):
    run = trace([[0], [1]], estimate([1]), died=[[0, died_at]])
    assert outcomes(run, truth([7, 7], 2)) == [SKIPPED, expected]


def test_left_out_though_in_the_map_is_missed():
    run = trace([[0], [-1]], estimate([0]))
    assert outcomes(run, truth([7, 7], 2)) == [SKIPPED, FN]


def test_clutter_is_right_when_left_out_or_on_its_own_crumb():
    scans = [[0], [-1, 2], [2, 2]]
    stone = np.array([False, False, False, False, True])
    run = trace(scans, estimate([0, 2]), with_stone=stone)
    assert outcomes(run, truth([7, -1, -1, -1, -1], 3)) == [SKIPPED, TN, TN, TN, FP]


def test_clutter_on_a_true_landmark_is_a_wrong_identity():
    run = trace([[0], [0]], estimate([0]))
    decisions = decide(run, truth([7, -1], 2))
    assert decisions.outcome.tolist() == [SKIPPED, FP]
    assert decisions.wrong_id.tolist() == [False, True]


def test_a_true_landmark_on_a_crumb_of_clutter_is_a_wrong_identity():
    run = trace([[0], [0]], estimate([0], stone=[False]), with_stone=np.zeros(2, bool))
    decisions = decide(run, truth([-1, 7], 2))
    assert decisions.outcome.tolist() == [SKIPPED, FP]
    assert decisions.wrong_id.tolist() == [False, True]


def test_unlabelled_rows_are_not_scored_and_a_landmark_takes_its_first_label():
    run = trace([[0], [0], [0], [0]], estimate([0]))
    assert outcomes(run, truth([-2, 7, -2, 8], 4)) == [SKIPPED, TP, SKIPPED, FP]


def test_a_landmark_of_a_lost_branch_is_not_in_the_map_after_its_last_mention():
    run = trace([[0], [0], [2]], estimate([2]))  # 0 neither died nor merged, yet the final map lacks it
    assert outcomes(run, truth([7, 7, 7], 3)) == [SKIPPED, TP, TN]


def test_a_landmark_given_before_the_run_counts_as_known_from_the_start():
    run = trace([[900], [900], [-1]], estimate([900]))
    assert outcomes(run, truth([7, 7, 7], 3)) == [SKIPPED, TP, FN]


def test_the_final_score_sees_merging():
    run = trace([[0], [1], [1]], estimate([0]), merged=[[1, 0, 2]], final_ids=[0, 0, 0])
    real = truth([7, 7, 7], 3)
    assert decide(run, real).match_rate == 0.5
    assert decide_final(run, real).match_rate == 1.0


def test_the_final_score_may_merge_into_the_younger():
    run = trace([[0], [1], [1]], estimate([1]), merged=[[0, 1, 2]], final_ids=[1, 1, 1])
    assert decide_final(run, truth([7, 7, 7], 3)).outcome.tolist() == [SKIPPED, TP, TP]


def test_rates_of_nothing_are_unknown():
    decisions = decide(trace([[0], [0]], estimate([0])), truth([-2, -2], 2))
    assert np.isnan([decisions.match_rate, decisions.precision, decisions.recall]).all()


def test_the_first_of_several_in_the_map_at_that_time():
    lives = Lifetimes(np.array([3, 5, 9]), np.array([7, 7, -1]), np.array([0, 1, 0]), np.array([2, 9, 9]))
    asked, step = np.array([7, 7, 7, 7, 8, -1]), np.array([0, 1, 2, 3, 3, 3])
    assert lives.first_known(asked, step).tolist() == [-1, 3, 3, 5, -1, -1]


def random_run(rng, steps, each):
    """Ids given out at random among the landmarks alive, some of which die: scans, births and deaths by id."""
    scans, birth, end, alive = [], {}, {}, []
    for k in range(steps):
        scan = []
        for s in range(k * each, (k + 1) * each):
            chance = rng.random()
            scan.append(s if chance < 0.05 or not alive else -1 if chance < 0.2 else int(rng.choice(alive)))
        new = [i for i in scan if i >= k * each]
        gone = [i for i in alive if rng.random() < 0.02]
        birth |= dict.fromkeys(new, k)
        end |= dict.fromkeys(gone, k)
        alive = [i for i in alive + new if i not in gone]
        scans.append(scan)
    return scans, birth, end, alive


def test_many_observations_are_scored_as_the_rule_says_one_by_one():
    steps, each = 200, 8
    rng = np.random.default_rng(8)
    labels = rng.integers(-1, 12, steps * each)
    scans, birth, end, alive = random_run(rng, steps, each)
    run = trace(scans, estimate(alive), died=list(end.items()))
    outcome = decide(run, truth(labels, steps)).outcome
    for s in range(each, steps * each):
        k, real = s // each, labels[s]
        if run.paired[s]:
            expected = TP if real >= 0 and labels[run.ids[s]] == real else FP
        else:
            known = any(labels[i] == real and birth[i] < k <= end.get(i, steps) for i in birth)
            expected = FN if real >= 0 and known else TN
        assert outcome[s] == expected, s
