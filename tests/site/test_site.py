"""The report of a small real grid: what it says, that it holds everything it needs, and that it works in a browser."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tomthumb.bench import Where, bench, read_rows
from tomthumb.bench.grid import Grid, from_table
from tomthumb.bench.session import grid_of
from tomthumb.errors import TomThumbError
from tomthumb.site import build
from tomthumb.site.build import command
from tomthumb.site.charts import sweeps, worlds
from tomthumb.site.claims import judge
from tomthumb.site.html import Entry
from tomthumb.site.pictures import choose, draw

BROWSER = Path("/usr/bin/chromium")
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


def small() -> Grid:
    table = {
        "name": "a <small> grid",
        "seeds": 6,
        "baseline": "nn",
        "scenario": [{"use": "cloister", "odometry_noise": [2.0, 4.0]}],
        "associator": [{"use": "nn"}, {"use": "jcbb", "gate": [0.99, 0.9999]}],
        "claim": [
            {"text": "wide is better", "method": "jcbb gate=0.9999", "better_than": "nn"},
            {"text": "nn never errs", "method": "nn", "at_least": 1.0},
        ],
    }
    return from_table(table, Path.cwd())


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grid")
    bench(small(), folder, Where(2))
    build(small(), folder, pages=7, workers=2)
    return folder


def data_of(path: Path) -> Any:
    """What a data script hands over."""
    found = re.fullmatch(r'receive\("\w+",(.*)\);\n', path.read_text(), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_every_link_and_picture_is_there_and_nothing_comes_from_elsewhere(out: Path) -> None:
    site = out / "report"
    for page in ("index.html", "run.html"):
        text = (site / page).read_text()
        assert "http" not in text.replace("http://www.w3.org", "")
        for link in re.findall(r'(?:href|src)="([^"#]+)', text):
            assert (site / link).exists(), link


def test_names_are_escaped(out: Path) -> None:
    assert "<small>" not in (out / "report" / "index.html").read_text()
    assert Entry("<b>", link='x"y').html() == '<td><a href="x&quot;y">&lt;b&gt;</a></td>'


def test_list_and_details_hold_every_row(out: Path) -> None:
    rows = read_rows(out)
    listed = data_of(out / "report" / "rows.js")
    assert listed["count"] == len(rows) == 36
    assert listed["columns"]["seed"] == [row["seed"] for row in rows]
    block = data_of(out / "report" / "rows" / "0.js")
    assert block[5]["values"]["match_rate"] == pytest.approx(rows[5]["match_rate"], abs=1e-5)


def test_pictures_repeat_their_runs_exactly(out: Path) -> None:
    site = out / "report"
    drawn = data_of(site / "rows.js")["drawn"]
    assert len(drawn) == 7
    for i in drawn:
        picture = data_of(site / "runs" / f"{i}.js")
        assert picture["note"] == "Repeated for this page: every figure is that of the row."
        row = read_rows(out)[i]
        assert picture["mistakes"] == row["fp"] + row["fn"]


def test_first_mistake_is_the_first(out: Path) -> None:
    from tomthumb.bench.execute import load_world, run_world
    from tomthumb.metrics import collect, decide

    run = next(
        run for run in small().runs() if run.associator.use == "nn" and run.scenario.params["odometry_noise"] == 4
    )
    scenario = load_world(run.job())
    trace = run_world(scenario, run.job())
    wrong = decide(trace, collect(scenario, trace))
    first = draw(scenario, run.job())["first"]
    row = int(np.flatnonzero(wrong.outcome >= 3)[0])
    assert trace.offsets[first["step"]] <= row < trace.offsets[first["step"] + 1]
    assert f"observation {row}:" in first["text"]
    assert first["outcomes"][row - trace.offsets[first["step"]]] in ("fp", "fn")


def test_worst_and_middle_of_every_cell_are_drawn_first() -> None:
    rows = [
        {"scenario": s, "method": m, "status": "done", "match_rate": rate, "ate_m": 0.1, "failure": None, "seed": 0}
        for s in "ab" for m in "xy" for rate in (0.9, 0.5, 0.7, 0.8, 1.0)
    ]  # fmt: skip
    assert choose(rows, 8) == [1, 3, 6, 8, 11, 13, 16, 18]
    assert choose(rows, 3) == [1, 6, 11]
    numbered = [{**row, "seed": i % 5} for i, row in enumerate(rows)]
    assert choose(numbered, 6, show=4) == [1, 4, 6, 9, 14, 19]
    assert len(choose(rows, 100)) == 20
    assert choose([{**row, "status": "error"} for row in rows], 5) == []


def test_claims(out: Path) -> None:
    better, never = judge(small().claims, read_rows(out), small())
    assert better.verdict == "holds"
    assert "12 pairs" in better.evidence
    assert never.verdict == "does not hold"


def test_a_claim_says_what_a_hundred_percent_is_worth() -> None:
    from tomthumb.bench.grid import Claim

    rows = [{"scenario": "c", "method": "m", "associator": "m", "status": "done", "match_rate": 1.0}] * 30
    found = judge([Claim("never errs", "m", at_least=1.0)], rows, small())[0]
    assert found.verdict == "holds"
    assert "30 of 30 runs without any mistake (a run errs with at most 9.5 %" in found.evidence


def test_sweeps_are_found_and_lines_join_what_differs_in_nothing_else(out: Path) -> None:
    found = {sweep.parameter: sweep.lines for sweep in sweeps(read_rows(out))}
    assert set(found) == {"scenario.odometry_noise", "associator.gate"}
    assert len(found["scenario.odometry_noise"]) == 3
    assert len(found["associator.gate"]) == 2
    assert all(set(line) == {0.99, 0.9999} for line in found["associator.gate"].values())


def test_worlds_table_puts_failed_runs_as_unknown() -> None:
    row = {"scenario": "c", "seed": 1, "method": "a", "status": "done", "ate_m": 0.5}
    names, table = worlds([row, {**row, "method": "b", "status": "error"}], "ate_m")
    assert names == ("a", "b")
    np.testing.assert_array_equal(table, [[0.5, np.nan]])


def test_the_grid_is_kept_with_its_rows(out: Path) -> None:
    assert [run.key for run in grid_of(out).runs()] == [run.key for run in small().runs()]


def test_the_command_of_a_row_repeats_it(out: Path) -> None:
    text = command(read_rows(out)[1])
    assert text.startswith("tomthumb run cloister --associator jcbb --estimator iekf --seed 0 --set ")
    assert "--set odometry_noise=2" in text
    assert "--set associator.gate=0.99" in text


def test_nothing_to_report(tmp_path: Path) -> None:
    with pytest.raises(TomThumbError, match="no such journal"):
        build(small(), tmp_path)


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    sync = pytest.importorskip("playwright.sync_api", reason="the browser test needs playwright")
    if not BROWSER.exists():
        pytest.skip(f"the browser test needs {BROWSER}")
    with sync.sync_playwright() as player:
        browser = player.chromium.launch(executable_path=str(BROWSER), args=FLAGS)
        page = browser.new_page()
        page.errors = []
        page.on("pageerror", lambda error: page.errors.append(str(error)))
        page.on("requestfailed", lambda request: page.errors.append(f"failed: {request.url}"))
        yield page
        browser.close()


def column(page: Any, table: str, number: int) -> list[str]:
    found: list[str] = page.eval_on_selector_all(
        f"#{table} tbody tr td:nth-child({number})", "cells => cells.map(c => c.textContent)"
    )
    return found


def test_browser_sorts_the_list_of_runs(out: Path, page: Any) -> None:
    page.goto((out / "report" / "index.html").as_uri())
    page.wait_for_selector("#runs tbody tr")
    assert len(column(page, "runs", 1)) == 36
    page.click("#runs th:has-text('ATE [m]')")
    ate = [float(text) for text in column(page, "runs", 9)]
    assert ate == sorted(ate)
    page.click("#runs th:has-text('ATE [m]')")
    assert [float(text) for text in column(page, "runs", 9)] == sorted(ate, reverse=True)
    page.fill("#filter", "gate=0.9999 seed=3")
    assert len(column(page, "runs", 1)) == 2
    assert page.errors == []


def test_browser_sorts_tables_by_value_not_by_text(out: Path, page: Any) -> None:
    page.goto((out / "report" / "index.html").as_uri())
    page.click("#summary th:has-text('match rate')")
    rates = [float(text.split(" ")[0]) for text in column(page, "summary", 6)]
    assert rates == sorted(rates)
    assert rates[-1] == 100.0


def test_browser_shows_figures(out: Path, page: Any) -> None:
    page.goto((out / "report" / "index.html").as_uri())
    page.eval_on_selector_all("img", "images => images.forEach(i => i.loading = 'eager')")
    page.wait_for_function("[...document.images].every(i => i.complete)")
    sizes = page.eval_on_selector_all("img", "images => images.map(i => i.naturalWidth)")
    assert len(sizes) > 8
    assert min(sizes) > 100


def test_browser_follows_the_link_to_a_drawn_run(out: Path, page: Any) -> None:
    page.goto((out / "report" / "index.html").as_uri())
    page.fill("#filter", "odometry_noise=4 nn")
    page.click("#runs a:has-text('drawn')")
    page.wait_for_selector("#plots svg .first-mistake")
    assert "nn, seed" in page.inner_text("h1")
    assert "The first mistake. Step" in page.inner_text("#plots")
    page.wait_for_function("document.querySelectorAll('#plots svg .right circle').length > 500")
    assert page.locator("#plots svg").count() == 5
    assert page.inner_text("#command").startswith("tomthumb run cloister")
    assert page.errors == []


def test_browser_says_what_is_not_drawn(out: Path, page: Any) -> None:
    drawn = data_of(out / "report" / "rows.js")["drawn"]
    other = next(i for i in range(36) if i not in drawn)
    page.goto((out / "report" / "run.html").as_uri() + f"#{other}")
    page.wait_for_function("document.getElementById('note').textContent.startsWith('Not drawn')")
    assert "match_rate" in page.inner_text("#values")
