"""The page needs nothing but itself, and is well-formed."""

from __future__ import annotations

import re
from html.parser import HTMLParser

from handmade import estimate, trace, truth
from tomthumb.metrics import score
from tomthumb.report import figures, page, tables
from tomthumb.storage import SavedRun

VOID = {"meta", "img", "link", "br"}


class Reader(HTMLParser):
    """Follows the tags and keeps the text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        self.addresses += [value for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def read(content: str) -> Reader:
    reader = Reader()
    reader.feed(content)
    assert reader.open == []
    return reader


def made(**other) -> tuple[dict, str]:
    run = SavedRun(trace([[0], [0]], estimate([0]), **other), truth([7, 7], 2))
    row = {"scenario": "<b>&", "associator": "nn", "estimator": "ekf", "seed": 0} | score(run.trace, run.truth)
    pictures = [page.Picture("Map", figures.map_figure(run), "where it went")]
    return row, page.run_page(row, pictures, "tomthumb run '<b>&'")


def test_a_run_page_is_well_formed_and_self_contained():
    reader = read(made()[1])
    assert all(address.startswith("data:image/") for address in reader.addresses)
    assert len(reader.addresses) == 1
    assert not re.search(r"https?://", made()[1].replace("http://www.w3.org", ""))
    assert "tomthumb run '<b>&'" in reader.text
    assert "where it went" in reader.text


def test_a_failure_is_said_first():
    assert "The filter failed: lost at step 1" in read(made(failure="lost at step 1")[1]).text


def test_tables_write_values_and_dashes():
    column = tables.Column("match_rate", "match %", ".2f", 100, "")
    assert column.text({"match_rate": 0.99568}) == "99.57"
    assert column.text({"match_rate": None}) == "–"
    table = read(page.comparison_table([column], [{"label": "a<b", "match_rate": 1.0}], "label"))
    assert "a<b" in table.text
    assert "100.00" in table.text


def test_every_column_is_a_metric():
    row, _ = made()
    columns = [*tables.OVERVIEW, *(column for group in tables.GROUPS.values() for column in group)]
    assert {column.key for column in columns} <= set(row)
    assert set(tables.NARROW) <= {column.key for column in tables.OVERVIEW}
