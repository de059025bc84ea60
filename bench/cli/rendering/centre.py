"""Results of `bench sync`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.table import Table

from bench.cli.rendering.printing import content, lines, table
from bench.commands import (
    CentreListed,
    CentreScrubbed,
    OutboxFound,
    RawReleased,
    RunsFetched,
    RunsRestored,
    RunsSent,
)

_MB = 1e6


@lines.register(RunsSent)
def _(result: RunsSent) -> Iterator[str]:
    done = result.done
    yield from (f"not sent: {line}" for line in done.damaged)
    yield from (f"not finished: {path}: `bench resume` or `bench report` makes its tables" for path in done.unfinished)
    travelled = f"{done.files} files, {done.bytes / _MB:.1f} MB"
    yield f"{result.centre}: {len(done.sent)} folders sent ({travelled}), {done.there} there"


@content.register(RunsSent)
def _(result: RunsSent) -> dict[str, Any]:
    done = result.done
    return {"centre": result.centre, "sent": done.sent, "there": done.there, "files": done.files, "bytes": done.bytes,
            "damaged": done.damaged, "unfinished": [str(path) for path in done.unfinished]}  # fmt: skip


@lines.register(OutboxFound)
def _(result: OutboxFound) -> Iterator[str]:
    found = result.found
    yield from found.waiting
    yield from (f"cannot be sent: {line}" for line in found.damaged)
    yield from (f"not finished: {path}" for path in found.unfinished)
    if result.error:
        yield result.error
        yield f"by its answer of {found.asked}:" if found.asked else "it was never reached:"
    yield f"{result.centre}: {len(found.waiting)} folders wait, {found.there} are there"


@content.register(OutboxFound)
def _(result: OutboxFound) -> dict[str, Any]:
    found = result.found
    return {"centre": result.centre, "waiting": found.waiting, "there": found.there, "damaged": found.damaged,
            "unfinished": [str(path) for path in found.unfinished], "reached": not result.error,
            "asked": found.asked or None, "cause": result.error or None}  # fmt: skip


@lines.register(CentreListed)
def _(result: CentreListed) -> Iterator[str | Table]:
    yield table(("id", ">sent"), [[name.run, name.number] for name in result.names]) if result.names else "nothing"


@content.register(CentreListed)
def _(result: CentreListed) -> dict[str, Any]:
    keys = ("run", "archive", "folder", "number")
    return {"centre": result.centre, "folders": [{key: getattr(name, key) for key in keys} for name in result.names]}


@lines.register(RunsFetched)
def _(result: RunsFetched) -> Iterator[str]:
    done = result.done
    yield from (f"not fetched: {line}" for line in done.damaged)
    yield from (f"{folder}: was changed here and stays as it is; --replace renews it" for folder in done.kept)
    yield f"{result.archive}: {len(done.folders)} folders came of {done.there} at {result.centre}"


@content.register(RunsFetched)
def _(result: RunsFetched) -> dict[str, Any]:
    done = result.done
    return {"centre": result.centre, "archive": str(result.archive), "folders": [str(path) for path in done.folders],
            "there": done.there, "kept": [str(path) for path in done.kept], "damaged": done.damaged}  # fmt: skip


@lines.register(RunsRestored)
def _(result: RunsRestored) -> Iterator[str]:
    yield from (f"{folder}: {count} files came back" for folder, count in result.folders)


@content.register(RunsRestored)
def _(result: RunsRestored) -> dict[str, Any]:
    return {"folders": [{"run": str(folder), "files": count} for folder, count in result.folders]}


@lines.register(RawReleased)
def _(result: RawReleased) -> Iterator[str]:
    done = result.done
    yield from (f"stays: {line}" for line in done.refused)
    freed = f"{done.bytes / _MB:.1f} MB are free"
    yield f"{result.centre}: the raw data of {len(done.folders)} folders are there only; {freed}"


@content.register(RawReleased)
def _(result: RawReleased) -> dict[str, Any]:
    done = result.done
    return {"centre": result.centre, "folders": [str(path) for path in done.folders], "bytes": done.bytes,
            "refused": done.refused}  # fmt: skip


@lines.register(CentreScrubbed)
def _(result: CentreScrubbed) -> Iterator[str]:
    done = result.done
    yield from done.faults
    outcome = f"{len(done.faults)} faults" if done.faults else "every file is what was sent"
    aside = f"; {done.aside} entries were set aside" if done.aside else ""
    yield f"{result.centre}: {done.entries} entries, {done.files} files, {done.bytes / _MB:.1f} MB: {outcome}{aside}"


@content.register(CentreScrubbed)
def _(result: CentreScrubbed) -> dict[str, Any]:
    done = result.done
    return {"centre": result.centre, "entries": done.entries, "files": done.files, "bytes": done.bytes,
            "faults": done.faults, "set_aside": done.aside}  # fmt: skip
