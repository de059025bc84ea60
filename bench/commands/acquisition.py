"""Commands that need equipment, real or simulated: check, run, sim; and init."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from bench import acquisition, analysis, archive, deliver
from bench.base import Document, InputError, library, load_config, read_yaml, user_name
from bench.commands.files import write
from bench.commands.papers import Papers, told_by
from bench.commands.registering import open_in
from bench.commands.results.measure import Checked, Copied, StationServed
from bench.commands.slots import seated

if TYPE_CHECKING:
    from bench.commands.results.analyse import Reported, UnitsReported
    from drivers.sim.sender import Frames


def station_file(source: Path | Document | None) -> Document:
    """A station file as it stands; that of the embedded simulator for None."""
    if isinstance(source, Document):
        return source
    return read_yaml(library() / "stations" / "simulated.yaml" if source is None else source)


def station_of(document: Document) -> acquisition.StationSettings:
    """The station of a file; files that it names are beside it, recipients that were filled in are one's own."""
    return told_by(load_config(document, acquisition.StationSettings).beside(document))


def load_station(source: Path | Document | None) -> acquisition.StationSettings:
    """A station from its file; the embedded simulator for None."""
    return station_of(station_file(source))


@dataclass(frozen=True)
class RunOptions:
    """What the caller of `bench run` chooses: units, models, limits, and whether it is for production."""

    serials: Sequence[str] = ()
    models: Sequence[str] = ()
    limits: Path | None = None
    production: bool = False
    equipment: Path | None = None
    registry: str | None = None
    """Registry that holds the equipment of a production run without an equipment file; None: in the folder of the
    runs.
    """
    operator: str = ""
    """Who starts it, if not the user of this process."""
    junit: Path | None = None
    """Where the outcome is written as JUnit XML."""
    lot: Path | None = None
    """Run folder of the lot that `until` in the profile rests on; None: the one that it names."""


def run_profile(
    profile_path: Path, station_path: Path | None, options: RunOptions, out: Path, quiet: bool
) -> Reported | UnitsReported:
    """`bench run`: check everything, run, capture, fit, report."""
    if options.junit is None:
        return _run(profile_path, station_path, options, out, quiet)
    from bench.commands.run_junit import with_junit

    return with_junit(lambda: _run(profile_path, station_path, options, out, quiet), profile_path.stem, options.junit)


def _run(
    profile_path: Path, station_path: Path | None, options: RunOptions, out: Path, quiet: bool
) -> Reported | UnitsReported:
    from bench.commands.analysis import DEFAULT_MODELS, model_file
    from bench.commands.several import report_on_units

    chosen = [analysis.load_model(model) for model in options.models or DEFAULT_MODELS]
    limits, texts = _given(options, out)
    texts |= {model_file(i): model.to_yaml() for i, model in enumerate(chosen)}
    station, serials = seated(station_file(station_path), options.serials)
    task = Task(serials, texts, out, operator=options.operator, lot=options.lot)
    job = job_of(profile_path, station, task)
    return report_on_units(carry_out(job, quiet), chosen, limits)


@dataclass(frozen=True)
class Task:
    """What a run is made with: units, the texts that its folder keeps, where it goes, raw or corrected rate."""

    serials: Sequence[str]
    texts: Mapping[str, str]
    out: Path
    compensation: acquisition.Compensated = "off"
    operator: str = ""
    senders: Mapping[str, Frames] = field(default_factory=dict)
    """What makes the frames of simulated units, by serial number; the simulator makes those of others."""
    lot: Path | None = None
    """Run folder of the lot that `until` in the profile rests on; None: the one that it names."""


def conduct(
    profile: Path | Document, station: Path | Document | None, task: Task, quiet: bool
) -> acquisition.RunResult:
    """Check and run a profile; the folder keeps the very texts that were run. Analyses nothing."""
    return carry_out(job_of(profile, station, task), quiet)


