"""One HTML file that needs nothing else: tables, figures inside, what was run and with which versions."""

from __future__ import annotations

import base64
import html
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tomthumb.report.figures import render
from tomthumb.report.tables import GROUPS, Column
from tomthumb.storage import writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PACKAGES = ("tomthumb", "numpy", "scipy", "numba", "matplotlib")


@dataclass(frozen=True)
class Picture:
    """A figure with its title and the words below it."""

    title: str
    figure: Figure
    caption: str


def run_page(row: Mapping[str, Any], pictures: Sequence[Picture], command: str) -> str:
    """The page of one run: its metrics in groups, then the figures."""
    title = f"{row['scenario']}: {row['associator']} with {row['estimator']}, seed {row['seed']}"
    tables = "".join(f"<h2>{html.escape(name)}</h2>{_list(columns, row)}" for name, columns in GROUPS.items())
    return page(title, _failure(row) + f'<div class="groups">{tables}</div>' + pictures_html(pictures), command)


def page(title: str, body: str, command: str) -> str:
    """A whole document around `body`, with the command that made it and the versions it ran on."""
    return _PAGE.format(
        title=html.escape(title),
        style=_STYLE,
        body=body,
        command=html.escape(command),
        versions=html.escape(versions()),
    )


def save(path: Path, content: str) -> Path:
    """Write the page. Raises TomThumbError where that cannot be done."""
    with writing(path):
        path.write_text(content, encoding="utf-8")
    return path


def comparison_table(columns: Sequence[Column], rows: Sequence[Mapping[str, Any]], first: str) -> str:
    """Rows side by side, one line each; the meaning of a column stands in its heading's tip and below the table."""
    heads = "".join(f'<th title="{html.escape(c.meaning)}">{html.escape(c.heading)}</th>' for c in columns)
    lines = "".join(
        f"<tr><td>{html.escape(str(row[first]))}</td>" + "".join(f"<td>{c.text(row)}</td>" for c in columns) + "</tr>"
        for row in rows
    )
    meanings = "".join(f"<li><b>{html.escape(c.heading)}</b> {html.escape(c.meaning)}</li>" for c in columns)
    return (
        f'<div class="wide"><table><thead><tr><th></th>{heads}</tr></thead><tbody>{lines}</tbody></table></div>'
        f"<details><summary>What the columns say</summary><ul>{meanings}</ul></details>"
    )


def pictures_html(pictures: Sequence[Picture]) -> str:
    """Figures as they stand in the page, each as small as it can be."""
    return "".join(
        f"<figure><h2>{html.escape(p.title)}</h2>"
        f'<img alt="{html.escape(p.title)}" width="{_width(p.figure)}" src="{data_uri(p.figure)}">'
        f"<figcaption>{html.escape(p.caption)}</figcaption></figure>"
        for p in pictures
    )


def data_uri(figure: Figure) -> str:
    """The figure inside an address: SVG, or PNG where that is smaller (many thousand points)."""
    vector, raster = render(figure, "svg"), render(figure, "png")
    kind, content = ("svg+xml", vector) if len(vector) <= 2 * len(raster) else ("png", raster)
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _width(figure: Figure) -> int:
    """Pixels that show the figure's letters at about the size of the page's."""
    return round(110 * float(figure.get_figwidth()))


def versions() -> str:
    """Python, system and the packages that the numbers depend on."""
    found = [f"Python {platform.python_version()}", f"{platform.system()} {platform.machine()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:  # run from a source tree that was never installed
            found.append(f"{package} (not installed)")
    return ", ".join(found)


def _list(columns: Sequence[Column], row: Mapping[str, Any]) -> str:
    lines = "".join(
        f"<tr><th>{html.escape(c.heading)}</th><td>{c.text(row)}</td><td>{html.escape(c.meaning)}</td></tr>"
        for c in columns
    )
    return f'<table class="metrics"><tbody>{lines}</tbody></table>'


def _failure(row: Mapping[str, Any]) -> str:
    if not row.get("failure"):
        return ""
    return (
        f'<p class="failure">The filter failed: {html.escape(row["failure"])}. What follows is the run up to there.</p>'
    )


_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2733; background: #fff; max-width: 1250px; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin: 1.6rem 0 .4rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .5rem; text-align: right; border-bottom: 1px solid #e3e8ee; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
thead th { background: #f3f6fa; }
.metrics th { font-weight: 600; width: 9rem; } .metrics td:nth-child(2) { width: 6rem; }
.metrics td:last-child { text-align: left; color: #5b6b7b; white-space: normal; }
.metrics { width: 100%; } .wide { overflow-x: auto; }
figure { margin: 1.5rem 0; } figure img { max-width: 100%; height: auto; border: 1px solid #e3e8ee; }
figcaption, footer, details { color: #5b6b7b; font-size: .9rem; }
code { background: #f3f6fa; padding: .1rem .3rem; border-radius: 3px; overflow-wrap: anywhere; }
.failure { background: #fff1e0; border-left: 4px solid #e08a00; padding: .5rem .8rem; }
footer { border-top: 1px solid #e3e8ee; margin-top: 2rem; padding-top: .8rem; }
"""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>{title}</h1>
{body}
<footer><p>Made by <code>{command}</code></p><p>{versions}</p></footer>
</body>
</html>
"""
