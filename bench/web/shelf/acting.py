"""What commands do with an ended run or a station, in a computing process: export, replay, certificate, doctor.

A page must not show where the store is: folders in the answers are ids of runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from bench.base import BenchError, InputError
from bench.commands import (
    PAPERS,
    CertificateOptions,
    doctor,
    load_station,
    own_paper,
    replay_runs,
)
from bench.commands import certificate as certify
from bench.commands import export as deliver
from bench.deliver import ExportOptions
from bench.web.shelf.steps import verifications_of
from drivers.errors import DriverError

LISTEN_S = 2.0
"""How long doctor listens to each bus, as the command does [s]."""
STATION_FILE = "station.yaml"
T = TypeVar("T")


def exported(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench export` into the run's own `export` folder: names of the files."""
    folder = Path(wanted["path"])
    made = _told(wanted, lambda: deliver(folder, wanted["format"], ExportOptions(), None))
    return {"format": wanted["format"], "files": [path.name for path in made.files]}


def replayed(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench replay` of one run: the entry of `bench replay --json`."""
    (made,) = _told(wanted, lambda: replay_runs([Path(wanted["path"])], (), ())).replays
    return {**made.to_json(), "run": wanted["run"], "failed": _hidden(wanted, made.failed)}


def certified(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench certificate`: its number, its verdict and its file; runs that verify this one are its evidence.

    Papers that the run folder lacks are those that were filled in for its station since.
    """
    folder, draft = Path(wanted["path"]), bool(wanted["draft"])
    laboratory, equipment = (_paper(kind, wanted) for kind in PAPERS)
    evidence = tuple(reversed(verifications_of(folder)))  # the newest states the figures
    options = CertificateOptions(evidence, laboratory=laboratory, equipment=equipment, draft=draft)
    made = _told(wanted, lambda: certify(folder, options, None))
    number, verdict = (made.facts.get(key) for key in ("number", "verdict"))
    return {"number": number, "verdict": verdict, "draft": draft, "file": made.pdf.name}


def examined(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench doctor` of a station file: the object of `bench doctor --json`."""
    try:
        found = doctor(Path(wanted["station"]), LISTEN_S)
    except DriverError as error:
        raise InputError(str(error)) from None
    findings = [asdict(finding) for finding in found.examination.findings]
    return {"station": found.examination.station, "agrees": not found.exit_code, "findings": findings}


def _paper(kind: str, wanted: Mapping[str, Any]) -> Path | None:
    """The user's own file of the run's station, where the run folder has none."""
    folder = Path(wanted["path"])
    if (folder / f"{kind}.yaml").is_file() or not (folder / STATION_FILE).is_file():
        return None
    own = own_paper(kind, load_station(folder / STATION_FILE), Path(wanted["profiles"]))
    return own if own.is_file() else None


def _told(wanted: Mapping[str, Any], act: Callable[[], T]) -> T:
    try:
        return act()
    except BenchError as error:
        raise InputError(_hidden(wanted, str(error))) from None


def _hidden(wanted: Mapping[str, Any], text: str) -> str:
    return text.replace(str(wanted["path"]), str(wanted["run"]))
