"""Finds live runs on this machine and asks them for something: the client of `bench.acquisition.run.control`.

A live run keeps `live.json` in each of its run folders: process, port on 127.0.0.1 and a secret token, readable by the
user who started it (mode 0600) and gone with the run. A file that outlived its process is recognised by asking: only
the process that wrote it knows its token. One request and one answer a connection, each a line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from bench.base import EquipmentError, InputError, user_name
from bench.record import LIVE
from drivers.journal import Kind, read_blocks

HOST = "127.0.0.1"
LIMIT_BYTES = 1 << 16
"""Longest line; requests are a hundredth of it, answers of many units a tenth."""
ANSWER_S = 5.0
"""A live run answers from a thread of its own, in milliseconds."""
_POLL_S = 0.05


@dataclass(frozen=True)
class LiveFile:
    """What `live.json` says."""

    pid: int
    port: int
    start: str
    """UTC of the start, ISO 8601."""
    journals: list[str]
    """The bench's own journals, whose events say how the run ended."""
    token: str = field(repr=False)

    def write(self, folder: Path) -> None:
        """Put it into a run folder, whole, and for its owner's eyes only."""
        handle, temporary = tempfile.mkstemp(dir=folder, prefix=f".{LIVE}.")  # mode 0600
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(asdict(self), file)
        Path(temporary).replace(folder / LIVE)


@dataclass(frozen=True)
class LiveRun:
    """A run whose process may be reached: one folder a unit."""

    folders: tuple[Path, ...]
    file: LiveFile

    @property
    def path(self) -> Path:
        """The folder that names the run."""
        return self.folders[0]

    def condition(self) -> Literal["live", "silent", "gone"]:
        """Silent: something holds the port and does not answer; it may be the run, stopped or hung."""
        try:
            return "live" if ask_run(self, "status").get("pid") == self.file.pid else "gone"
        except InputError:  # it is another one's port now
            return "gone"
        except EquipmentError as error:
            return "silent" if isinstance(error.__cause__, TimeoutError) else "gone"


def live_at(folder: Path | str) -> LiveRun | None:
    """The run that `live.json` in a run folder speaks of, its process alive or not; None without a readable one."""
    try:
        with open(f"{folder}/{LIVE}", "rb") as stream:  # noqa: PTH123 - a Path costs more than the reading of a short file
            file = LiveFile(**json.loads(stream.read()))
    except (OSError, ValueError, TypeError):
        return None
    kinds = {"pid": int, "port": int, "journals": list}
    sound = all(isinstance(value, kinds.get(name, str)) for name, value in asdict(file).items())
    return LiveRun((Path(folder),), file) if sound and 0 < file.port < 1 << 16 else None


def live_below(root: Path) -> list[LiveRun]:
    """All runs with a `live.json` in `root/<unit>/<run>`, oldest first, whatever their condition."""
    return live_among(file.parent for file in root.glob(f"*/*/{LIVE}"))


def live_among(folders: Iterable[Path]) -> list[LiveRun]:
    """The runs that the `live.json` of these run folders speak of, oldest first; those of one process are one run."""
    runs: dict[str, LiveRun] = {}
    for folder in sorted(folders):
        if found := live_at(folder):
            known = runs.get(found.file.token)
            runs[found.file.token] = replace(found, folders=(*known.folders, folder)) if known else found
    return sorted(runs.values(), key=lambda run: run.file.start)


def only_live_run(folder: Path | None, root: Path) -> LiveRun:
    """The live run in `folder`, or the only one below `root`; InputError that says what there is instead."""
    if folder is not None:
        return _named(folder)
    runs = [run for run in live_below(root) if run.condition() != "gone"]
    if len(runs) == 1:
        return runs[0]
    listed = ", ".join(str(run.path) for run in runs)
    text = (
        f"{len(runs)} live runs here; name one of {listed}" if runs else "no live run here; --out names another place"
    )
    raise InputError(text, root)


