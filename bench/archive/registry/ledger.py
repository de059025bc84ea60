"""The ledger of an archive: what people entered and which runs were seen, one JSON line each, beside the run folders.

`ledger.jsonl` begins with the id of the archive, which a later line may replace where it is a copy; others add
instruments, operators, lots and runs, and the last line about one of them counts. `previous` of a line is the seal of
everything before it (`bench.record.lines`), and the archive's chain.seal holds that of the whole file. The registry
can be made again from the ledger and the run folders alone; the order of runs is the one in which they stand here,
whatever the clocks of the stations said.
"""

from __future__ import annotations

import json
import mmap
import os
import secrets
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from bench.base import InputError
from bench.record import CHAIN, Lines, append, chain_of, extended, read_lines, seals

FILE = "ledger.jsonl"

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Ledger:
    """The archive `id` in the folder `root`."""

    root: Path
    id: str

    @property
    def path(self) -> Path:
        """The file."""
        return self.root / FILE

    @property
    def place(self) -> str:
        """host:folder, the location of the archive."""
        return f"{socket.gethostname()}:{self.root.resolve()}"

    def moved_from(self, place: str) -> bool:
        """Whether another place is a folder of this computer in which there is no archive any more."""
        host, _, folder = place.partition(":")
        return host == socket.gethostname() and not is_archive(Path(folder))

    def append(self, *entries: Entry) -> None:
        """Add lines; two programs may do so at the same time. InputError where the file was altered."""
        append(self.root, FILE, lambda old: _more(self.root, old, entries))

    def entries(self) -> list[Entry]:
        """Every line after the first; InputError with the line number where one is broken."""
        return [entry for _, entry in self._numbered(_read(self.root))]

    def saw(self, path: str, manifest_sha256: str) -> dict[str, tuple[int | None, str]]:
        """Note a run, by its path in the archive, where the ledger does not know it with this manifest; its `seen`.

        Only lines about the run are parsed.
        """
        found: dict[str, tuple[int | None, str]] = {}

        def more(old: Lines) -> bytes:
            found.update(_seen(self._about(path)))
            if found.get(path, (None, ""))[1] == manifest_sha256:
                return b""
            found[path] = found.get(path, (old.count + 1, ""))[0], manifest_sha256
            return _more(self.root, old, [_run(path, manifest_sha256)])

        append(self.root, FILE, more)
        return {path: found[path]}

    def saw_all(self, runs: Sequence[tuple[str, str]], origins: Mapping[str, str] | None = None) -> None:
        """Note runs, each a path and the hash of its manifest, that the ledger does not know with this manifest.

        `origins`: of runs from other archives, their ids there, by path.
        """
        known, origins = self.seen(), origins or {}
        news = [_run(path, digest) for path, digest in runs if known.get(path, (0, ""))[1] != digest]
        if news:
            self.append(*({**new, "origin": origins[new["run"]]} if new["run"] in origins else new for new in news))

    def seen(self) -> dict[str, tuple[int | None, str]]:
        """Runs by path: the number of the line in which each was first seen, and the last hash of its manifest.

        Runs of other archives have no number: this ledger saw them when they were fetched, not when they were made.
        """
        return _seen(self._numbered(_read(self.root)))

    def renewed(self) -> Ledger:
        """The same folder as an archive of its own, with a new id: it was a copy of another one."""
        self.append({"kind": "archive", "id": secrets.token_hex(6), "copy_of": self.id, "place": self.place})
        return archive(self.root)

    def broken(self) -> Iterator[str]:
        """Lines that do not continue what stands before them; those of older benches continue nothing."""
        chained, known = False, chain_of(self.root)
        link = None if known is None else known.files.get(FILE)
        whole = seals(self.path.read_bytes(), None if link is None else link.head)
        for number, (_, line, before) in enumerate(whole, 1):
            if not line:
                break
            previous = _entry(line, self.path, number).get("previous")
            if previous is None and chained:
                yield f"{self.path}:{number}: does not say what stands before it, as every line before it does"
            if previous is not None and previous != before:
                yield f"{self.path}:{number}: continues a file with the seal {previous}, not {before}"
            chained = chained or previous is not None

    def _about(self, path: str) -> Iterator[tuple[int, Entry]]:
        """Lines that name the path of a run, with their numbers."""
        with _mapped(self.path) as data:
            for begin, line in reversed([*_lines(data, json.dumps(path))]):
                number = data[:begin].count(b"\n") + 1
                yield number, _entry(line, self.path, number)

    def _numbered(self, data: bytes) -> Iterator[tuple[int, Entry]]:
        """Lines after the first, with their numbers."""
        for number, line in enumerate(data.split(b"\n"), 1):
            if number > 1 and line.strip():
                yield number, _entry(line, self.path, number)


