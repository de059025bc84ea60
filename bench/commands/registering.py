"""Commands about the registry, and what `bench run` does with it: a registry that fails never loses a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.archive import Entry, archive, is_archive
from bench.base import InputError
from bench.commands.answer import Answer
from bench.record import RunFolder

if TYPE_CHECKING:
    from bench.archive import Registry


def registered(answer: Answer, where: str | None, begin: bool) -> Answer:
    """The answer of a command that made or analysed runs, after they were registered, or a warning in it.

    Without `begin` a run is registered only where its folder is in an archive already, or a registry was named.
    """
    runs = [Path(run) for run in _runs(answer.content)]
    runs = [run for run in runs if begin or where or is_archive(_root(run))]
    if not runs:
        return answer
    try:
        register(runs, where)
    except Exception as error:
        text = f"not registered: {error}; the run is safe on disk, later: bench registry rebuild --out {_root(runs[0])}"
        return replace(
            answer,
            content={**answer.content, "registry": {"registered": False, "warning": text}},
            text=f"{answer.text}\nwarning: {text}",
        )
    return replace(answer, content={**answer.content, "registry": {"registered": True}})


def register(runs: Sequence[Path], where: str | None = None) -> None:
    """Register run folders; each is <archive>/<unit>/<run>. Errors are those of the registry."""
    from bench.archive import register as write

    for root in dict.fromkeys(_root(run) for run in runs):
        ledger = archive(root)
        with open_in(root, where) as registry:
            for run in runs:
                if _root(run) == root:
                    write(registry, RunFolder(run), ledger)


def open_in(root: Path, where: str | None) -> Registry:
    """The registry at `where`, by default the file in the archive."""
    from bench.archive import FILE, open_registry

    return open_registry(where or root / FILE)


def _root(run: Path) -> Path:
    return run.resolve().parent.parent


def _runs(content: dict[str, Any]) -> list[str]:
    found = [content, *content.get("units", ()), content.get("verification")]
    return [str(entry["run"]) for entry in found if isinstance(entry, dict) and entry.get("run")]


def registry_list(root: Path, where: str | None, unit: str | None, most: int) -> Answer:
    """`bench registry list`: runs, the newest first."""
    from bench.archive import runs

    with existing(root, where) as registry:
        found, url = runs(registry, unit, most), registry.url
    columns = (("unit", "unit"), ("created", "created"), ("profile", "profile"), ("state", "state"),
               ("verdict", "verdict"), ("judged", "limits"), ("path", "run"))  # fmt: skip
    text = table([{title: row[key] for key, title in columns} for row in found]) if found else "no runs"
    return Answer({"registry": url, "runs": found}, text)


def registry_show(root: Path, where: str | None, name: str) -> Answer:
    """`bench registry show`: all about a unit or a run."""
    from bench.archive import plain
    from bench.archive import show as ask

    with existing(root, where) as registry:
        content = ask(registry, name)
    lines: list[str] = []
    for title, found in content.items():
        rows = found if isinstance(found, list) else [found]
        lines += [f"{title}:", *(f"  {line}" for row in rows for line in _described(plain(row))), ""]
    return Answer(content, "\n".join(lines).rstrip())


def _described(row: dict[str, Any]) -> list[str]:
    if set(row) == {"run", "name", "unit", "value"}:
        return [f"{row['name']:<32} {row['value']:.6g} {row['unit'] or ''}".rstrip()]
    return [f"{key:<22} {value}" for key, value in row.items() if value is not None]


def registry_rebuild(root: Path, where: str | None, only_compare: bool) -> Answer:
    """`bench registry rebuild`: the rows of the run folders; exit code 1 where a comparison finds differences."""
    from bench.archive import rebuild as build

    if not root.is_dir():
        raise InputError("no such folder; name the folder of the run folders with --out", root)
    with open_in(root, where) as registry:
        done = build(registry, archive(root), only_compare=only_compare)
        url = registry.url
    counted = ", ".join(f"{count} {name}" for name, count in done.counts.items() if name != "archives")
    verb = "differs from the run folders" if only_compare else "corrected"
    lines = [
        *(f"{verb}: {line}" for line in done.differences),
        *(f"cannot be read: {line}" for line in done.unreadable),
    ]
    same = (
        "equal to the run folders"
        if not (only_compare and done.differences)
        else f"{len(done.differences)} rows differ"
    )
    lines += [f"{url}: {counted}", f"{same}; digest of all rows {done.digest}"]
    content = {"registry": url, "archive": done.archive, "rows": done.counts, "differences": list(done.differences),
               "unreadable": list(done.unreadable), "digest": done.digest}  # fmt: skip
    failed = bool(done.unreadable) or (only_compare and bool(done.differences))
    return Answer(content, "\n".join(lines), 1 if failed else 0)


def registry_tell(root: Path, where: str | None, entry: Entry, said: str) -> Answer:
    """Write what a person said into ledger and registry."""
    from bench.archive import tell as write

    ledger = archive(root)
    with open_in(root, where) as registry:
        write(registry, ledger, entry)
    return Answer({"ledger": str(ledger.path), **entry}, said)


def add_equipment(root: Path, where: str | None, name: str, serial: str, kind: str, **days: datetime | None) -> Answer:
    """`bench registry equipment add`: a piece of equipment and its calibration; InputError where due before it."""
    calibrated, due = (None if (day := days.get(key)) is None else day.date() for key in ("calibrated", "due"))
    if calibrated and due and due < calibrated:
        raise InputError(f"{name} {serial}: due {due} is before calibrated {calibrated}")
    entry = {
        "kind": "equipment",
        "name": name,
        "serial": serial,
        "type": kind,
        "calibrated_on": None if calibrated is None else calibrated.isoformat(),
        "due_on": None if due is None else due.isoformat(),
    }
    return registry_tell(root, where, entry, f"{name} {serial} ({kind}), due {due or 'never'}")


def registry_equipment(root: Path, where: str | None, on: date) -> Answer:
    """`bench registry equipment list`: exit code 1 where a calibration is overdue."""
    from bench.archive import equipment as ask
    from bench.archive import plain

    with existing(root, where) as registry:
        found = [plain(row) for row in ask(registry)]
    for row in found:
        row["state"] = (
            "no due date" if row["due_on"] is None else "overdue" if row["due_on"] < on.isoformat() else "valid"
        )
    columns = ("name", "serial", "kind", "calibrated_on", "due_on", "state")
    text = table([{key: row[key] for key in columns} for row in found]) if found else "no equipment"
    return Answer(
        {"on": on.isoformat(), "equipment": found}, text, int(any(row["state"] == "overdue" for row in found))
    )


def existing(root: Path, where: str | None) -> Registry:
    """The registry that is there; InputError, with the way to one, where the archive has none."""
    from bench.archive import FILE

    if where is None and not (root / FILE).is_file():
        raise InputError("no registry here yet; make it with `bench registry rebuild --out FOLDER`", root / FILE)
    return open_in(root, where)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of equal keys as a table for a terminal."""
    cells = [list(rows[0]), *(["-" if value is None else str(value) for value in row.values()] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(cells[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in cells
    )
