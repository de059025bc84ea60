"""The chain of a folder: which files the bench wrote into it, with which contents, made from what, under which key.

`chain.seal` lists the manifest and everything that was made later; the manifest lists what was recorded. All hashes of
run folders are read and made here. A look compares what it uses with these lists; where a verdict leaves the bench
(certificate, flash, verify, export, verify-archive) `prove` reads every file again and checks signature and keys.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from bench.base import InputError, __version__, hold
from bench.record.files import sha256, write_atomically
from bench.record.lines import extended, sealed, seals, whole_lines
from bench.record.records.centre import ElsewhereRecord
from bench.record.records.chain import ChainRecord, Link
from bench.record.records.manifest import Manifest
from bench.record.signing import keys_folder, public_key, sign, signed, trusted

CHAIN = ChainRecord.FILE
STAMPED = ("*.parquet",)
_OLDER = "no chain.seal: an older bench left this folder, and nothing proves its files"
SEAL = "`bench report` makes its results anew and seals it"

_CURRENT = frozenset({"limits.json"})
"""Results that must be made anew with those that they are made from; a certificate is what it was on its day."""

Stamp = tuple[int, int, int]


def put(folder: Path, files: Mapping[str, bytes], made_from: Iterable[str] = (), *, unit: str = "", run: str = "",
        others: Mapping[str, str] | None = None) -> None:  # fmt: skip
    """Write files into a folder and its chain, each whole; InputError where the chain was altered, OSError.

    `made_from` are files of the same folder, `others` hashes of further ones. Until all are written the chain allows
    both the old and the new contents, so that a kill leaves no folder that must be refused.
    """
    with _locked(folder):
        _put(folder, *_whole(folder, files), made_from, others or {}, (unit, run))


def extend(folder: Path, name: str, change: Callable[[bytes], bytes]) -> None:
    """Change one file of a folder while nobody else does; `change` gets its content, empty where it is new.

    InputError where it is not what the chain lists, OSError.
    """
    with _locked(folder):
        path = folder / name
        old = path.read_bytes() if path.exists() else None
        check(folder, name, old)
        new = change(old or b"")
        if new != old:
            _put(folder, *_whole(folder, {name: new}))


@dataclass(frozen=True)
class Lines:
    """The lines of a file before others are added: their number and seal, and what gives them."""

    count: int
    seal: str
    read: Callable[[], bytes]


def append(folder: Path, name: str, more: Callable[[Lines], bytes]) -> None:
    """Add lines to one file of a folder while nobody else does; `more` gives them.

    A file that is as the bench left it is neither read nor hashed. Any other one is, and lines that a power cut
    interrupted are put right. InputError where the file is not what the chain lists, OSError.
    """
    with _locked(folder):
        path, known = folder / name, _extended(folder)
        link, stamp = known.files.get(name), _stamp(path)
        seal = None if link is None or len(link.sha256) > 1 else link.sha256[0]
        if link is not None and link.head and seal and known.stamps.get(name) == stamp:
            head, size, old = link.head, stamp[0], Lines(link.lines, seal, path.read_bytes)
        else:
            data = _mended(folder, name)
            link, size = _extended(folder).files.get(name), len(data)
            head = size if link is None or link.head is None else link.head
            old = Lines(data.count(b"\n"), sealed(data, head), lambda: data)
        if not (new := more(old)):
            return

        def write() -> None:
            if not size:
                write_atomically(path, new)
                return
            with path.open("r+b") as file:
                file.truncate(size)
                file.seek(size)
                file.write(new)
                file.flush()
                os.fsync(file.fileno())

        seal = extended(old.seal, new) if head else hashlib.sha256(new).hexdigest()
        grown = Link(sha256=(seal,), head=head or len(new), lines=old.count + new.count(b"\n"))
        _put(folder, {name: grown}, write)


def read_lines(folder: Path, name: str) -> bytes:
    """The whole lines of a file to which others may add meanwhile; InputError where they are not what the chain lists.

    Lines that a power cut interrupted are put right.
    """
    data = whole_lines((folder / name).read_bytes())
    try:
        _check_lines(folder, name, data)
    except InputError:
        with _locked(folder):
            data = _mended(folder, name)
    return data


def _check_lines(folder: Path, name: str, data: bytes) -> None:
    known = chain_of(folder)
    link = None if known is None else known.files.get(name)
    _check(folder, name, sealed(data, None if link is None else link.head))


def _mended(folder: Path, name: str) -> bytes:
    """The whole lines of a file; those that were being added when the power was cut are kept and sealed."""
    path = folder / name
    if not path.exists():
        _check(folder, name, None)
        return b""
    data = whole_lines(path.read_bytes())
    try:
        _check_lines(folder, name, data)
    except InputError:
        known = chain_of(folder)
        link = None if known is None else known.files[name]
        before = None if link is None or len(link.sha256) == 1 else _sealed_before(data, link)
        if known is None or link is None or before is None:
            raise
        head = before if link.head is None else link.head
        data = whole_lines(data[:before] + data[before:].partition(b"\0")[0])  # a block that was never written is zero
        with path.open("r+b") as file:
            file.truncate(len(data))
        mended = link.model_copy(update={"sha256": (sealed(data, head),), "head": head, "lines": data.count(b"\n")})
        _write(folder, known.model_copy(update={"files": {**known.files, name: mended}}))
        kept = data.count(b"\n", before)
        text = f"lines were being added when the bench was stopped; the {kept} that are whole are kept and sealed now"
        print(f"bench: {path}: {text}", file=sys.stderr)
    return data


def _sealed_before(data: bytes, link: Link) -> int | None:
    """Where the lines end that were sealed before others were added; None where they are not those."""
    return max((at for at, _, seal in seals(data, link.head) if seal in link.sha256), default=None)


def _whole(folder: Path, files: Mapping[str, bytes]) -> tuple[dict[str, Link], Callable[[], None]]:
    """Links of new contents, and what writes them, each file whole."""

    def write() -> None:
        for name, data in files.items():
            write_atomically(folder / name, data)

    return {name: Link(sha256=(hashlib.sha256(data).hexdigest(),)) for name, data in files.items()}, write


def _put(folder: Path, news: Mapping[str, Link], write: Callable[[], None], made_from: Iterable[str] = (),
         others: Mapping[str, str] = MappingProxyType({}), of: tuple[str, str] = ("", "")) -> None:  # fmt: skip
    """Write files, of which the hashes are known, and their chain."""
    before = _extended(folder)
    olds = {name: link.sha256[-1] for name, link in before.files.items()}
    olds |= {name: link.sha256[-1] for name, link in news.items()}
    sources = {name: digest for name in made_from if (digest := olds.get(name)) is not None}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    made = {"made_from": {**sources, **others}, "utc": now, "bench": __version__}
    after = {name: link.model_copy(update=made) for name, link in news.items()}
    between = {
        name: link.model_copy(update={"sha256": (*_digests(before, name), *link.sha256)})
        for name, link in after.items()
    }
    known = before.model_copy(update={"unit": of[0] or before.unit, "run": of[1] or before.run})
    _write(folder, known.model_copy(update={"files": {**known.files, **between}}))
    write()
    stamps = _stamps(folder) if Manifest.FILE in news else known.stamps
    stamps = {**stamps, **{name: _stamp(folder / name) for name, link in news.items() if link.head}}
    _write(folder, known.model_copy(update={"files": {**known.files, **after}, "stamps": stamps}), sync=False)


def drop(folder: Path, name: str) -> None:
    """Remove a file from a folder and its chain."""
    with _locked(folder):
        known = _extended(folder)
        files = {other: link for other, link in known.files.items() if other != name}
        absent = Link(sha256=(*_digests(known, name), None))
        _write(folder, known.model_copy(update={"files": {**files, name: absent}}))
        (folder / name).unlink(missing_ok=True)
        _write(folder, known.model_copy(update={"files": files}), sync=False)


def chain_of(folder: Path | str) -> ChainRecord | None:
    """The chain of a folder as it was signed; None in a folder of an older bench. InputError where it was altered."""
    try:
        found = os.stat(f"{folder}/{CHAIN}")  # noqa: PTH116 - thousands of folders are looked at
    except OSError:
        return None
    return _parsed(str(folder), found.st_mtime_ns, found.st_size, found.st_ino)


def listed(folder: Path) -> dict[str, str]:
    """The SHA-256 that each file must have, by path inside the folder."""
    known, manifest = chain_of(folder), Manifest.find(folder)
    made = {} if known is None else known.files
    recorded = {} if manifest is None else dict(manifest.files)
    return recorded | {name: digest for name, link in made.items() if (digest := link.sha256[-1]) is not None}


def check(folder: Path | str, name: str, data: bytes | None, advice: str = "") -> None:
    """Refuse a record whose content (None: absent) is not the one in the chain; InputError with both hashes."""
    if chain_of(folder) is not None:
        _check(folder, name, None if data is None else hashlib.sha256(data).hexdigest(), advice)


def _check(folder: Path | str, name: str, digest: str | None, advice: str = "") -> None:
    known = chain_of(folder)
    if known is None:
        return
    link = known.files.get(name)
    if link is None:
        if digest is not None:
            raise InputError(
                f"is not listed in {CHAIN}: this bench did not write it here; move it away", f"{folder}/{name}"
            )
        return
    if digest not in link.sha256:
        raise InputError(_differs(digest, link.sha256[-1], CHAIN, advice), f"{folder}/{name}")
    made = link.made_from.get(Manifest.FILE)
    root = known.files.get(Manifest.FILE)
    if made is not None and root is not None and made not in root.sha256:
        raise InputError(
            f"was made from a manifest.json with the SHA-256 {made}, the folder's has {root.sha256[-1]}; make it again "
            "with `bench report`",
            f"{folder}/{name}",
        )


def use(folder: Path, *names: str) -> None:
    """Refuse recorded files that are not those that were recorded; InputError with both hashes.

    One that no list names is refused, too, except in folders of older benches.
    """
    known, recorded = chain_of(folder), listed(folder)
    stamps = {} if known is None else known.stamps
    for name in names:
        wanted, path = recorded.get(name), folder / name
        if wanted is None:
            if known is not None and recorded.keys() - known.files.keys() and path.exists():
                raise InputError("is in no list of this folder: the bench did not put it here; move it away", path)
            continue
        if name in stamps and stamps[name] == _stamp(path):
            continue
        digest = _hashed(str(path), *_stamp(path)) if path.is_file() else None
        if digest is None and (away := ElsewhereRecord.find(folder)) and name in away.files:
            raise InputError(f"is not here but at {away.centre}; bring it with `bench sync restore {folder}`", path)
        if digest != wanted:
            raise InputError(_differs(digest, wanted, Manifest.FILE), path)


def prove(folder: Path) -> None:
    """Refuse a folder of which one file is not proven; every file is read anew. InputError with the first fault."""
    for fault in faults(folder, whole=True):
        raise InputError(fault)


def faults(folder: Path, *, whole: bool = False) -> Iterator[str]:
    """Every fault of a folder, one line each, the gravest first; every file is read anew.

    That files are at a centre is a fault only where the folder must be `whole`.
    """
    try:
        known = chain_of(folder)
        manifest = Manifest.find(folder)
        away = ElsewhereRecord.find(folder)
    except InputError as error:
        yield str(error)
        return
    if known is None:
        yield f"{folder}: {_OLDER}; {SEAL}"
        return
    yield from _unsigned(folder, known)
    elsewhere = {} if away is None else {name: file.sha256 for name, file in away.files.items()}
    for name, fault in _unlike(folder, known, {} if manifest is None else manifest.files):
        if name not in elsewhere or (folder / name).exists():
            yield fault
        elif whole or elsewhere[name] not in _digests_of(known, manifest, name):
            yield f"{folder / name}: is not here; bring it back with `bench sync restore {folder}`"
    theirs = (known.unit, known.run) if manifest is None else (manifest.unit, manifest.run)
    if theirs != (known.unit, known.run):
        yield f"{folder}/{CHAIN}: is of {known.unit} {known.run}, the manifest is of {' '.join(theirs)}"
    yield from _stale(folder, known)


def unproven(folder: Path) -> str:
    """One line about a folder of an older bench; empty for the others."""
    older = chain_of(folder) is None and (folder / Manifest.FILE).is_file()
    return f"{folder}: {_OLDER}; certificate and flash need one: {SEAL}" if older else ""


def _unsigned(folder: Path, known: ChainRecord) -> Iterator[str]:
    where, friends = f"{folder}/{CHAIN}", trusted()
    if not known.keys or not known.signature:
        yield f"{where}: is not signed; give this user a place for its key ({keys_folder()}), then `bench report`"
    else:
        for key in (key for key in known.keys if key not in friends):
            todo = f"to trust it, copy its bench.pub into {keys_folder()}"
            yield f"{where}: is signed by the key {key[:16]}… of another bench; {todo}"


def _digests_of(known: ChainRecord, manifest: Manifest | None, name: str) -> tuple[str | None, ...]:
    link = known.files.get(name)
    return link.sha256 if link else (manifest.files.get(name) if manifest else None,)


def _unlike(folder: Path, known: ChainRecord, recorded: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Names and faults of files that are not as they were written."""
    wanted = {name: (digest,) for name, digest in recorded.items()}
    lists = dict.fromkeys(wanted, Manifest.FILE) | dict.fromkeys(known.files, CHAIN)
    for name, digests in {**wanted, **{name: link.sha256 for name, link in known.files.items()}}.items():
        path = folder / name
        try:
            digest = _digest(path, known.files.get(name)) if path.is_file() else None
        except OSError as error:
            yield name, f"{path}: cannot be read: {error.strerror}"
            continue
        if digest not in digests:
            yield name, f"{path}: {_differs(digest, digests[-1], lists[name])}"


