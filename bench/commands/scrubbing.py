"""`bench verify-archive`: every file of an archive read and compared with what the bench wrote there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bench import archive
from bench.base import InputError
from bench.commands.results.stock import Scrubbed
from bench.record import CHAIN, MANIFEST, ChainRecord, JobRecord, faults, sha256


def verify_archive(root: Path) -> Scrubbed:
    """Chains, signatures, hashes and ledger of everything below `root`; InputError where it is no folder.

    Proves every run folder, job folder and flash folder, that none which the ledger saw is missing or of another
    manifest, and that no line of the ledger was changed.
    """
    if not root.is_dir():
        raise InputError("no such folder; name the folder of the run folders with --out", root)
    marks = (MANIFEST, CHAIN, JobRecord.FILE)
    folders = sorted({*(p.parent for mark in marks for p in root.glob(f"*/*/{mark}")), *root.glob("*/flash")})
    found = [*_of_ledger(root), *_of_registry(root)]
    found += [fault for folder in folders for fault in faults(folder)]
    keys = {key for folder in (root, *folders) for key in _keys(folder)}
    return Scrubbed(root, len(folders), tuple(sorted(keys)), tuple(found))


def _of_ledger(root: Path) -> Iterator[str]:
    if not archive.is_archive(root):
        yield f"{root}: ledger.jsonl is missing: nothing says which runs there were"
        return
    yield from faults(root)
    try:
        ledger = archive.archive(root)
        yield from ledger.broken()
        for path, (line, digest) in ledger.seen().items():
            manifest = root / path / MANIFEST
            if not manifest.is_file():
                where = f"line {line} of the ledger" if line else "the ledger"
                yield f"{manifest}: is missing; {where} saw it with the SHA-256 {digest}"
            elif (now := sha256(manifest)) != digest:
                yield f"{manifest}: has the SHA-256 {now}, the ledger saw {digest}"
    except (InputError, OSError) as error:
        yield str(error)


def _of_registry(root: Path) -> Iterator[str]:
    """Rows of the registry beside the run folders that are not what these say."""
    from bench.archive import FILE, archive, is_archive, open_registry, rebuild

    if not is_archive(root) or not (root / FILE).is_file():
        return
    try:
        with open_registry(root / FILE) as registry:
            registry.refuse_damaged()
            done = rebuild(registry, archive(root), only_compare=True)
    except InputError as error:
        yield str(error)
        return
    # Where the archive lies is no fault: it may have been moved.
    yield from (f"{root / FILE}: {line}" for line in done.differences if not line.startswith("archives "))


def _keys(folder: Path) -> tuple[str, ...]:
    try:
        known = ChainRecord.find(folder)
    except InputError:
        return ()
    return () if known is None else known.keys
