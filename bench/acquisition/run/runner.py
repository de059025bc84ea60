"""Profile + station → run folder: the only place where sequencer and recorder meet.

Whatever happens (end, abort, exception, signal, lost link), the chamber is taken to the safe state, which is read
back, and what was captured becomes a run folder.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from bench.acquisition.profile.guards import Guards, Signal, guards_of
from bench.acquisition.profile.legs import Leg
from bench.acquisition.profile.orientation import latitude, stated
from bench.acquisition.profile.profile import Profile
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.recording.recorder import BENCH_JOURNAL, Recorder
from bench.acquisition.run import signals
from bench.acquisition.run.bell import Bell
from bench.acquisition.run.continuation import Continuation
from bench.acquisition.run.control import Desk, serve_desk
from bench.acquisition.run.ending import as_bench_error, cannot_record, make_safe
from bench.acquisition.run.plausible import Plausible
from bench.acquisition.run.remote import whoami
from bench.acquisition.run.sequencer import Sequencer
from bench.acquisition.run.status import Status
from bench.acquisition.run.watch import Watch
from bench.acquisition.run.wiring import Decider, Wiring
from bench.acquisition.station.memory import Compensated, Output
from bench.acquisition.station.occasion import Occasion, power_ons_file
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.acquisition.station.station import LiveUnit, Station, open_station
from bench.base import BenchError, EquipmentError, InputError, package_versions
from bench.record import LAYOUT, Begun, Companion, GyroKind, RunFolder, create_run
from drivers.errors import DriverError
from drivers.sim.power_ons import PowerOns
from drivers.sim.sender import Frames

STOP_SIGNALS = tuple(found for found in signal.Signals if found.name in {"SIGINT", "SIGTERM", "SIGHUP"})


@dataclass(frozen=True)
class Job:
    """What to run and where to leave it; texts are the verbatim files."""

    profile: Profile
    profile_text: str
    station: StationSettings
    station_text: str
    model_texts: Mapping[str, str]
    serials: Sequence[str] = ()
    """Units to run with; none: all units of the station."""
    out: Path = Path("reports")
    compensation: Compensated = "off"
    """Whether the units correct their rate: off for a calibration, on for a verification."""
    continuation: Continuation | None = None
    """How to go on with a run whose bench was killed; none: a new run."""
    operator: str = ""
    """Who started it, for events and manifest; empty: who this process runs for."""
    senders: Mapping[str, Frames] = field(default_factory=dict)
    """What makes the frames of simulated units, by serial number; the simulator makes those of others."""

    def legs(self) -> tuple[Leg, ...]:
        """What is to be run."""
        return self.profile.legs() if self.continuation is None else self.continuation.legs


@dataclass(frozen=True)
class UnitResult:
    """How a run ended for one unit; `error` is None when the unit went with it to its end."""

    serial: str
    run: RunFolder
    error: BenchError | None


@dataclass(frozen=True)
class RunResult:
    """How a run ended, for each of its units."""

    units: tuple[UnitResult, ...]

    @property
    def run(self) -> RunFolder:
        """The run folder of the first unit."""
        return self.units[0].run

    @property
    def error(self) -> BenchError | None:
        """The worst that happened to a unit; None when all went to the end."""
        errors = [unit.error for unit in self.units if unit.error is not None]
        return max(errors, key=lambda error: error.exit_code, default=None)


@dataclass(frozen=True)
class _Others:
    """Who sees a run and has a say in it."""

    onlooker: Callable[[Station, Status], None]
    desk: Desk
    decider: Decider | None
    bell: Bell


def run_job(
    job: Job,
    onlooker: Callable[[Station, Status], None] = lambda station, status: None,
    desk: Desk | None = None,
    decider: Decider | None = None,
) -> RunResult:
    """Execute the job and leave a finished run folder for each unit; InputError before anything moves.

    `decider` may end the run early: such a run is done, not aborted. An aborted or failed run is returned with its
    error, not raised: its data are kept. What is our own bug (or an interrupt that nobody handled) is raised again,
    after the safe state and with the run folders finished.
    """
    chosen = job.station.chosen(job.serials)
    bell = Bell(job.station, [unit.serial for unit in chosen], job.profile.name)
    occasion = _occasion(job)
    with open_station(job.station, chosen, occasion) as station:
        guards = _guards(job, station)
        recorder = _open_recorder(job, station, occasion, bell)
        failures: tuple[BenchError | None, ...] = ()
        try:
            with _control(desk, recorder):
                error = _conduct(job, station, guards, recorder, _Others(onlooker, desk or Desk(), decider, bell))
        finally:
            recorder.close()
            failures = tuple(map(_finish, recorder.runs, station.everyone))
    reasons = {gone.unit.serial: EquipmentError(f"dropped: {gone.reason}") for gone in station.dropped}
    ended = zip(chosen, recorder.runs, failures, strict=True)
    return RunResult(
        tuple(UnitResult(unit.serial, run, reasons.get(unit.serial) or error or failed) for unit, run, failed in ended)
    )


def _occasion(job: Job) -> Occasion:
    """Each run powers its simulated units once more; a run that goes on finds them still powered."""
    settings, continuation = job.station, job.continuation
    switches = any(leg.kind == "power_cycle" for leg in job.profile.legs())
    if continuation is not None:
        start_s = continuation.start_s(settings.simulated)
        return Occasion(job.profile.name, continuation.runs[0].part, start_s, continuation.power_ons, switches)
    units = settings.chosen(job.serials) if settings.simulated else ()
    try:
        power_ons = {unit.serial: PowerOns(power_ons_file(settings, unit)).next() for unit in units}
    except OSError as error:
        text = f"cannot keep how often its unit was powered: {error.strerror}; nothing was moved"
        raise InputError(text, settings.eeproms) from None
    return Occasion(job.profile.name, power_ons=power_ons, switches_power=switches, senders=job.senders)


def _open_recorder(job: Job, station: Station, occasion: Occasion, bell: Bell) -> Recorder:
    """A run folder for each unit; each knows where its companions in the chamber have theirs."""
    texts = {"profile.yaml": job.profile_text, "station.yaml": job.station_text, **job.model_texts}
    created = station.clock.utc()
    serials = [unit.serial for unit in station.everyone]
    folders = (
        [
            create_run(job.out, unit.serial, job.profile.name, created, {**texts, **_layout(unit.settings)})
            for unit in station.everyone
        ]
        if job.continuation is None
        else list(job.continuation.open(job.station_text))
    )
    everyone = dict(zip(serials, folders, strict=True))
    metas = [
        _begun(job, unit, folder, created, everyone, occasion)
        for unit, folder in zip(station.everyone, folders, strict=True)
    ]
    try:
        others = zip(folders[1:], metas[1:], strict=True)
        return Recorder(folders[0], station.clock, metas[0], *others, heard=partial(bell.hear, folders[0]))
    except OSError as error:
        raise InputError(cannot_record(error, folders[0].path), folders[0].path) from None


def _begun(
    job: Job,
    unit: LiveUnit,
    folder: RunFolder,
    created: datetime,
    others: Mapping[str, RunFolder],
    occasion: Occasion,
) -> Begun:
    settings = unit.settings
    people = {"operator": job.operator} if job.operator else {}
    return Begun(
        run=folder.path.name,
        unit=unit.serial,
        created=created.isoformat(timespec="seconds"),
        profile=job.profile.name,
        station=job.station.name,
        simulated=job.station.simulated,
        purpose="calibration" if job.compensation == "off" else "verification",
        unit_margin_degc=job.station.protection.unit_margin_degc,
        unit_lag_min=job.station.protection.unit_lag_min,
        gyro=_kind(settings),
        seeds=job.station.seeds(job.profile.name),
        orientation=stated(job.station.orientation, job.profile.orientation)[0],
        latitude_deg=latitude(job.station.orientation, job.profile.orientation),
        power_on=occasion.power_ons.get(unit.serial),
        versions=package_versions(),
        companions=tuple(
            Companion(unit=serial, run=os.path.relpath(other.path, folder.path))
            for serial, other in others.items()
            if other is not folder
        ),
        **people,
    )


def _layout(settings: UnitSettings) -> dict[str, bytes]:
    """A copy of the unit's own DBC: what the frames of the run mean does not change with the file."""
    file = Path(settings.dbc or "")
    return {LAYOUT: file.read_bytes()} if file.suffix.lower() == ".dbc" else {}