def job_of(profile: Path | Document, station: Path | Document | None, task: Task) -> acquisition.Job:
    """What `run_job` executes, read and checked; InputError where the station cannot run the profile."""
    from bench.commands.ending_early import followed

    own = profile if isinstance(profile, Document) else read_yaml(profile)
    place = station_file(station)
    loaded, settings = acquisition.load_profile(own), station_of(place).remembering(task.out)
    if task.senders and not settings.simulated:
        text = "its units are real, and send for themselves"
        raise InputError(f"{text}; only units of a simulated station can be sent for", place.file)
    settings.chosen(list(task.senders))
    papers = refuse_wrong(settings, loaded, task.senders)
    texts = papers.texts() | dict(task.texts)
    if task.compensation == "off":
        texts |= followed(loaded, task.lot, task.out)
    return acquisition.Job(
        profile=loaded,
        profile_text=own.text,
        station=settings,
        station_text=place.text,
        model_texts=texts,
        serials=task.serials,
        out=task.out,
        compensation=task.compensation,
        operator=task.operator or user_name(),
        senders=task.senders,
    )


def carry_out(job: acquisition.Job, quiet: bool) -> acquisition.RunResult:
    """Run a job, with progress and keys in the terminal of this process; `until` in its profile may end it."""
    from bench.commands.ending_early import EndingEarly
    from bench.commands.terminal.following import Following
    from bench.commands.terminal.keyboard import Keyboard
    from bench.commands.terminal.progress import Progress

    desk, early = acquisition.Desk(), EndingEarly.of(job)
    with Keyboard(desk) as keyboard, Progress(job.profile, quiet, lambda: keyboard.notice) as progress:
        if early is None:
            return acquisition.run_job(job, Following(job.profile, desk, progress), desk)
        result = acquisition.run_job(job, Following(job.profile, desk, progress, early.heard), desk, early)
    early.write(result)
    return result


def _given(options: RunOptions, out: Path) -> tuple[analysis.Limits | None, dict[str, str]]:
    """Limits, and the files that the run folder keeps; InputError where equipment is overdue, or unknown in production.

    The day is today's, as the run's is.
    """
    limits: analysis.Limits | None = None
    texts: dict[str, str] = {}
    if options.limits is not None:
        file = read_yaml(options.limits)
        limits, texts["limits.yaml"] = analysis.load_limits(file), file.text
    if options.equipment is not None:
        file = read_yaml(options.equipment)
        equipment, texts["equipment.yaml"] = deliver.load_instruments(file), file.text
        if options.production:
            deliver.refuse_overdue(equipment, datetime.now(UTC).date(), options.equipment)
    elif options.production:
        texts["equipment.yaml"] = _registered(out, options.registry)
    return limits, texts


def _registered(out: Path, where: str | None) -> str:
    """The registry's equipment as an equipment file; InputError where it has none, or one is not calibrated today."""
    tools, url = [], where or str(out / archive.FILE)
    if where is not None or (out / archive.FILE).is_file():
        with open_in(out, where) as registry:
            tools, url = [deliver.instrument_of_registry(row) for row in archive.equipment(registry)], registry.url
    if not tools:
        raise InputError(
            "a production run needs --equipment FILE, or equipment in the registry, which holds none: add it with "
            "`bench registry equipment add`",
            url,
        )
    deliver.refuse_overdue(tools, datetime.now(UTC).date(), url)
    return deliver.instruments_yaml(tools)


def check(profile_path: Path, station_path: Path | None, limits_path: Path | None = None) -> Checked:
    """`bench check`: everything about a profile that can be known before anything moves."""
    profile, station = acquisition.load_profile(profile_path), load_station(station_path)
    limits = None if limits_path is None else analysis.load_limits(limits_path)
    refuse_wrong(station, profile)
    return check_on(profile, station, limits)


