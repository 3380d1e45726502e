"""What is compared with what, and the regression watch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tomthumb.bench.compare import against_baseline, against_rows, counterpart, summary
from tomthumb.bench.grid import Grid, from_table
from tomthumb.errors import TomThumbError


def grid(**more: object) -> Grid:
    table = {"seeds": 30, "scenario": {"use": "cloister"}, "associator": [{"use": "nn"}, {"use": "jcbb"}], **more}
    return from_table(table, Path.cwd())


def rows(shift: float = 0.0, status: str = "done", seeds: int = 30, **more: object) -> list[dict[str, object]]:
    noise = np.random.default_rng(0).normal(0, 1, (2, 200))
    return [
        {"scenario": "cloister", "method": m, "associator": m, "seed": s, "case": m, "status": status, "reason": "why",
         "match_rate": 0.9 + 0.001 * noise[k, s] + k * shift, "wrong_ids": 0, "failure": None, **more}
        for s in range(seeds) for k, m in enumerate(("nn", "jcbb"))
    ]  # fmt: skip


def test_verdicts_in_words() -> None:
    found = {v.measure.key: v for v in against_baseline(rows(0.01), grid(measures=["match_rate", "wrong_ids"]))}
    assert found["match_rate"].comparison.verdict == "better"
    assert found["match_rate"].sentence().startswith("cloister: jcbb is better than nn by match rate: +")
    assert found["wrong_ids"].sentence() == "cloister: jcbb is the same as nn by wrong identities (all 30 seeds)"
    none = against_baseline(rows(0.00005), grid(measures=["match_rate"]))[0]
    assert "not to be told from" in none.sentence()


def test_counterpart_keeps_estimator_and_life_cycle() -> None:
    several = grid(slam=[{"hits": 5}, {"hits": 1}], baseline="nn")
    assert counterpart(several, "jcbb / hits=1") == "nn / hits=1"
    assert counterpart(several, "nn / hits=1") is None
    one = grid(slam=[{"hits": 5}, {"hits": 1}], baseline="nn / hits=5")
    assert counterpart(one, "nn / hits=1") == "nn / hits=5"


def test_watch_finds_what_changed_and_is_silent_where_nothing_did() -> None:
    same = against_rows(rows(), rows(code="older"), ["match_rate"])
    assert not same.worse
    assert same.shared == 60
    assert against_rows(rows(-0.01), rows(), ["match_rate"]).worse
    assert not against_rows(rows(0.01), rows(), ["match_rate"]).worse


def test_watch_takes_new_failures_as_worse() -> None:
    broken = rows()
    broken[3] = {**broken[3], "status": "error"}
    broken[5] = {**broken[5], "failure": "diverged"}
    watch = against_rows(broken, rows(), ["wrong_ids"])
    assert watch.worse
    assert watch.broke == ["cloister: jcbb, seed 1: error: why", "cloister: jcbb, seed 2: diverged"]
    assert not against_rows(broken, broken, ["wrong_ids"]).worse


def test_watch_over_other_seeds_only_what_is_shared() -> None:
    assert against_rows(rows(seeds=50), rows(seeds=20), ["match_rate"]).shared == 40
    with pytest.raises(TomThumbError, match="no run of these rows"):
        against_rows(rows(case="other"), rows(), ["match_rate"])


def test_watch_errs_as_often_as_it_should() -> None:
    """Two samples of one method with independent seeds: one alarm in twenty at most, over the whole watch."""
    rng, alarms = np.random.default_rng(1), 0
    for _ in range(300):
        now, then = rows(), rows()
        for row in (*now, *then):
            row["match_rate"] = float(1 - rng.poisson(4) / 1390)
        watch = against_rows(now, then, ["match_rate"])
        alarms += any(v.comparison.verdict in ("better", "worse") for v in watch.verdicts)
    assert alarms <= 300 * 0.05 + 3.3 * np.sqrt(300 * 0.05 * 0.95)


def test_summary_counts_failures_apart() -> None:
    mixed = rows()
    mixed[0] = {**mixed[0], "status": "error", "match_rate": None}
    cell = summary(mixed, ["match_rate"])[0]
    assert (cell.n, cell.failed) == (29, 1)
    assert cell.means["match_rate"][1] < cell.means["match_rate"][0] < cell.means["match_rate"][2]
