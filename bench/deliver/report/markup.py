"""The elements of HTML of which sections consist. All text is escaped here; sections contain no tags themselves."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup, escape

_LONG_TABLE = 40


@dataclass(frozen=True)
class Section:
    """One part of the report: its anchor, heading and content."""

    id: str
    title: str
    html: Markup


@dataclass(frozen=True)
class Row:
    """One line of a table; `tone` marks it as `bad` or `best`."""

    cells: tuple[object, ...]
    tone: str = ""


def paragraph(text: object) -> Markup:
    """One paragraph."""
    return Markup("<p>{}</p>\n").format(text)


def lead(text: object) -> Markup:
    """The main sentence of a section, in large type."""
    return Markup('<p class="lead">{}</p>\n').format(text)


def commands(lines: Iterable[str]) -> Markup:
    """Command lines to copy."""
    return Markup("<pre><code>{}</code></pre>\n").format("\n".join(lines))


def wide(text: object) -> Markup:
    """Text of a table cell that may take several lines."""
    return Markup('<span class="wide">{}</span>').format(text)


def heading(text: str) -> Markup:
    """A heading within a section."""
    return Markup("<h3>{}</h3>\n").format(text)


def table(
    caption: str, head: Sequence[str], rows: Iterable[Row | Sequence[object]], numeric: Iterable[int] = ()
) -> Markup:
    """A table with a caption; the columns in `numeric` are right-aligned; the first cell is the header of its row.

    A long table is collapsed under its caption.
    """
    right = set(numeric)
    lines = [row if isinstance(row, Row) else Row(tuple(row)) for row in rows]
    title = "" if len(lines) > _LONG_TABLE else Markup("<caption>{}</caption>").format(caption)
    cells = Markup().join(_cell("th", text, i in right, "col") for i, text in enumerate(head))
    top = Markup("<thead><tr>{}</tr></thead>").format(cells) if any(head) else ""
    html = Markup('<div class="scroll"><table>{}{}\n<tbody>\n{}\n</tbody></table></div>\n').format(
        title,
        top,
        Markup("\n").join(_line(line, right) for line in lines),
    )
    if len(lines) <= _LONG_TABLE:
        return html
    return Markup("<details><summary>{} ({} lines)</summary>\n{}</details>\n").format(caption, len(lines), html)


def _line(row: Row, right: set[int]) -> Markup:
    tone = Markup(' class="{}"').format(row.tone) if row.tone else ""
    first, *others = row.cells
    cells = [
        _cell("th", first, 0 in right, "row"),
        *(_cell("td", text, i in right) for i, text in enumerate(others, 1)),
    ]
    return Markup("<tr{}>{}</tr>").format(tone, Markup().join(cells))


def _cell(tag: str, text: object, right: bool, scope: str = "") -> Markup:
    kind = Markup(' class="n"') if right else ""
    role = Markup(' scope="{}"').format(scope) if scope else ""
    return Markup("<{0}{1}{2}>{3}</{0}>").format(Markup(tag), role, kind, text)


def facts(pairs: Iterable[tuple[str, object]], caption: str) -> Markup:
    """A table of name and value."""
    return table(caption, ("", ""), pairs)


def mono(text: str) -> Markup:
    """A hash or a path."""
    return Markup('<span class="hash">{}</span>').format(text)


def glossary(terms: Iterable[tuple[str, str]]) -> Markup:
    """A list of terms and their meanings."""
    return Markup("<dl>\n{}</dl>\n").format(
        Markup().join(Markup("<dt>{}</dt><dd>{}</dd>\n").format(term, text) for term, text in terms)
    )


def figure(name: str, plot: dict[str, Any], caption: str, alt: str) -> Markup:
    """A figure drawn by the browser from JSON; `alt` is its text alternative."""
    height = int(plot["layout"]["height"])
    # A "</script>" inside a name must not end the block: JSON allows the escape, and HTML does not see the tag.
    data = json.dumps(plot, allow_nan=False, separators=(",", ":"))
    data = data.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Markup(
        '<figure>\n<div class="plot" role="img" aria-label="{alt}" data-figure="{name}-data" style="height:{height}px">'
        '</div>\n<script type="application/json" id="{name}-data">{data}</script>\n'
        "<figcaption>{caption}</figcaption>\n</figure>\n"
    ).format(name=name, alt=alt, caption=caption, height=height, data=Markup(data))


def text_of(value: object) -> Markup:
    """Any value of a manifest as text; lists and mappings on one line."""
    if isinstance(value, dict):
        return escape(", ".join(f"{key}: {item}" for key, item in value.items()))
    if isinstance(value, list | tuple):
        return escape(", ".join(str(item) for item in value))
    return escape(value)
