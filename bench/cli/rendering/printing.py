"""Printing of a result: as lines and tables on a terminal, as plain text into a pipe, or as one JSON object.

`lines` and `content` dispatch on the type of the result; the other modules of this package register the functions.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from datetime import date
from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base import finite

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

Part = "str | Table"


@singledispatch
def lines(result: object) -> Iterator[str | Table]:
    """A result as lines and tables for the user."""
    raise TypeError(f"no text is defined for {type(result).__name__}")


@singledispatch
def content(result: object) -> dict[str, Any]:
    """A result as an object for a program; by default its fields by name."""
    if hasattr(result, "to_json"):
        made: dict[str, Any] = result.to_json()
        return made
    if not is_dataclass(result):
        raise TypeError(f"no JSON is defined for {type(result).__name__}")
    return {field.name: _value(getattr(result, field.name)) for field in fields(result)}


def _value(value: Any) -> Any:
    if hasattr(value, "to_json"):
        return value.to_json()
    if is_dataclass(value):
        return content(value)
    if isinstance(value, Mapping):
        return {key: _value(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_value(one) for one in value]
    return str(value) if isinstance(value, Path | date) else value


def unit_text(unit: str | None) -> str:
    """A unit behind its number; nothing for a plain number."""
    return "" if unit in {None, "1"} else f" {unit}"


def show(result: object) -> None:
    """Print a result: tables fit a terminal; a pipe gets plain text in its full width."""
    if not sys.stdout.isatty():
        click.echo(plain(result))
        return
    console = _console()
    for part in lines(result):
        console.print(part, soft_wrap=isinstance(part, str))


def plain(result: object) -> str:
    """A result as text without colours."""
    return "\n".join(part if isinstance(part, str) else _plain(part) for part in lines(result))


def _plain(table: Table) -> str:
    text = io.StringIO()
    _console(file=text, width=10_000, color_system=None).print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())


def _console(**options: Any) -> Console:
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False, **options)


def table(titles: Sequence[str], rows: Iterable[Sequence[object]], indent: int = 0) -> Table:
    """A table without lines; a column whose title begins with `>` is right-aligned, None is a dash."""
    from rich.table import Table

    made = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold", show_header=any(titles))
    for i, title in enumerate(titles):
        name = " " * indent + title.removeprefix(">") if i == 0 else title.removeprefix(">")
        made.add_column(name, justify="right" if title.startswith(">") else "left", overflow="fold")
    for row in rows:
        cells = ["-" if cell is None else str(cell) for cell in row]
        made.add_row(" " * indent + cells[0], *cells[1:])
    return made


def number(value: float | None) -> str:
    """Four decimals, or a dash without a number."""
    known = None if value is None else finite(value)
    return "-" if known is None else f"{known:.4f}"
