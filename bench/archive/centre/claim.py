"""An archive sends from one folder of one computer: a cloned disk must not send under the id of another bench.

Two things tell a clone: the folder and the computer (name, id of the system, network cards) that claimed the archive,
and the ledger. What the centre has of the ledger must be the beginning of the one that is here; two archives that went
on separately differ there, whatever their computers are called.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path

from bench.archive.centre.store import Centre, DamagedError
from bench.archive.registry.ledger import FILE, Ledger
from bench.base import InputError
from bench.record import CHAIN

LEDGERS = "ledgers"
_COPY = "if this folder is a copy, give it an id of its own with `bench registry rebuild --copied`"


def claim(centre: Centre, ledger: Ledger, *, moved: bool = False) -> None:
    """Claim the archive for this place, and leave its ledger at the centre; InputError where that is another's.

    `moved`: it was moved here from where it was claimed.
    """
    name, mine = f"archives/{ledger.id}.json", {"archive": ledger.id, "place": ledger.place, "computer": computer()}
    if not moved and centre.has(name):
        try:
            known = json.loads(centre.read(name))
            theirs = (known["place"], known["computer"])
        except (ValueError, KeyError, TypeError):
            raise DamagedError(f"{centre.url}/{name}: is damaged; claim the archive anew with --moved") from None
        if theirs != (mine["place"], mine["computer"]):
            raise InputError(
                f"archive {ledger.id} sends from {theirs[0]} (computer {theirs[1]}), this is {mine['place']} (computer "
                f"{mine['computer']}); {_COPY}; if it was moved, send with --moved",
                centre.url,
            )
    else:
        centre.write(name, json.dumps(mine).encode())
    _leave(centre, ledger)


def _leave(centre: Centre, ledger: Ledger) -> None:
    data = ledger.path.read_bytes()
    data = data[: data.rfind(b"\n") + 1]
    mine = f"{LEDGERS}/{ledger.id}/{len(data):012d}-{hashlib.sha256(data).hexdigest()}.jsonl"
    known = centre.names(f"{LEDGERS}/{ledger.id}")
    _refuse_other(centre, ledger, data, known)
    if mine in known:
        return
    centre.write(mine, data)
    with suppress(OSError):
        centre.write(mine.removesuffix(".jsonl") + ".seal", (ledger.root / CHAIN).read_bytes())
    try:
        _refuse_other(centre, ledger, data, centre.names(f"{LEDGERS}/{ledger.id}"))  # a clone may send at this moment
    except InputError:
        centre.remove(mine)
        raise


def _refuse_other(centre: Centre, ledger: Ledger, data: bytes, known: list[str]) -> None:
    """InputError where a ledger at the centre is not the beginning of this one, nor goes on from it."""
    for name in known:
        length, _, digest = name.rpartition("/")[2].removesuffix(".jsonl").partition("-")
        if not name.endswith(".jsonl") or not length.isdigit():
            continue
        if len(data) < int(length) or hashlib.sha256(data[: int(length)]).hexdigest() != digest:
            raise InputError(
                f"{FILE} goes on otherwise than the one that archive {ledger.id} left at {centre.url}; {_COPY}; if it "
                "was restored from an older backup, restore the newest one",
                ledger.path,
            )


def last_ledger(centre: Centre, archive: str) -> bytes:
    """The ledger of an archive as it was sent last; empty where there is none. CentreError where it is damaged."""
    names = [name for name in centre.names(f"{LEDGERS}/{archive}") if name.endswith(".jsonl")]
    if not names:
        return b""
    data = centre.read(names[-1])
    if hashlib.sha256(data).hexdigest() != names[-1].rpartition("-")[2].removesuffix(".jsonl"):
        raise DamagedError(f"{centre.url}/{names[-1]}: is damaged; remove it, and let the bench send again")
    return data


def computer(machine_id: Path = Path("/etc/machine-id"), cards: Path = Path("/sys/class/net")) -> str:
    """What tells this computer from others, a clone of its disk included: its system's id and its network cards.

    Cards on USB come and go and do not count.
    """
    parts = []
    with suppress(OSError):
        parts.append(machine_id.read_text(encoding="utf-8").strip())
    with suppress(OSError):
        for card in sorted(cards.iterdir()):
            with suppress(OSError):
                device = (card / "device").resolve(strict=True)
                if "usb" not in device.as_posix():
                    parts.append((card / "address").read_text().strip())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]
