"""What was believed before its trial: when it goes back on trial, and what comes of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tomthumb.branches import told
from tomthumb.court import flee
from tomthumb.doubt import Trials, put_on_trial, untried_of
from tomthumb.lifecycle import Life, LifeCycle, deaths
from tomthumb.metrics import evaluate
from tomthumb.runner import prepare, run
from tomthumb.scenarios.cloister import cloister
from tomthumb.slam import Slam

POLICY = LifeCycle()
MOSTLY_FADE = Trials(stood=3, faded=9)


EVERY = frozenset(range(7))  # the last is none of the ledger's


def ledger() -> dict[int, Life]:
    """Two landmarks tried in full, one seen once, two crumbs, and one that came back from a grave."""
    tried = {i: Life(9, hits=6.0, chances=6.0, static=6) for i in (0, 1)}
    crumbs = {3: Life(9), 5: Life(9, hits=9.0, chances=9.0, static=6)}
    return tried | crumbs | {2: Life(1), 4: Life(9, returned=1)}


def test_share_of_trials_is_laplaces() -> None:
    assert Trials().share == 0.5
    assert Trials().and_ended(stood=3).and_ended(faded=1).share == pytest.approx(4 / 6)


def test_untried_go_back_where_most_trials_end_in_nothing() -> None:
    lives = ledger()
    assert untried_of(lives, EVERY, POLICY) == {2, 3}
    assert put_on_trial(lives, {3, 5}, EVERY, [0, 1], MOSTLY_FADE, POLICY).tolist() == [2]
    assert [i for i, life in lives.items() if life.believed] == [2]


@pytest.mark.parametrize(
    ("hit", "trials", "policy"),
    [
        ([0, 1], Trials(stood=9, faded=3), POLICY),  # what is new mostly stands
        ([0, 2], MOSTLY_FADE, POLICY),  # one tried landmark does not hold a pose
        ([0, 5], MOSTLY_FADE, POLICY),  # nor does one with a crumb
        ([0, 1, 2], MOSTLY_FADE, POLICY),  # it has just moved the pose
        ([0, 1], MOSTLY_FADE, replace(POLICY, doubt=0.0)),
        ([0, 1], MOSTLY_FADE, POLICY.faithful()),
    ],
)
def test_untried_stay_stones_else(hit: list[int], trials: Trials, policy: LifeCycle) -> None:
    lives = ledger()
    assert not len(put_on_trial(lives, {3, 5}, EVERY, hit, trials, policy))
    assert not any(life.believed for life in lives.values())


def test_out_of_sight_it_waits_for_its_trial_longer_than_a_crumb() -> None:
    believed, crumb = Life(0, believed=True), Life(0)
    late = POLICY.patience + 1
    assert deaths({7: believed, 8: crumb}, [], [7, 8], late, POLICY).tolist() == [8]
    believed.chances = 9.0  # expected in vain
    assert deaths({7: believed}, [], [7], late, POLICY).tolist() == [7]


def watched(seed: int, **world: Any) -> tuple[Slam, list[set[int]], list[tuple[int, int]]]:
    """A run step by step: the loop at its end, its crumbs after each step, and the trials counted by then."""
    scenario = cloister(np.random.default_rng(seed), **world)
    slam, crumbs, trials = prepare(scenario, associator="oracle", seed=seed), [], []
    for step in scenario.steps:
        slam.step(step.t, step.control, step.observations)
        (branch,) = slam.branches
        found = slam.estimator.estimate(branch.belief)
        assert set(found.ids[~found.stone].tolist()) == branch.crumbs
        crumbs.append(set(branch.crumbs))
        trials.append((branch.trials.stood, branch.trials.faded))
    return slam, crumbs, trials


def test_among_people_posts_of_the_first_scan_wait_and_are_stones_again() -> None:
    slam, crumbs, trials = watched(3, people=30)
    (branch,) = slam.branches
    first = {i for i, life in branch.ledger.items() if life.born == 0 and i not in branch.crumbs}
    waited = {i for i in first if branch.ledger[i].believed}
    assert waited, "no landmark of the first scan was ever doubted"
    assert all(i not in crumbs[0] for i in first)
    assert all(any(i in now for now in crumbs) for i in waited)
    assert trials[0] == (0, 0)  # who is believed at once has not been tried
    died = {i for kind, i, _, _ in told(branch) if kind == "died"}
    stood, faded = trials[-1]
    assert stood <= len(branch.ledger) + len(died) - len(first)
    assert 0 < faded <= len(died)


def test_who_waits_for_a_trial_stays_with_a_map_that_is_put_aside() -> None:
    scenario = cloister(np.random.default_rng(3), people=30)
    slam = prepare(scenario, associator="oracle", seed=3)
    for step in list(scenario.steps)[:60]:
        slam.step(step.t, step.control, step.observations)
    (branch,) = slam.branches
    waiting = {i for i in branch.crumbs if branch.ledger[i].believed}
    others = branch.crumbs - waiting
    assert waiting
    assert others
    away, fresh = flee(slam.estimator, branch, slam.index, np.random.default_rng(0))
    assert away.home.crumbs == waiting
    assert not others & away.home.ledger.keys()
    found = slam.estimator.estimate(away.home.belief)
    assert set(found.ids[~found.stone].tolist()) == waiting
    assert not fresh.ledger


def test_where_nobody_walks_nobody_is_doubted() -> None:
    slam, _, trials = watched(3)
    assert not any(life.believed for life in slam.branches[0].ledger.values())
    assert trials[-1][0] > trials[-1][1]


def test_people_of_the_first_scan_do_not_spoil_the_loop() -> None:
    """Seeds in which first-scan people were taken for landmarks when the loop closed."""
    rates = {}
    for doubt in (0.0, POLICY.doubt):
        settings = {"slam": {"doubt": doubt, "width": 1, "present": False}}
        runs = [(cloister(np.random.default_rng(seed), people=30), seed) for seed in (1118, 1197)]
        found = [evaluate(run(s, associator="stt", seed=seed, settings=settings), s) for s, seed in runs]
        rates[doubt] = np.mean([e["match_rate"] for e in found])
    assert rates[0.0] < 0.97
    assert rates[POLICY.doubt] > 0.985
