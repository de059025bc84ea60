"""Where a folder came from that was fetched from a centre: a hidden file in it, which is of this place only."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.record import CHAIN, sha256, write_atomically

FILE = ".origin.json"


@dataclass(frozen=True)
class Origin:
    """The entry that a folder was made from, and its chain.seal at that time."""

    centre: str
    entry: str
    chain: str

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


def chain_hash(folder: Path) -> str:
    """SHA-256 of chain.seal; empty where there is none."""
    with suppress(OSError):
        return sha256(folder / CHAIN)
    return ""
