"""`bench sync`, and runs of a centre for the commands that read runs."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from bench import archive, record
from bench.base import CentreError, InputError, is_run_id
from bench.commands.registering import open_in
from bench.commands.results.centre import (
    CentreListed,
    CentreScrubbed,
    OutboxFound,
    RawReleased,
    RunsFetched,
    RunsRestored,
    RunsSent,
)
from bench.record import ElsewhereRecord

ENVIRONMENT = "BENCH_CENTRE"


def sync_send(url: str, out: Path, *, moved: bool = False) -> RunsSent:
    """`bench sync send`: what the centre lacks of the archive in `out`."""
    ledger = archive.archive(_archive(out))
    centre = archive.reached(url, ledger)
    return RunsSent(centre.url, archive.send(centre, ledger, moved=moved, tell=_tell))


def sync_status(url: str, out: Path) -> OutboxFound:
    """`bench sync status`: what waits; from the last answer where the centre is not reached."""
    ledger, error = archive.archive(_archive(out)), ""
    try:
        found = archive.outbox(archive.reached(url, ledger), ledger, archive.named(url))
    except CentreError as unreached:
        error = str(unreached)
        found = archive.outbox(None, ledger, archive.named(url))
    return OutboxFound(archive.named(url), found, error)


def sync_list(url: str) -> CentreListed:
    """`bench sync list`: the folders of a centre, by their ids."""
    centre = archive.Centre(url)
    return CentreListed(centre.url, sorted(archive.newest(centre).values()))


def sync_fetch(
    url: str, runs: Sequence[str], out: Path, where: str | None = None, *, large: bool = False, replace: bool = False
) -> RunsFetched:
    """`bench sync fetch`: runs of a centre into the archive in `out`, and into its registry."""
    centre = archive.Centre(url)
    ledger = archive.archive(out)
    done = archive.fetch(centre, ledger, runs, large=large, replace=replace, tell=_tell)
    with open_in(out, where) as registry:
        # A fetch that was killed has left folders that no later one brings again; another registry may lack some, too.
        late = ledger.seen().keys() - archive.known_runs(registry, ledger.id)[1]
        folders = sorted({*done.folders, *done.unregistered, *(ledger.root / path for path in late)})
        new = [record.RunFolder(folder) for folder in folders if (folder / record.MANIFEST).is_file()]
        done.damaged += archive.register_all(registry, new, ledger)
    archive.mark_registered(folders)
    return RunsFetched(centre.url, out, done)


def sync_restore(folders: Sequence[Path], url: str | None) -> RunsRestored:
    """`bench sync restore`: files of run folders that are at a centre only."""
    found = []
    for folder in folders:
        away = ElsewhereRecord.find(folder)
        if away is None:
            raise InputError("has all its files here: elsewhere.json is missing", folder)
        found.append((folder, archive.bring_back(archive.Centre(url or away.centre), folder)))
    return RunsRestored(found)


def sync_release(url: str, out: Path, older_days: float) -> RawReleased:
    """`bench sync release`: raw data of older runs stay at the centre only."""
    centre = archive.Centre(url)
    return RawReleased(centre.url, archive.release(centre, archive.archive(_archive(out)), older_days))


def sync_scrub(url: str, *, repair: bool) -> CentreScrubbed:
    """`bench sync scrub`: every file of a centre hashed anew."""
    centre = archive.Centre(url)
    return CentreScrubbed(centre.url, archive.scrub(centre, repair=repair))


def archive_of_centre(url: str) -> Path:
    """The runs of a centre as an archive on this computer, brought up to date."""
    place = _kept(url)
    done = sync_fetch(url, (), place).done
    for line in (*done.damaged, *(f"{folder}: was changed here and stays as it is" for folder in done.kept)):
        print(f"bench: {line}", file=sys.stderr)
    return place


def run_of_centre(text: str) -> Path:
    """The folder of a run, given as CENTRE#ID, or as its id where the environment names the centre."""
    url, _, run = text.rpartition("#")
    url = url or os.environ.get(ENVIRONMENT, "")
    if not url or not is_run_id(run):
        raise InputError(
            f"{text}: no such run folder, nor a run of a centre; give CENTRE#ARCHIVE/UNIT/RUN, or the id alone with "
            f"{ENVIRONMENT} set"
        )
    place = _kept(url)
    done = sync_fetch(url, [run], place).done
    found = archive.located(archive.archive(place), run)
    if found is None:
        raise CentreError("; ".join(done.damaged) or f"{url}: {run} did not arrive")
    return found


def _kept(url: str) -> Path:
    """Where the runs of a centre are kept on this computer."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    place = caches / "gyro-thermal-bench" / hashlib.sha256(archive.named(url).encode()).hexdigest()[:12]
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}; set XDG_CACHE_HOME to another place", place) from None
    return place


def _archive(out: Path) -> Path:
    if not out.is_dir():
        raise InputError("no such folder; name the folder of the run folders with --out", out)
    return out


def _tell(text: str) -> None:
    print(f"bench: {text}", file=sys.stderr)
