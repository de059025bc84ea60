"""Campaigns of many cases: results are appended to a file as they come, and what stands there is not run again."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterable
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar, cast

C = TypeVar("C", bound=Hashable)
O = TypeVar("O")  # noqa: E741


def resumed(
    todo: Iterable[C], run: Callable[[C], O], out: Path, case_of: Callable[[O], C],
    text: Callable[[O], dict[str, Any]], made: Callable[[dict[str, Any]], O],
) -> list[O]:  # fmt: skip
    """Run what is not in `out` yet, and append it; all outcomes that the file then holds.

    `text` and `made` turn an outcome into a JSON object and back.
    """
    known = read(out, made)
    done = {case_of(outcome) for outcome in known}
    if known:
        out.write_text("".join(f"{json.dumps(text(outcome))}\n" for outcome in known), encoding="utf-8")
    with closing(out.open("a", encoding="utf-8")) as file:
        for case in todo:
            if case not in done:
                known.append(run(case))
                file.write(f"{json.dumps(text(known[-1]))}\n")
                file.flush()
    return known


def found(
    todo: Iterable[C], run: Callable[[C], dict[str, Any]], out: Path, kind: Callable[..., C]
) -> list[tuple[C, dict[str, Any]]]:
    """The same for cases that are dataclasses of a `kind` and whose results are JSON objects: cases and results."""
    return resumed(
        todo, lambda case: (case, run(case)), out, lambda result: result[0],
        lambda result: {**asdict(cast(Any, result[0])), "found": result[1]},
        lambda content: _made(content, kind),
    )  # fmt: skip


def known(path: Path, kind: Callable[..., C]) -> list[tuple[C, dict[str, Any]]]:
    """What `found` left in a file: cases and results."""
    return read(path, lambda content: _made(content, kind))


def _made(content: dict[str, Any], kind: Callable[..., C]) -> tuple[C, dict[str, Any]]:
    return kind(**{key: value for key, value in content.items() if key != "found"}), content["found"]


def read(path: Path, made: Callable[[dict[str, Any]], O]) -> list[O]:
    """Outcomes of an earlier, perhaps interrupted, campaign; its last line may be torn."""
    found = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            content = json.loads(line)
        except ValueError:
            continue
        found.append(made(content))
    return found
