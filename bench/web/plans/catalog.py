"""Profiles, stations, limits and models of the library and of the project, by name.

An id is the name of a file without `.yaml`. Files of the project replace shipped ones of the same name; profiles that a
diagnosis proposed are in the server's own folder. Computing processes use this module without a server.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from bench.acquisition import (
    Finding,
    Notifier,
    Profile,
    StationSettings,
    UnitSettings,
    load_profile,
    taken_name,
    wire_findings,
)
from bench.analysis import Limits, Model, effect_names, load_limits, load_model, model_files
from bench.base import BenchError, Document, InputError, library, load_config, nearest, parse_yaml
from bench.commands import (
    JobFile,
    Order,
    Papers,
    at_work,
    before_opening,
    check_files,
    check_on,
    check_order,
    load_station,
    named_by,
    seated,
    station_file,
    station_of,
)
from bench.commands import Plan as CalibrationPlan
from bench.deliver import undeliverable
from bench.record import slug
from bench.web.ground.problems import within
from drivers.errors import DriverError

MOST_CORNERS = 256
"""Greatest number of corners of a curve; longer ones are thinned."""
T = TypeVar("T")
_RECIPIENTS = rb"""^[^#\n]*\brecipients["']?\s*:"""
_PAPERS, _NAMES_PAPERS = rb"^(laboratory|equipment)\s*:", rb"^(chamber|units|profile)\s*:"


@dataclass(frozen=True)
class Catalog:
    """The files to choose from, listed at every request, so that a new file appears at once."""

    project: Path
    """Folder that may hold the user's own `profiles/`."""
    own: Path
    """The server's folder, `<out>/.web`."""

    @property
    def _proposals(self) -> Path:
        return self.own / "plans"

    def plans(self) -> dict[str, Path]:
        """Profiles by id."""
        return _listing(library(), self._proposals, self.project / "profiles")

    def is_proposed(self, path: Path) -> bool:
        """Whether a diagnosis proposed this profile."""
        return path.is_relative_to(self._proposals.resolve())

    def stations(self) -> dict[str, Path]:
        """Station files by id."""
        return _listing(library() / "stations", self.project / "profiles" / "stations")

    def limits(self) -> dict[str, Path]:
        """Limits files by id."""
        return _listing(library() / "limits", self.project / "profiles" / "limits")

    def calibrations(self) -> dict[str, Path]:
        """Plan files of calibrations by id."""
        return _listing(library() / "plans", self.project / "profiles" / "plans")

    def belonging(self) -> dict[str, dict[str, Any]]:
        """Limits, models and verification of the calibration plans, by the profiles that they use.

        A plan that cannot be read gives nothing: `bench calibrate` says what is wrong with it.
        """
        found: dict[str, dict[str, Any]] = {}
        limits = self.limits()
        for _, known in self._plans():
            name = Path(known.limits).stem
            belongs = {"limits": name if name in limits else "", "models": list(known.models)}
            profile, verification = Path(known.profile).stem, Path(known.verification).stem
            found.setdefault(profile, belongs | {"verification": verification})
            found.setdefault(verification, belongs)
        return found

    def _plans(self) -> Iterator[tuple[Path, CalibrationPlan]]:
        """Plans of calibrations that can be read, each with its file."""
        for file in self.calibrations().values():
            with contextlib.suppress(BenchError):
                yield file, load_config(file, CalibrationPlan)

    def model(self, name: str) -> str:
        """A model as `bench run --model` takes it: a file (also one beside a plan that names it), or an effect."""
        for file, plan in self._plans():
            if name in plan.models and (file.parent / name).is_file():
                return str((file.parent / name).resolve())
        known = model_files(self.project)
        return name if name in effect_names() and name not in known else str(named(known, name, "model"))


def _listing(*folders: Path) -> dict[str, Path]:
    """YAML files by name, sorted; later folders replace earlier ones. Those that others name are left out."""
    found = {file.stem: file for folder in folders if folder.is_dir() for file in folder.glob("*.yaml")}
    return {
        name: found[name].resolve()
        for name in sorted(found)
        if found[name].is_file() and is_text(name) and not _is_named_by_others(found[name])
    }


def _is_named_by_others(path: Path) -> bool:
    """Whether a file is, or was meant to be, one that a station or a plan names: recipients, laboratory or equipment.

    No other kind has recipients, which have passwords; what names papers has a chamber, units or a profile.
    """
    with contextlib.suppress(OSError):  # who opens it is told why it cannot be read
        text = path.read_bytes()
        papers, other = (re.search(key, text, re.MULTILINE) for key in (_PAPERS, _NAMES_PAPERS))
        return re.search(_RECIPIENTS, text, re.MULTILINE) is not None or (papers is not None and other is None)
    return False


def is_text(name: str) -> bool:
    """Whether a name can be told; one that is not UTF-8 cannot."""
    return not any("\ud800" <= sign <= "\udfff" for sign in name)


def named(listing: Mapping[str, Path], name: str, what: str) -> Path:
    """The file of this id; InputError with the known ids."""
    if name in listing:
        return listing[name]
    raise InputError(f"no {what} '{name[:60]}'; there are {', '.join(listing) or 'none'}{nearest(name, listing)}")


def is_shipped(path: Path, shipped: Path) -> bool:
    """Whether a file is the shipped one, or as it stands the same: the page has a name for that in each language."""
    return path == shipped.resolve() or (shipped.is_file() and path.read_bytes() == shipped.read_bytes())


class Read:
    """A cache of parsed files, which are read again when they change."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, Path], tuple[tuple[int, int], Any]] = {}

    def __call__(self, path: Path, what: Callable[[Path], T]) -> T:
        """The value that `what` reads from this file; raises what `what` raises."""
        status = path.stat()
        stamp, key = (status.st_mtime_ns, status.st_size), (what.__qualname__, path)
        known = self._known.get(key)
        if known is None or known[0] != stamp:
            known = self._known[key] = stamp, what(path)
        value: T = known[1]
        return value


def plan(path: Path) -> dict[str, Any]:
    """A profile in short; raises what reading it raises."""
    profile = load_profile(path)
    turns = any(leg.turn_dps for leg in profile.legs())
    return {
        "name": profile.name,
        "title": profile.name.replace("_", " "),
        "shipped": is_shipped(path, library() / path.name),
        "summary": " ".join(profile.description.split()),
        "nominal_s": profile.duration_s,
        "curve": curve(profile),
        "kind": "rate" if turns else "temperature",
        "segments": len(profile.legs()),
    }


def limits(path: Path) -> dict[str, Any]:
    """A limits file in short; raises what reading it raises."""
    found = load_limits(path)
    return {"title": found.name, "summary": " ".join(found.description.split())}


def curve(*profiles: Profile) -> list[tuple[float, float]]:
    """Corners of the nominal set point of runs one after the other: [s], [degC]; bounded in number.

    Where a run ends and the next one begins the time stands twice.
    """
    corners: list[tuple[float, float]] = []
    for profile in profiles:
        begin_s = corners[-1][0] if corners else 0.0
        corners += [(round(begin_s + t, 1), round(degc, 3)) for t, degc in zip(*profile.corners(), strict=True)]
    inner = zip(corners, corners[1:], corners[2:], strict=False)
    turns = (mid for one, mid, other in inner if not one[1] == mid[1] == other[1] or mid[0] in {one[0], other[0]})
    kept = [corners[0], *turns, corners[-1]]
    if len(kept) <= MOST_CORNERS:
        return kept
    step = (len(kept) - 1) / (MOST_CORNERS - 1)
    return [kept[round(i * step)] for i in range(MOST_CORNERS)]


def calibration(path: Path, read: Read) -> dict[str, Any]:
    """The plan of a calibration in short; raises what reading it, or its profiles, raises."""
    known = read(path, _calibration_plan)
    names = [name for name in (known.static, known.profile, known.verification) if name]
    files = [named_by(path, name) for name in names]
    profiles = [read(file, load_profile) for file in files]
    legs = [leg for profile in profiles for leg in profile.legs()]
    return {
        "title": known.name.replace("_", " "),
        "shipped": is_shipped(path, library() / "plans" / path.name)
        and all(is_shipped(file.resolve(), library() / file.name) for file in files),
        "summary": " ".join(known.description.split()),
        "nominal_s": sum(profile.duration_s for profile in profiles),
        "curve": curve(*profiles),
        "kind": "imu" if known.imu else "rate" if any(leg.turn_dps for leg in legs) else "temperature",
        "attitudes": len({leg.attitude for leg in legs if leg.attitude}),
        "certificate": known.certificate,
    }


def _calibration_plan(path: Path) -> CalibrationPlan:
    return load_config(path, CalibrationPlan)


def station(path: Path) -> StationSettings:
    """A station; InputError, DriverError or OSError when it cannot be read."""
    return load_station(path)


def equipment(settings: StationSettings, units: Iterable[str] = ()) -> frozenset[str]:
    """Equipment and `units` that only one run may use at a time, by names that stations with a common chamber share."""
    connection = settings.chamber.connection
    chamber = [] if connection is None else [f"chamber {connection.url}"]
    instruments = [f"instrument {one.address}" for one in settings.instruments if one.address is not None]
    return frozenset({f"station {settings.name}", *chamber, *instruments, *(f"unit {slug(unit)}" for unit in units)})


def rehearsed(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`bench check` of files `plan` and `station`, in a computing process; `ok` where nothing prevents the run."""
    profile, file = load_profile(Path(wanted["plan"])), station_file(Path(wanted["station"]))
    limits = load_limits(Path(wanted["limits"])) if wanted["limits"] else None
    models = {name: load_model(model) for name, model in wanted["models"].items()}
    return _rehearsed(profile, file, wanted["units"], Path(wanted["project"]), limits, models)


def _rehearsed(
    profile: Profile,
    file: Document,
    taken: Sequence[str],
    project: Path,
    limits: Limits | None = None,
    models: Mapping[str, Model] = MappingProxyType({}),
) -> dict[str, Any]:
    place, serials = seated(file, taken)
    settings = station_of(place)
    units = settings.chosen(serials)
    drawn = {"profile": profile.name, "station": settings.name, "curve": curve(profile)}
    drawn["units"] = [unit.serial for unit in units]
    findings = [*before_opening(settings, profile), *_of_files(settings, project)]
    errors = [finding for finding in findings if finding.level == "error"]
    if errors:  # the page shows all of them, not the first line
        return {**drawn, "ok": False, "duration_s": None, "segments": [], "findings": _told(findings)}
    checked = check_on(profile, settings, limits)
    held = _not_held(models, units, project)
    return {**checked.to_json(), **drawn, "ok": checked.ok, "findings": _told((*checked.findings, *held))}


def _not_held(models: Mapping[str, Model], units: Sequence[UnitSettings], project: Path) -> Iterator[Finding]:
    """A warning for each model that a unit cannot hold: a run for study may have it, and flash would refuse it."""
    for name, model in models.items():
        why_not = cache(partial(undeliverable, model, project))  # units mostly send the same channels
        for unit in units:
            if why := why_not(unit.channels):
                yield Finding("warning", f"unit {unit.serial}: model '{name}': {why}")


def _readings(settings: StationSettings, project: Path) -> tuple[Callable[[], object], ...]:
    """What reads recipients, and laboratory and equipment, that a station names: InputError where they are wrong."""
    return lambda: Notifier(settings.notify), lambda: Papers.of_station(settings, project / "profiles")


def _of_files(settings: StationSettings, project: Path) -> Iterator[Finding]:
    """What is wrong with the files that a station names."""
    for read in _readings(settings, project):
        try:
            read()
        except InputError as error:
            yield from (Finding("error", text) for text in within(project, str(error)).splitlines())


def ordered(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """The check that a calibration begins with, in a computing process; `begun` is the job that it would go on with."""
    units = [wanted["unit"], *wanted["others"]]
    order, *others = Order.load_all(Path(wanted["plan"]), Path(wanted["station"]), units, Path(wanted["out"]))
    station_of(order.station_file()).chosen([one.serial for one in (order, *others)])
    job = JobFile.newest(order.out / slug(order.serial), order.digest())
    told = {
        "units": [order.serial],
        "segments": [],
        "begun": job and _begun(job),
    }
    return {**told, **_checked(order, Path(wanted["project"]))}


def _checked(order: Order, project: Path) -> dict[str, Any]:
    """The check of an order, its duration and its curve."""
    profiles = [load_profile(order.document(name)) for name in order.profiles()]
    told = {"duration_s": sum(profile.duration_s for profile in profiles), "curve": curve(*profiles)}
    try:
        warnings = check_order(order)
    except BenchError as error:
        found = _by_line(within(project, str(error)), within(project, str(order.path)))
        return {**told, "ok": False, "findings": found}
    return {**told, "ok": True, "findings": [{"level": "warning", "text": text, "line": None} for text in warnings]}


def _begun(job: JobFile) -> dict[str, str]:
    state = "interrupted" if job.state == "running" and not at_work(job.folder) else job.state
    return {"job": f"{job.folder.parent.name}/{job.folder.name}", "state": state}


def drafted(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """The check of a text that is being edited, in a computing process: what is wrong with it, by line.

    A profile is rehearsed on the file `station`, as `bench check` does, and has its curve; a plan is checked there for
    its first unit, as `bench calibrate` does.
    """
    project = Path(wanted["project"])
    if wanted["kind"] == "plans":
        return _drafted_plan(wanted["text"], wanted["file"], Path(wanted["station"]), project)
    found, errors = loaded(wanted["kind"], wanted["text"], wanted["file"], project)
    if isinstance(found, Profile):
        told = _rehearsed(found, station_file(Path(wanted["station"])), (), project)
        others = [one for one in told["findings"] if one["text"] not in {error["text"] for error in errors}]
        return {**told, "ok": told["ok"] and not errors, "findings": [*errors, *others]}
    if errors:
        return {"ok": False, "curve": [], "findings": errors}
    findings = tuple(wire_findings(found)) if isinstance(found, StationSettings) else ()
    return {"ok": all(one.level != "error" for one in findings), "curve": [], "findings": _told(findings)}


def _drafted_plan(text: str, file: str, station: Path, project: Path) -> dict[str, Any]:
    unit = station_of(station_file(station)).units[0].serial
    try:
        return _checked(Order.load(parse_yaml(text, file), station, unit, project), project)
    except BenchError as error:
        return {"ok": False, "curve": [], "findings": _by_line(within(project, str(error)), within(project, file))}


def loaded(kind: str, text: str, file: str, project: Path) -> tuple[Any, list[dict[str, Any]]]:
    """What a text of this kind describes, and what is wrong with it; files that it names are beside `file`.

    A profile under the name of a shipped one is described all the same.
    """
    load: dict[str, Callable[[Document], Any]] = {
        "profiles": load_profile,
        "stations": station_of,
        "limits": load_limits,
        "plans": _usable_plan,
    }
    try:
        found = load[kind](parse_yaml(text, file))
        if isinstance(found, StationSettings):
            for read in _readings(found, project):
                read()
    except (BenchError, DriverError) as error:
        return None, _by_line(within(project, str(error)), within(project, file))
    if isinstance(found, Profile) and (text := taken_name(found)):
        return found, _told([Finding("error", text, found.file, found.line)])
    return found, []


def _usable_plan(text: Document) -> CalibrationPlan:
    """A plan; InputError where it, or a file or model that it names, cannot be used."""
    (order,) = Order.load_all(text, None, [""], Path())
    check_files(order)
    return order.plan


def _by_line(text: str, file: str) -> list[dict[str, Any]]:
    """The lines of a message about a file as findings, each with its line of the file where it names one."""
    found = [re.fullmatch(rf"(?:{re.escape(file)}:(?:(\d+):)? )?(.*)", line) for line in text.splitlines()]
    told = [(one[1], one[2]) for one in found if one is not None]
    return [{"level": "error", "text": text, "line": line and int(line)} for line, text in told]


def _told(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    return [{"level": finding.level, "text": finding.text, "line": finding.line} for finding in findings]
