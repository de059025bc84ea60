"""Commands that need equipment, real or simulated: check, run, sim; and init."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from bench.base import InputError, library, load_config, read_text
from bench.commands.analysis import DEFAULT_MODELS, report_on
from bench.commands.answer import Answer
from bench.commands.several import report_on_all

if TYPE_CHECKING:
    from bench.acquisition import Compensated, Job, RunResult, StationSettings
    from bench.analysis import Limits

BYTES_PER_S = 20_000.0
"""Disk of one unit at 500 Hz: 601 frames of 24 bytes a second, readings, and the compressed tables."""


def load_station(path: Path | None) -> StationSettings:
    """A station file; the embedded simulator for None."""
    from bench.acquisition import StationSettings

    return load_config(_station_path(path), StationSettings).beside(_station_path(path).parent)


def _station_path(path: Path | None) -> Path:
    return library() / "stations" / "simulated.yaml" if path is None else path


@dataclass(frozen=True)
class RunOptions:
    """What the caller of `bench run` chooses: units, models, limits, and whether it is for production."""

    serials: Sequence[str] = ()
    models: Sequence[str] = ()
    limits: Path | None = None
    production: bool = False
    equipment: Path | None = None
    registry: str | None = None
    """Where the equipment of a production run stands without a file; None: in the folder of the runs."""
    operator: str = ""
    """Who starts it, if not the user of this process."""


def run_profile(profile_path: Path, station_path: Path | None, wishes: RunOptions, out: Path, quiet: bool) -> Answer:
    """`bench run`: check everything, run, capture, fit, report."""
    from bench.analysis import load_model

    chosen = [load_model(model) for model in wishes.models or DEFAULT_MODELS]
    given, texts = _given(wishes, out)
    texts |= {_model_file(i): model.to_yaml() for i, model in enumerate(chosen)}
    result = conduct(profile_path, station_path, Task(wishes.serials, texts, out, operator=wishes.operator), quiet)
    if len(result.units) > 1:
        return report_on_all(result.units, chosen, given)
    return report_on(result.run, chosen, result.error, limits=given)


@dataclass(frozen=True)
class Task:
    """What a run is made with: units, the texts that its folder keeps, where it goes, raw or corrected rate."""

    serials: Sequence[str]
    texts: Mapping[str, str]
    out: Path
    compensation: Compensated = "off"
    operator: str = ""


def conduct(profile_path: Path, station_path: Path | None, task: Task, quiet: bool) -> RunResult:
    """Check and run a profile; analyses nothing."""
    from bench.acquisition import Desk, run_job
    from bench.commands.terminal.following import Following
    from bench.commands.terminal.keyboard import Keyboard
    from bench.commands.terminal.progress import Progress

    job, desk = job_of(profile_path, station_path, task), Desk()
    with Keyboard(desk) as keyboard, Progress(job.profile, quiet, lambda: keyboard.notice) as progress:
        return run_job(job, Following(job.profile, desk, progress), desk)


def job_of(profile_path: Path, station_path: Path | None, task: Task) -> Job:
    """What `run_job` executes, read and checked; InputError where the station cannot run the profile."""
    from bench.acquisition import Job, check_profile, load_profile, refuse_errors

    profile = load_profile(profile_path)
    station = load_station(station_path).remembering(task.out)
    refuse_errors(check_profile(profile, station.limits()))
    return Job(
        profile=profile,
        profile_text=read_text(profile_path),
        station=station,
        station_text=read_text(_station_path(station_path)),
        model_texts=task.texts,
        serials=task.serials,
        out=task.out,
        compensation=task.compensation,
        operator=task.operator,
    )


def _given(wishes: RunOptions, out: Path) -> tuple[Limits | None, dict[str, str]]:
    """Limits, and the files that the run folder keeps; InputError where equipment is overdue, or unknown in production.

    The day is today's, as the run's is.
    """
    from bench.analysis import load_limits
    from bench.deliver import load_instruments, refuse_overdue

    found: Limits | None = None
    texts: dict[str, str] = {}
    if wishes.limits is not None:
        found = load_limits(wishes.limits)
        texts["limits.yaml"] = read_text(wishes.limits)
    if wishes.equipment is not None:
        tools = load_instruments(wishes.equipment)
        texts["equipment.yaml"] = read_text(wishes.equipment)
        if wishes.production:
            refuse_overdue(tools, datetime.now(UTC).date(), wishes.equipment)
    elif wishes.production:
        texts["equipment.yaml"] = _registered(out, wishes.registry)
    return found, texts


def _registered(out: Path, where: str | None) -> str:
    """The registry's equipment as an equipment file; InputError where it has none, or one is not calibrated today."""
    from bench.archive import FILE, equipment
    from bench.commands.registering import open_in
    from bench.deliver import instrument_of_registry, instruments_yaml, refuse_overdue

    tools, url = [], where or str(out / FILE)
    if where is not None or (out / FILE).is_file():
        with open_in(out, where) as registry:
            tools, url = [instrument_of_registry(row) for row in equipment(registry)], registry.url
    if not tools:
        raise InputError(
            "a production run needs --equipment FILE, or equipment in the registry, which holds none: add it with "
            "`bench registry equipment add`",
            url,
        )
    refuse_overdue(tools, datetime.now(UTC).date(), url)
    return instruments_yaml(tools)