def _digest(path: Path, link: Link | None) -> str:
    return sha256(path) if link is None or link.head is None else sealed(path.read_bytes(), link.head)


def _stale(folder: Path, known: ChainRecord) -> Iterator[str]:
    for name in _CURRENT & set(known.files):
        for source, digest in known.files[name].made_from.items():
            now = known.files.get(source)
            if now is not None and digest not in now.sha256:
                was = f"was made from a {source} with the SHA-256 {digest}, it has {now.sha256[-1]}"
                yield f"{folder}/{name}: {was}; make it again with `bench report --limits`"


def _differs(digest: str | None, wanted: str | None, where: str, advice: str = "") -> str:
    todo = advice or ChainRecord.ADVICE
    if digest is None:
        return f"is missing; {where} lists it with the SHA-256 {wanted}; {todo}"
    return f"is not the file that was recorded: its SHA-256 is {digest}, {where} has {wanted}; {todo}"


def _digests(known: ChainRecord, name: str) -> tuple[str | None, ...]:
    link = known.files.get(name)
    return (None,) if link is None else link.sha256


def _extended(folder: Path) -> ChainRecord:
    """The chain to be extended; a new one where there is none. InputError where it was altered."""
    known = chain_of(folder)
    if known is not None:
        return known
    manifest = Manifest.find(folder)
    if manifest is None:
        return ChainRecord()
    now = datetime.now(UTC).isoformat(timespec="seconds")
    files = {Manifest.FILE: Link(sha256=(sha256(folder / Manifest.FILE),), utc=now, bench=__version__)}
    return ChainRecord(unit=manifest.unit, run=manifest.run, adopted=now, files=files)


