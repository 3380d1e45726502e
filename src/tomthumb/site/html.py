"""Small pieces of HTML. Everything that comes from outside is escaped here and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Entry:
    """One table entry: its text, what it is sorted by, a link and a class for its colour."""

    text: str
    order: float | None = None
    link: str = ""
    mark: str = ""

    def html(self) -> str:
        """As a table cell; where no order is given, tables sort by the text."""
        inner = escape(self.text)
        if self.link:
            inner = f'<a href="{escape(self.link)}">{inner}</a>'
        order = "" if self.order is None or math.isnan(self.order) else f' data-v="{self.order!r}"'
        mark = f' class="{escape(self.mark)}"' if self.mark else ""
        return f"<td{order}{mark}>{inner}</td>"


def table(heads: Sequence[str], rows: Iterable[Sequence[Entry]], name: str) -> str:
    """A table that sorts by the head that is clicked."""
    top = "".join(f'<th scope="col"><button type="button">{escape(head)}</button></th>' for head in heads)
    body = "\n".join(f"<tr>{''.join(entry.html() for entry in row)}</tr>" for row in rows)
    return f'<table class="sortable" id="{escape(name)}"><thead><tr>{top}</tr></thead><tbody>\n{body}\n</tbody></table>'


def section(title: str, *parts: str) -> str:
    """A part of the page with its heading; nothing when it would be empty."""
    inner = "\n".join(part for part in parts if part)
    return f"<section><h2>{escape(title)}</h2>\n{inner}\n</section>" if inner else ""


def paragraph(text: str) -> str:
    """Plain text as a paragraph."""
    return f"<p>{escape(text)}</p>" if text else ""


def listing(items: Iterable[str]) -> str:
    """Plain texts as a list."""
    inner = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<ul>{inner}</ul>" if inner else ""


def details(title: str, inner: str) -> str:
    """Something folded away."""
    return f"<details><summary>{escape(title)}</summary>{inner}</details>"


def preformatted(text: str) -> str:
    """Text as it is."""
    return f"<pre>{escape(text)}</pre>"


def figure(path: str, caption: str) -> str:
    """A picture that lies beside the page."""
    label = escape(caption)
    return f'<figure><img src="{escape(path)}" alt="{label}" loading="lazy"><figcaption>{label}</figcaption></figure>'


def pairs(entries: Mapping[str, str]) -> str:
    """Names and values."""
    inner = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in entries.items())
    return f"<dl>{inner}</dl>"


def asset(name: str) -> str:
    """A file that is part of this package."""
    return files("tomthumb.site").joinpath("assets", name).read_text("utf-8")


def page(title: str, body: str) -> str:
    """The frame of the index page."""
    return asset("index.html").replace("{{title}}", escape(title)).replace("{{body}}", body)
