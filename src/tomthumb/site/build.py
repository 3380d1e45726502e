"""Write the site: pages, tables, figures, rows, and the data of the run pages."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tomthumb.bench.execute import DONE
from tomthumb.bench.grid import Grid
from tomthumb.bench.journal import reading
from tomthumb.bench.measures import MEASURES
from tomthumb.bench.rows import write_rows
from tomthumb.bench.session import journal_path
from tomthumb.errors import TomThumbError
from tomthumb.site import html, tables
from tomthumb.site.charts import Chart, charts
from tomthumb.site.pictures import choose, paint

BLOCK = 250  # rows in a file of details: what a run page loads
Rows = Sequence[Mapping[str, Any]]
HIDDEN = ("case", "world", "key", "detail", "position", "data")


def build(
    grid: Grid,
    out: Path,
    site: Path | None = None,
    *,
    pages: int | None = None,
    workers: int = 1,
    tell: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write the report of the grid whose journal is in `out`; the path of its first page.

    `pages` runs (the grid's own number by default) are repeated on `workers` processes to be drawn. Raises
    TomThumbError.
    """
    with reading(journal_path(out)) as journal:
        rows = list(journal.rows())
        planned, sessions = journal.planned(), journal.sessions()
    if not rows:
        raise TomThumbError(f"{out}: no run is finished yet")
    site = site or out / "report"
    try:
        for folder in (site, site / "figures", site / "rows", site / "runs"):
            folder.mkdir(parents=True, exist_ok=True)
        chosen = choose(rows, grid.pages if pages is None else pages, grid.show)
        _draw_runs(site, rows, grid, chosen, workers, tell)
        _write_data(site, rows, grid, chosen)
        figures = _draw_figures(site, charts(rows, grid), tell)
        tell("tables")
        body = _body(rows, planned, sessions, grid, figures, _downloads(site, rows, grid))
        (site / "index.html").write_text(html.page(grid.name, body), "utf-8")
    except OSError as reason:
        raise TomThumbError(f"{site}: cannot be written: {reason.strerror or reason}") from None
    return site / "index.html"


def _body(
    rows: Rows, planned: int, sessions: Sequence[Mapping[str, Any]], grid: Grid, figures: str, downloads: str
) -> str:
    failed = sum(row["status"] != DONE for row in rows)
    said = [f"{len(rows)} of {planned} runs", f"{failed} failed", f"{len(grid.seeds)} seeds from {grid.seeds[0]}"]
    baseline = f"Compared with {grid.baseline}, paired by world and seed; level {grid.level:g}, corrected after Holm."
    return "\n".join([
        html.paragraph(grid.description),
        html.paragraph(", ".join(said) + "."),
        html.section("Claims", tables.claims_table(rows, grid)),
        html.section("Means, with 95 % bootstrap intervals by run", tables.summary_table(rows, grid)),
        html.section("Better or worse", html.paragraph(baseline), tables.comparison_table(rows, grid)),
        html.section(f"Seed {grid.show}, method by method", tables.shown_table(rows, grid.show)),
        html.section("Figures", f'<div class="figures">{figures}</div>' if figures else ""),
        html.section("Failed runs", tables.failures_table(rows)),
        html.section("All runs", html.asset("runs.html")),
        html.section("How this was made", downloads, tables.sessions_list(sessions),
                     html.details("the grid", html.preformatted(grid.text)) if grid.text else ""),
    ])  # fmt: skip


def _draw_runs(
    site: Path, rows: Rows, grid: Grid, chosen: Sequence[int], workers: int, tell: Callable[[str], None]
) -> None:
    """Write the pictures of the chosen runs."""
    for old in (site / "runs").glob("*.js"):
        old.unlink()
    done = 0

    def told(more: int) -> None:
        nonlocal done
        done += more
        tell(f"runs drawn: {done} of {len(chosen)}")

    for i, picture in paint(rows, chosen, grid, workers, told).items():
        _write_js(site / "runs" / f"{i}.js", "picture", picture)


def _draw_figures(site: Path, found: Sequence[Chart], tell: Callable[[str], None]) -> str:
    parts = []
    for chart in found:
        tell(f"figure {chart.name}")
        parts.append(html.figure(f"figures/{chart.save(site / 'figures')}", chart.caption))
    return "\n".join(parts)


def _write_data(site: Path, rows: Rows, grid: Grid, drawn: Sequence[int]) -> None:
    """The list of runs by columns, and every row with all it holds in blocks of a few hundred."""
    keys = [*dict.fromkeys((*grid.measures, "nees", "step_ms_p50", "seconds"))]
    names = ["scenario", "method", "seed", "status", *keys, "failure"]
    columns = {name: [_short(row.get(name)) for row in rows] for name in names}
    heads = {key: {"title": m.title + (f" [{m.unit.strip()}]" if m.unit else ""), "scale": m.scale}
             for key in keys if (m := MEASURES.get(key))}  # fmt: skip
    table = {"columns": columns, "heads": heads, "drawn": list(drawn), "block": BLOCK, "count": len(rows)}
    _write_js(site / "rows.js", "list", table)
    for first in range(0, len(rows), BLOCK):
        block = [_detail(row) for row in rows[first : first + BLOCK]]
        _write_js(site / "rows" / f"{first // BLOCK}.js", "block", block)
    for name in ("style.css", "list.js", "run.html", "run.js"):
        (site / name).write_text(html.asset(name), "utf-8")


def _detail(row: Mapping[str, Any]) -> dict[str, Any]:
    """What a run's page says of it: everything known, and the command that repeats it."""
    shown = {key: _short(value) for key, value in row.items() if key not in HIDDEN and value is not None}
    return {"values": shown, "command": command(row), "detail": row.get("detail")}


def command(row: Mapping[str, Any]) -> str:
    """The command line that repeats one run."""
    words = ["tomthumb", "run", str(row["scenario.use"]), "--associator", str(row["associator.use"])]
    words += ["--estimator", str(row["estimator.use"]), "--seed", str(row["seed"])]
    for key, value in row.items():
        kind, dot, name = key.partition(".")
        if dot and name != "use" and value is not None:
            text = json.dumps(value) if isinstance(value, (bool, list)) else str(value)
            words += ["--set", f"{name if kind == 'scenario' else key}={text}"]
    return shlex.join([*words, "--json"])


def _short(value: Any) -> Any:
    """Six digits are enough to look at; the downloads hold all of them."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def _write_js(path: Path, name: str, data: Any) -> None:
    """Data as a script, since a page opened from a folder may load scripts and nothing else."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    path.write_text(f"receive({json.dumps(name)},{text});\n", "utf-8")


def _downloads(site: Path, rows: Rows, grid: Grid) -> str:
    """All rows as CSV, and as Parquet where that can be written; the grid."""
    names = ["rows.csv"]
    write_rows(site / "rows.csv", [dict(row) for row in rows])
    if find_spec("pyarrow") is not None:  # an extra
        write_rows(site / "rows.parquet", [dict(row) for row in rows])
        names.append("rows.parquet")
    if grid.text:
        (site / "grid.toml").write_text(grid.text, "utf-8")
        names.append("grid.toml")
    return "<p>Download: " + ", ".join(f'<a href="{name}" download>{name}</a>' for name in names) + "</p>"