def _write(folder: Path, known: ChainRecord, *, sync: bool = True) -> None:
    public = public_key()
    keys = (
        known.keys if known.keys[-1:] == (public,) or not public else (*(k for k in known.keys if k != public), public)
    )
    unsigned = known.model_copy(update={"keys": keys, "signature": ""})
    made = unsigned.model_copy(update={"signature": sign(unsigned.signable())})
    write_atomically(folder / CHAIN, made.text().encode(), sync=sync)


def _stamps(folder: Path) -> dict[str, Stamp]:
    return {path.name: _stamp(path) for pattern in STAMPED for path in sorted(folder.glob(pattern))}


def _stamp(path: Path) -> Stamp:
    try:
        found = path.stat()
    except OSError:
        return (0, 0, 0)
    return found.st_size, found.st_mtime_ns, found.st_ino


@lru_cache(maxsize=1024)
def _hashed(path: str, size: int, mtime_ns: int, inode: int) -> str:
    """The hash of a file as it was at this size, time and inode."""
    try:
        return sha256(Path(path))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path) from None


@lru_cache(maxsize=1024)
def _parsed(folder: str, mtime_ns: int, size: int, inode: int) -> ChainRecord | None:
    known = ChainRecord.find(folder)
    if known is not None and known.keys and not signed(known.signable(), known.keys[-1], known.signature):
        key = f"{known.keys[-1][:16]}…"
        raise InputError(
            f"was altered: its signature is not that of the key {key}; {known.ADVICE}", f"{folder}/{CHAIN}"
        )
    return known


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One writer at a time; a file system without locks is one with a single writer."""
    with ExitStack() as stack:
        if os.name != "nt":  # which opens no folders
            handle = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, handle)
            hold(handle, wait=True)
        yield