def _kind(settings: UnitSettings) -> GyroKind:
    return GyroKind(
        layout=settings.dbc or "",
        number=settings.number,
        bus=settings.bus,
        signals=settings.mapping,
        thermometers=settings.thermometers,
    )


def _finish(folder: RunFolder, unit: LiveUnit) -> BenchError | None:
    """Finish a run folder; a disk that does not take the tables leaves the journals to make them from later."""
    try:
        assemble(folder, unit.decoded())
    except OSError as error:
        text = f"; the journals are complete; then `bench report {folder.path}` makes the tables"
        return EquipmentError(f"{cannot_record(error, folder.path)}{text if folder.path.exists() else ''}")
    except InputError as error:  # nothing of its journals is left
        return EquipmentError(str(error) if folder.path.exists() else cannot_record(OSError(), folder.path))
    return None


def _guards(job: Job, station: Station) -> Guards:
    """The guards of the run. InputError when one watches what this controller, asked now, does not tell."""
    told = {*signals.told(station.chamber.poll()), *station.instruments.channels}
    patience_s = job.station.chamber.link.lost_after_s + 30.0
    standing = [one.guard for one in job.station.standing_guards()]
    return Guards(guards_of(job.station.guards, job.profile.guards, told, patience_s, standing))


def _conduct(
    job: Job,
    station: Station,
    guards: Guards,
    recorder: Recorder,
    others: _Others,
) -> BenchError | None:
    """Run the sequence and make the equipment safe; the error that ended it, if any."""
    desk, watched = others.desk, others.desk.watched(others.onlooker)
    output = Output(station, job.compensation, recorder.event)

    power = station.power
    if power is not None:
        power.restored = output.establish

    def look(status: Status) -> None:
        watched(station, status)
        others.bell.record(recorder)
        if power is None or not power.cycling:
            output.check()

    watch = Watch(station, recorder)
    wiring = Wiring(
        onlooker=look,
        table=station.turntable,
        power=power,
        placing=station.fixture,
        heart=watch,
        surroundings=lambda: {"disk_free_mb": _disk_free(recorder.run.path, station)},
        plausible=Plausible(job.station.limits(), job.station.protection.unit_lag_min),
    )
    if others.decider is not None:
        wiring = replace(wiring, decider=others.decider)
    sequencer = Sequencer(station, guards, recorder, wiring)
    desk.attach(sequencer, job.profile.duration_s, guards)
    error: BenchError | None = None
    with _stop_signals(sequencer):
        try:
            _begin(job, station, recorder, watch)
            sequencer.check_before_start()
            output.establish()
            _record_gap(job, station, recorder)
            watch.arm()
            sequencer.start_chamber()
            sequencer.run(job.legs())
        except (BenchError, DriverError, OSError) as caught:
            error = as_bench_error(caught, sequencer.moved, recorder.run.path)
        except BaseException as bug:
            error = EquipmentError(f"internal error: {type(bug).__name__}: {bug}")
            raise
        finally:
            desk.ends(str(error or sequencer.decision or "the profile is over"))
            error = make_safe(station, recorder, error, sequencer, watch)
            output.restore()
            others.bell.end(recorder)
    return error