@contextmanager
def _mapped(path: Path) -> Iterator[bytes | mmap.mmap]:
    """The file without reading it; an empty one cannot be mapped."""
    with path.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            yield b""
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


def _lines(data: bytes | mmap.mmap, text: str) -> Iterator[tuple[int, bytes]]:
    """Whole lines that hold a text, and where they begin; the last one first."""
    at = len(data)
    while (at := data.rfind(text.encode(), 0, at)) >= 0:
        begin, end = data.rfind(b"\n", 0, at) + 1, data.find(b"\n", at)
        if end >= 0:
            yield begin, data[begin:end]
        at = begin


def _seen(numbered: Iterable[tuple[int, Entry]]) -> dict[str, tuple[int | None, str]]:
    """`Ledger.seen` of these lines."""
    found: dict[str, tuple[int | None, str]] = {}
    for number, entry in numbered:
        if entry.get("kind") == "run":
            run = str(entry.get("run"))
            first = None if "origin" in entry else number
            found[run] = found.get(run, (first, ""))[0], str(entry.get("manifest"))
    return found


def is_archive(root: Path) -> bool:
    """Whether a folder is an archive."""
    return (root / FILE).is_file()


def archive(root: Path) -> Ledger:
    """The ledger of the folder `root`, which is made if it is missing; InputError where that fails."""
    path = root / FILE
    try:
        if not path.exists():
            root.mkdir(parents=True, exist_ok=True)
            first = json.dumps({"kind": "archive", "id": secrets.token_hex(6)}) + "\n"
            append(root, FILE, lambda old: b"" if old.count else first.encode())
        with _mapped(path) as data:
            head = data[: data.find(b"\n") + 1]
            _, newest = next(_lines(data, '"kind": "archive"'), (0, head))
    except OSError as error:
        raise InputError(f"cannot be read or made: {error.strerror}", path) from None
    begin = _entry(head, path, 1)
    if begin.get("kind") != "archive" or not isinstance(begin.get("id"), str):
        raise InputError("does not begin with the id of an archive; restore the file", path, 1)
    return Ledger(root, str(_entry(newest, path, 1)["id"]))


def _read(root: Path) -> bytes:
    """The lines of the file; InputError where it is not what the chain lists, or there is none."""
    try:
        data = read_lines(root, FILE)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", root / FILE) from None
    _refuse_unproven(root, lambda: data)
    return data


def _refuse_unproven(root: Path, read: Callable[[], bytes]) -> None:
    """InputError where the lines say that a chain proves them, and there is none."""
    if chain_of(root) is None and b'"previous": ' in read():
        raise InputError(f"{CHAIN} beside it, which proves it, is missing; restore it from a backup", root / FILE)


def _more(root: Path, old: Lines, entries: Sequence[Entry]) -> bytes:
    """Lines to add to others."""
    _refuse_unproven(root, old.read)
    lines, seal = list[bytes](), old.seal
    for entry in entries:
        lines.append(json.dumps({**entry, "previous": seal}, allow_nan=False).encode() + b"\n")
        seal = extended(seal, lines[-1])
    return b"".join(lines)


def _run(path: str, digest: str) -> Entry:
    return {"kind": "run", "run": path, "manifest": digest, "utc": datetime.now(UTC).isoformat(timespec="seconds")}


def _entry(line: bytes, path: Path, number: int) -> Entry:
    try:
        entry = from_json(line, cache_strings="keys")
    except ValueError as error:
        raise InputError(f"not a line of JSON ({error}); restore it", path, number) from None
    if not isinstance(entry, dict):
        raise InputError("not a JSON object; restore it", path, number)
    return entry