def _named(folder: Path) -> LiveRun:
    if not folder.is_dir():
        raise InputError("no such run folder; `bench status` lists the live runs", folder)
    found = live_at(folder)
    if found is None:
        raise InputError("this run is not live; `bench status` lists those that are", folder)
    if found.condition() == "gone":
        text = f"this run is not live: its process {found.file.pid} is gone; `bench resume {folder}` goes on with it"
        raise InputError(text, folder)
    return found


def ask_run(
    run: LiveRun, action: str, patience_s: float = ANSWER_S, *, who: str | None = None, **more: Any
) -> dict[str, Any]:
    """Send one request; the answer. EquipmentError when the process is gone or hangs, InputError when it refuses.

    `who` asks, if not the user of this process; `more` belongs to the action: since and generation of a trace.
    """
    request = {"token": run.file.token, "do": action, "who": who or whoami(), **more}
    try:
        with socket.create_connection((HOST, run.file.port), patience_s) as connection:
            connection.sendall(json.dumps(request).encode() + b"\n")
            answer = json.loads(read_line(connection, patience_s))
    except (OSError, ValueError) as error:
        text = f"{run.path}: process {run.file.pid} does not answer on {HOST}:{run.file.port}: {error}"
        raise EquipmentError(f"{text}; look at the chamber") from error
    if not isinstance(answer, dict) or not answer.get("ok"):
        refused = answer.get("error") if isinstance(answer, dict) else answer
        raise InputError(str(refused), run.path)
    return answer


def wait_until(run: LiveRun, reached: Callable[[dict[str, Any]], bool], limit_s: float) -> dict[str, Any]:
    """The first answer to `status` for which `reached` holds, or the last one within `limit_s` of wall time."""
    until_s = time.monotonic() + limit_s
    while True:
        answer = ask_run(run, "status")
        if reached(answer) or time.monotonic() >= until_s:
            return answer
        time.sleep(_POLL_S)


def _events(journal: Path) -> Iterator[dict[str, Any]]:
    """Events in a journal, as far as it has got."""
    with contextlib.suppress(FileNotFoundError):
        for block in read_blocks(journal):
            if block.kind is Kind.EVENT:
                yield json.loads(block.payload)


def events_of(run: LiveRun) -> list[dict[str, Any]]:
    """All events of a live run so far, from its longest journal: that of a unit that left has ended before."""
    journals = [path for path in map(Path, run.file.journals) if path.is_file()]
    return list(_events(max(journals, key=lambda path: path.stat().st_size))) if journals else []


def ending_of(run: LiveRun, limit_s: float) -> list[dict[str, Any]]:
    """Wait until the run has written its end, and return all its events; none when it does not in `limit_s`.

    A unit that left the run has a journal that ended before.
    """
    until_s = time.monotonic() + limit_s
    while True:
        gone = run.condition() == "gone"  # asked first: what a run writes before it goes is then seen
        for journal in run.file.journals:
            found = list(_events(Path(journal)))
            if any(event["kind"] == "end" and "sound_until_s" not in event for event in found):
                return found
        if gone or time.monotonic() >= until_s:
            return []
        time.sleep(4 * _POLL_S)


def read_line(connection: socket.socket, patience_s: float) -> bytes:
    """One line without its end; ValueError when it is too long or cut off, OSError (TimeoutError) when it is late."""
    until_s = time.monotonic() + patience_s
    line = b""
    while not line.endswith(b"\n"):
        connection.settimeout(max(until_s - time.monotonic(), 1e-3))
        part = connection.recv(4096)
        if not part:
            raise ValueError("the connection was closed in the middle of a line")
        line += part
        if len(line) > LIMIT_BYTES:
            raise ValueError(f"a line longer than {LIMIT_BYTES} bytes")
    return line[:-1]


def whoami() -> str:
    """Who asks: user, host and process."""
    return f"{user_name()}@{socket.gethostname()} (process {os.getpid()})"