def _begin(job: Job, station: Station, recorder: Recorder, watch: Watch) -> None:
    """Everything is recorded and watched from now on, and instruments are set: units may have their power from one."""
    station.start_capture(recorder)
    recorder.event("run", "start", who=job.operator or whoami())
    watch.start()
    station.instruments.start()


def _record_gap(job: Job, station: Station, recorder: Recorder) -> None:
    """What is known of the time between the parts of a run that goes on."""
    if job.continuation is not None:
        units = {u.serial: None if u.temperature is None else round(u.temperature.value, 3) for u in station.units}
        recorder.event("gap", **job.continuation.gap(station.started_s, station.chamber.poll(), units))


@contextmanager
def _control(desk: Desk | None, recorder: Recorder) -> Iterator[None]:
    """Serve the desk to other processes of this machine; without a port the run goes on alone."""
    if desk is None:
        yield
        return
    journals = [run.journal / BENCH_JOURNAL for run in recorder.runs]
    with serve_desk(desk, [run.path for run in recorder.runs], journals) as trouble:
        if trouble:
            recorder.event("control", trouble)
        yield


def _disk_free(path: Path, station: Station) -> Signal:
    return Signal(shutil.disk_usage(path).free / 1e6, station.clock.now())


@contextmanager
def _stop_signals(sequencer: Sequencer) -> Iterator[None]:
    """Ctrl-C, SIGTERM and a closed terminal end the run at the next tick, through the safe state.

    What whoever started us told us to ignore (`nohup`) stays ignored.
    """

    def stop(number: int, frame: Any) -> None:
        sequencer.request_stop("operator (Ctrl-C)" if number == signal.SIGINT else signal.Signals(number).name)

    try:
        heard = [number for number in STOP_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        previous = {number: signal.signal(number, stop) for number in heard}
    except ValueError:  # not in the main thread: whoever started us handles signals
        yield
        return
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