def _model_file(order: int) -> str:
    return "model.yaml" if order == 0 else f"model-{order + 1}.yaml"


def check_command(profile_path: Path, station_path: Path | None) -> Answer:
    """`bench check`: everything about a profile that can be known before anything moves."""
    from bench.acquisition import Recording, check_profile, load_profile, profile_picture, refuse_errors, rehearse

    profile = load_profile(profile_path)
    station = load_station(station_path)
    refuse_errors(check_profile(profile, station.limits()))
    segments = rehearse(profile, station)
    duration_s = segments[-1].to_s
    recording = Recording(
        bytes_per_s=BYTES_PER_S, units=len(station.units), free_bytes=shutil.disk_usage(Path.cwd()).free
    )
    findings = check_profile(profile, station.limits(), recording, lambda _: duration_s)
    late = [segment for segment in segments if segment.outcome != "done"]
    lines = [f"{profile.name} on station {station.name}: {len(segments)} segments, {duration_s / 3600:.2f} h", ""]
    lines += [profile_picture(profile), ""]
    for segment in segments:
        took_min = (segment.to_s - segment.from_s) / 60
        lines.append(f"{segment.from_s / 60:8.1f} min  {segment.name:<36} {took_min:7.1f} min")
    lines += ["", f"units: {', '.join(unit.serial for unit in station.units)}"]
    lines += [str(finding) for finding in findings]
    lines += [f"warning: {segment.name} would fail: {segment.reason}" for segment in late]
    content = {
        "profile": profile.name,
        "station": station.name,
        "duration_s": duration_s,
        "disk_bytes": round(duration_s * BYTES_PER_S * len(station.units)),
        "segments": [asdict(segment) for segment in segments],
        "findings": [asdict(finding) for finding in findings],
    }
    return Answer(content, "\n".join(lines), 1 if late else 0)


def init(folder: Path) -> Answer:
    """`bench init`: the user's own copy of the shipped profiles, stations and models."""
    target = folder / "profiles"
    if target.exists():
        raise InputError("already exists; nothing was written: choose another folder or remove it first", target)
    try:
        shutil.copytree(library(), target)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", target) from None
    names = sorted(str(file.relative_to(folder)) for file in target.rglob("*.yaml"))
    text = "\n".join([f"wrote {len(names)} files below {target}:", *names, "", f"next: cd {folder} && bench check ..."])
    return Answer({"folder": str(target), "files": names}, text)


def sim(station_path: Path | None, ports: tuple[int, int], speed: float, write_station: Path | None) -> Answer:
    """`bench sim`: serve the simulated station until Ctrl-C or SIGTERM."""
    from bench.acquisition import keep_running, serve_station, until_signal

    settings = load_station(station_path)
    stopped = until_signal()
    with serve_station(settings, *ports) as served:
        if write_station is not None:
            try:
                write_station.write_text(served.station_yaml())
            except OSError as error:
                raise InputError(f"cannot be written: {error.strerror}", write_station) from None
        print(f"chamber  Modbus TCP 127.0.0.1:{served.station.modbus_port} ({settings.chamber.map})", file=sys.stderr)
        for name, port in served.can_ports.items():
            print(f"bus      {name}: python-can interface=loopcan channel={port}", file=sys.stderr)
        print("ready; Ctrl-C ends it", file=sys.stderr, flush=True)
        keep_running(served, speed, stopped)
        content = {"modbus_port": served.station.modbus_port, "can_ports": served.can_ports}
    return Answer(content, "ended")