def refuse_wrong(
    station: acquisition.StationSettings, profile: acquisition.Profile | None = None, sent: Iterable[str] = ()
) -> Papers:
    """What `bench check`, `bench doctor` and `bench run` refuse before anything is opened; the papers of the station.

    InputError with everything that is wrong with station and profile. `sent`: see `wire_findings`.
    """
    acquisition.refuse_errors(before_opening(station, profile, sent))
    acquisition.Notifier(station.notify)  # wrong recipients are told now, not when a run begins
    return Papers.of_station(station)


def before_opening(
    station: acquisition.StationSettings, profile: acquisition.Profile | None = None, sent: Iterable[str] = ()
) -> list[acquisition.Finding]:
    """What is known of station and profile before anything is opened; with an error nothing is. See `refuse_wrong`."""
    wire = acquisition.wire_findings(station, tuple(sent), () if profile is None else profile.guards)
    return [*(() if profile is None else acquisition.check_profile(profile, station.limits())), *wire]


def check_on(
    profile: acquisition.Profile,
    station: acquisition.StationSettings,
    limits: analysis.Limits | None = None,
    fitted: bool = True,
) -> Checked:
    """A profile without errors, rehearsed on a station; `limits` are those that the run is to be judged by, and
    `fitted` says whether models are fitted to it.
    """
    segments = acquisition.rehearse(profile, station)
    duration_s, recording = segments[-1].to_s, acquisition.recording_of(station, shutil.disk_usage(Path.cwd()).free)
    guarded = acquisition.guards_told(station.standing_guards())
    about = acquisition.check_profile(profile, station.limits(), recording, lambda _: duration_s, guarded, fitted)
    findings = (*about, *acquisition.wire_findings(station, (), profile.guards), *_not_reached(profile, limits))
    return Checked(profile, station, segments, findings, round(duration_s * recording.bytes_per_s))


def _not_reached(profile: acquisition.Profile, limits: analysis.Limits | None) -> Iterator[acquisition.Finding]:
    """What limits of the range of temperature ask for where no set point of the profile gets there."""
    known = {} if limits is None else {limit.subject: limit for limit in limits.limits}
    low, high = min(profile.corners()[1]), max(profile.corners()[1])
    coldest, hottest = known.get("lowest_temperature_degc"), known.get("highest_temperature_degc")
    least = None if coldest is None else coldest.upper
    most = None if hottest is None else hottest.lower
    if (least is not None and low > least) or (most is not None and high < most):
        ends = [f"{least:g} degC or less"] if least is not None else []
        asked = " and ".join([*ends, *([f"{most:g} degC or more"] if most is not None else [])])
        text = f"the limits ask for {asked}, the plan goes from {low:g} to {high:g} degC: the run would be INVALID; "
        yield acquisition.Finding("warning", f"{text}choose other limits, or another plan", profile.file)


def init(folder: Path) -> Copied:
    """`bench init`: the user's own copy of the shipped profiles, stations and models."""
    target = folder / "profiles"
    if target.exists():
        raise InputError("already exists; nothing was written: choose another folder or remove it first", target)
    try:
        shutil.copytree(library(), target)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", target) from None
    return Copied(target, tuple(sorted(str(file.relative_to(folder)) for file in target.rglob("*.yaml"))))


def sim(
    station_path: Path | None,
    ports: tuple[int, int],
    speed: float,
    write_station: Path | None,
    ready: Callable[[acquisition.Served], None],
) -> StationServed:
    """`bench sim`: serve the simulated station until Ctrl-C or SIGTERM; `ready` is called when it answers."""
    settings = load_station(station_path)
    stopped = acquisition.until_signal()
    with acquisition.serve_station(settings, *ports) as served:
        if write_station is not None:
            write(write_station, served.station_yaml())
        ready(served)
        acquisition.keep_running(served.station.advance, speed, stopped)
        return StationServed(served.station.modbus_port, served.can_ports)
