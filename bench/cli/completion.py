"""What a shell may complete: models, effects and units; files and commands it completes by itself (click)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from bench import analysis, base

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def _completing(known: Callable[[click.Context], Iterable[str]], files: bool = False) -> Complete:
    """Names that begin as what was typed; then files, where `files`."""

    def complete(context: click.Context, _: click.Parameter, typed: str) -> list[CompletionItem]:
        with contextlib.suppress(Exception):  # a shell that completes shows no errors
            found = [CompletionItem(name) for name in sorted({*known(context)}) if name.startswith(typed)]
            if found:
                return found
        return [CompletionItem(typed, type="file")] if files else []

    return complete


def _models(_: click.Context) -> Iterable[str]:
    folders = Path("profiles/models"), base.library() / "models"
    return [file.stem for folder in folders if folder.is_dir() for file in folder.glob("*.yaml")]


def _effects(_: click.Context) -> Iterable[str]:
    return analysis.effect_names()


def _units(context: click.Context) -> Iterable[str]:
    """Those of the station, and those that have runs."""
    given: dict[str, Any] = context.params
    out, station = given.get("out") or Path("reports"), given.get("station")
    if out.is_dir():
        yield from (folder.name for folder in out.iterdir() if folder.is_dir() and not folder.name.startswith("."))
    content = base.read_yaml(station or base.library() / "stations" / "simulated.yaml").content
    yield from (str(unit["serial"]) for unit in content["units"])


models = _completing(_models, files=True)
effects = _completing(_effects)
units = _completing(_units)
