"""The lookout: nobody sets out where all is known, and nobody is carried off to land that only looks alike."""

from __future__ import annotations

import numpy as np

from tomthumb import lookout
from tomthumb.king import King
from tomthumb.lookout import Keeping, ask
from tomthumb.runner import prepare
from tomthumb.scenarios.cloister import cloister
from tomthumb.scenarios.kidnap import kidnapped
from tomthumb.watch import Watch

KING = {"slam": {"king": True}}


def out(scenario, steps: int):
    """How many brothers were out after each step, and what was told of the king."""
    slam = prepare(scenario, associator="jcbb", settings=KING)
    counts, words = [], []
    for record in slam.stream(list(scenario.steps)[:steps]):
        counts.append(len(slam.court.lookout.walkers))
        words.append(record.info.get("king"))
    return counts, words, slam


def test_brothers_walk_in_new_land_and_are_few_and_none_where_all_is_known():
    counts, words, _ = out(cloister(np.random.default_rng(5), laps=2), 330)
    rules = Keeping()
    assert max(counts) == rules.life // rules.every
    assert counts[-1] == 0
    assert set(words) == {None}  # the sides of a cloister are alike, and new land proves nothing


def test_without_the_watch_a_kidnapped_robot_is_found_by_its_brothers_and_its_past_is_kept():
    scenario = kidnapped(cloister(np.random.default_rng(6), laps=3, jitter=0.2), 212, 298)
    slam = prepare(scenario, associator="jcbb", settings=KING)
    home = None
    for k, step in enumerate(list(scenario.steps)[:240]):
        slam.court.watch = Watch()  # it never sees anything
        record = slam.step(step.t, step.control, step.observations)
        if record.info.get("king") == "home":
            home = k
            truth = step.truth.pose
            break
    assert home is not None
    assert np.hypot(*(record.pose[:2] - truth[:2])) < 0.3
    past, node = 0, slam.branches[0].history
    while node is not None:
        past, node = past + 1, node[0]
    assert past == home + 1


def test_a_brother_who_agrees_has_nothing_to_say():
    scenario = cloister(np.random.default_rng(7), laps=2, jitter=0.2)
    slam = prepare(scenario, associator="jcbb", settings=KING)
    steps = list(scenario.steps)
    for step in steps[:200]:
        slam.step(step.t, step.control, step.observations)
    slam.court.lookout.rules = Keeping(content=2.0)  # never content: brothers go out all the same
    for step in steps[200:225]:
        slam.step(step.t, step.control, step.observations)
    walkers = slam.court.lookout.walkers
    assert len(walkers) > 4
    assert all(ask(walker, slam, King(), slam.estimate()) is None for walker in walkers)


def test_what_the_family_founded_since_somebody_set_out_is_not_asked(monkeypatch):
    slam = prepare(cloister(np.random.default_rng(8), laps=2), associator="jcbb", settings=KING)
    for step in list(cloister(np.random.default_rng(8), laps=2).steps)[:61]:
        slam.step(step.t, step.control, step.observations)
    asked = []
    monkeypatch.setattr(lookout, "question", lambda king, away, *rest: asked.append(away))
    for walker in slam.court.lookout.walkers:
        ask(walker, slam, King(), slam.estimate())
    ledger = slam.branches[0].ledger
    assert len(asked) == len(slam.court.lookout.walkers) > 4
    for walker, away in zip(slam.court.lookout.walkers, asked, strict=True):
        youngest = max(ledger[i].born for i in away.old.ids.tolist())
        assert youngest <= walker.since.scan - Keeping().every
    assert max(life.born for life in ledger.values()) > slam.court.lookout.walkers[-1].since.scan - Keeping().every


def test_between_two_looks_only_who_was_near_an_answer_is_asked(monkeypatch):
    slam = prepare(cloister(np.random.default_rng(9), laps=2), associator="jcbb", settings=KING)
    asked = []

    def noted(walker, loop, *rest):
        asked.append((loop.scan + 1, walker.unsettled))
        walker.unsettled = walker is loop.court.lookout.walkers[0]

    monkeypatch.setattr(lookout, "ask", noted)
    for step in list(cloister(np.random.default_rng(9), laps=2).steps)[:60]:
        slam.step(step.t, step.control, step.observations)
    between = [unsettled for scan, unsettled in asked if scan % Keeping().every]
    assert between
    assert all(between)
    assert not all(unsettled for scan, unsettled in asked if scan % Keeping().every == 0)
