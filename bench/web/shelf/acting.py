"""What commands do with an ended run or a station, in a computing process: report, export, replay, certificate, doctor.

A page must not show where the store is: folders in the answers are ids of runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from bench.archive import Selection
from bench.base import BenchError, InputError
from bench.commands import (
    PAPERS,
    CertificateOptions,
    NotAnalysed,
    RefitOptions,
    UnitsReported,
    diagnose_units,
    doctor,
    imu_certificate,
    load_station,
    own_paper,
    register_runs,
    replay_runs,
    report,
    try_notices,
)
from bench.commands import certificate as certify
from bench.commands import export as deliver
from bench.deliver import IMU_FORMATS, ExportOptions
from bench.web.shelf.steps import verifications_of, whole_of
from drivers.errors import DriverError

LISTEN_S = 2.0
"""How long doctor listens to each bus, as the command does [s]."""
STATION_FILE = "station.yaml"
_GIVE = "fill in the page 'Laboratory and equipment'"
T = TypeVar("T")


def exported(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench export` of a run, or of the whole inertial unit that it calibrated: names of the files."""
    folder = Path(wanted["path"])
    source = whole_of(folder) if wanted["format"] in IMU_FORMATS else folder
    made = _told(wanted, lambda: deliver(source, wanted["format"], ExportOptions(), None))
    return {"format": wanted["format"], "files": [path.name for path in made.files]}


def analysed(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench report` of one run, which is registered then; InputError says why a unit with several rates has none."""
    limits = wanted["limits"] and Path(wanted["limits"])
    made = _told(wanted, lambda: report(Path(wanted["path"]), wanted["models"], limits=limits))
    for unit in made.units if isinstance(made, UnitsReported) else ():
        if isinstance(unit.result, NotAnalysed):
            raise InputError(_hidden(wanted, unit.result.error))
    register_runs(made.runs, None, begin=False)
    return {"run": wanted["run"], "verdict": made.verdict}


def fleet_diagnosed(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench fleet diagnose` of the units that a page shows: how many were diagnosed now, and why others were not.

    Each one is kept as soon as it is made: a job that was given up is continued by the next.
    """
    options = RefitOptions(TypeAdapter(Selection).validate_python(wanted["selection"]), workers=1)
    out = Path(wanted["out"])
    found = diagnose_units(wanted["model"], out, wanted["where"], options, part=wanted["part"]).diagnosis
    return {"made": found.made, "failed": [text.replace(f"{out}/", "") for text in found.failed]}


def replayed(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench replay` of one run: the entry of `bench replay --json`."""
    (made,) = _told(wanted, lambda: replay_runs([Path(wanted["path"])], (), ())).replays
    return {**made.to_json(), "run": wanted["run"], "failed": _hidden(wanted, made.failed)}


def certified(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench certificate`: its number, its verdict and its file; runs that verify this one are its evidence.

    Papers that the run folder lacks are those that were filled in for its station since.
    """
    folder, draft = Path(wanted["path"]), bool(wanted["draft"])
    whole = whole_of(folder)
    laboratory, equipment = (_paper(kind, wanted, whole) for kind in PAPERS)
    # The newest states the figures; the verification of a whole unit stands in its folder.
    evidence = () if whole != folder else tuple(reversed(verifications_of(folder)))
    options = CertificateOptions(evidence, laboratory=laboratory, equipment=equipment, give=_GIVE, draft=draft)
    issue = certify if whole == folder else imu_certificate
    made = _told(wanted, lambda: issue(whole, options, None))
    told = {key: made.facts.get(key) for key in ("number", "verdict", "signer")}
    return {**told, "draft": draft, "file": made.pdf.name}


def examined(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench doctor` of a station file: the object of `bench doctor --json`."""
    try:
        found = doctor(Path(wanted["station"]), LISTEN_S)
    except DriverError as error:
        raise InputError(str(error)) from None
    findings = [asdict(finding) for finding in found.examination.findings]
    return {"station": found.examination.station, "agrees": not found.exit_code, "findings": findings}


def noticed(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench doctor --notify` of a station file: what went wrong by recipient, empty where the trial was taken."""
    station = Path(wanted["station"])
    try:
        return {"recipients": dict(try_notices(station).recipients)}
    except BenchError as error:
        raise InputError(str(error).replace(f"{station.parent}/", "")) from None


def _paper(kind: str, wanted: Mapping[str, Any], whole: Path) -> Path | None:
    """The run's own file beside the folder of a whole unit, or the user's of its station, where the folder has none."""
    folder = Path(wanted["path"])
    if (whole / f"{kind}.yaml").is_file():
        return None
    if (folder / f"{kind}.yaml").is_file():
        return folder / f"{kind}.yaml"
    if not (folder / STATION_FILE).is_file():
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
