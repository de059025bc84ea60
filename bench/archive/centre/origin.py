"""Where a folder came from that was fetched from a centre: a hidden file in it, which is of this place only."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from bench.record import CHAIN, sha256, write_atomically

FILE = ".origin.json"


@dataclass(frozen=True)
class Origin:
    """The entry that a folder was made from, and its chain.seal at that time."""

    centre: str
    entry: str
    chain: str
    registered: bool = True
    """Whether the registry has what this entry holds; folders of earlier versions do not say it."""

    def changed(self, folder: Path) -> bool:
        """Whether something was written into the folder since."""
        return self.chain != chain_hash(folder)

    def write(self, folder: Path) -> None:
        """Keep it in the folder."""
        write_atomically(folder / FILE, json.dumps(asdict(self)).encode())


def origin_of(folder: Path) -> Origin | None:
    """That of a folder; None where it was recorded here."""
    with suppress(OSError, ValueError, TypeError):
        return Origin(**json.loads((folder / FILE).read_bytes()))
    return None


def mark_registered(folders: Iterable[Path]) -> None:
    """Note in each folder that came from a centre that the registry has its content."""
    for folder in folders:
        origin = origin_of(folder)
        if origin is not None and not origin.registered:
            replace(origin, registered=True).write(folder)


def chain_hash(folder: Path) -> str:
    """SHA-256 of chain.seal; empty where there is none."""
    with suppress(OSError):
        return sha256(folder / CHAIN)
    return ""
