"""The tables of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tomthumb.bench.compare import Cell, Verdict, against_baseline, signed, summary
from tomthumb.bench.execute import DONE
from tomthumb.bench.grid import Grid
from tomthumb.bench.measures import Measure, measure
from tomthumb.site import html
from tomthumb.site.claims import judge
from tomthumb.site.html import Entry
from tomthumb.stats import error_bound

Row = Mapping[str, Any]
COST = ("step_ms_p50", "associate_us_p50", "associate_us_p99")
MARKS = {"better": "good", "worse": "bad", "holds": "good", "does not hold": "bad"}


def claims_table(rows: Sequence[Row], grid: Grid) -> str:
    """Every claim of the grid with its verdict."""
    found = judge(grid.claims, rows, grid)
    if not found:
        return ""
    entries = [
        [Entry(j.claim.text), Entry(j.claim.scenario or "all"), Entry(j.claim.method),
         Entry(measure(j.claim.measure).title), Entry(j.verdict, mark=MARKS.get(j.verdict, "")), Entry(j.evidence)]
        for j in found
    ]  # fmt: skip
    return html.table(["claim", "scenario", "method", "measure", "verdict", "evidence"], entries, "claims")


def summary_table(rows: Sequence[Row], grid: Grid) -> str:
    """Mean and interval of every measure, for every method in every scenario."""
    keys = [*dict.fromkeys((*grid.measures, *COST))]
    measures = [measure(key) for key in keys]
    heads = ["scenario", "method", "runs", "failed", "diverged", *(m.title for m in measures)]
    return html.table(heads, [_summary_row(cell, measures) for cell in summary(rows, keys)], "summary")


def _summary_row(cell: Cell, measures: Sequence[Measure]) -> list[Entry]:
    counts = [Entry(str(n), n) for n in (cell.n, cell.failed, cell.diverged)]
    return [Entry(cell.scenario), Entry(cell.method), *counts, *(_mean_entry(cell, m) for m in measures)]


def _mean_entry(cell: Cell, m: Measure) -> Entry:
    mean, low, high = cell.means[m.key]
    if mean != mean:
        return Entry("–")
    if cell.perfect.get(m.key) == cell.n and cell.n:
        return Entry(f"{m.text(mean)} (runs that err: under {100 * error_bound(0, cell.n):.2g} %)", mean)
    return Entry(f"{m.text(mean)} [{m.text(low)}, {m.text(high)}]", mean)


def comparison_table(rows: Sequence[Row], grid: Grid) -> str:
    """Every method against the baseline: the verdict in words and all that it rests on."""
    verdicts = against_baseline(rows, grid)
    if not verdicts:
        return ""
    heads = ["scenario", "method", "against", "measure", "verdict", "difference", "Wilcoxon interval",
             "p (Holm)", "p", "effect", "d", "won", "equal", "lost", "seeds that would tell"]  # fmt: skip
    return html.table(heads, [_verdict_row(v) for v in verdicts], "comparisons")


def _verdict_row(v: Verdict) -> list[Entry]:
    c, m = v.comparison, v.measure
    needed = "" if v.needed is None else f"{v.needed}"
    return [
        Entry(v.scenario), Entry(v.method), Entry(v.against), Entry(m.title),
        Entry(c.verdict, mark=MARKS.get(c.verdict, "")),
        Entry(f"{signed(m, c.mean)} [{signed(m, c.low)}, {signed(m, c.high)}]", c.mean),
        Entry(f"{signed(m, c.shift)} [{signed(m, c.shift_low)}, {signed(m, c.shift_high)}]", c.shift),
        Entry(f"{c.p_holm:.3g}", c.p_holm), Entry(f"{c.p:.3g}", c.p), Entry(f"{c.effect:+.2f}", c.effect),
        Entry("–" if c.dz != c.dz else f"{c.dz:+.2f}", c.dz),
        *(Entry(str(n), n) for n in (c.wins, c.ties, c.losses)), Entry(needed, v.needed),
    ]  # fmt: skip


def shown_table(rows: Sequence[Row], seed: int | None) -> str:
    """The runs of one world, with links to their pages."""
    entries = [
        [Entry(row["scenario"]), Entry(row["method"], link=f"run.html#{i}")]
        for i, row in enumerate(rows)
        if row["seed"] == seed
    ]
    return html.table(["scenario", "method"], entries, "shown") if entries else ""


def failures_table(rows: Sequence[Row]) -> str:
    """Runs without a result, and why."""
    failed = [(i, row) for i, row in enumerate(rows) if row["status"] != DONE]
    entries = [
        [Entry(row["scenario"]), Entry(row["method"]), Entry(str(row["seed"]), row["seed"], f"run.html#{i}"),
         Entry(row["status"], mark="bad"), Entry(row["reason"] or "")]
        for i, row in failed[:500]
    ]  # fmt: skip
    return html.table(["scenario", "method", "seed", "status", "reason"], entries, "failures") if entries else ""


def sessions_list(sessions: Sequence[Mapping[str, Any]]) -> str:
    """The exact commands, how long they took, and the versions they ran with."""
    parts = []
    for s in sessions:
        environment = dict(s["environment"])
        command = environment.pop("command", "")
        line = f"{s['started']}: {s['rows']} runs in {s['seconds']:.0f} s ({s['workers']}), in runs {s['busy']:.0f} s"
        parts.append(html.preformatted(command) + html.details(line, html.pairs(environment)))
    return "\n".join(parts)
