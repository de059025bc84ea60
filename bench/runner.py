"""Profile + station → run folder: the only place where sequencer and recorder meet.

Whatever happens (end, abort, exception, signal, lost link), the chamber is taken to the safe state, which is read
back, and what was captured becomes a run folder.
"""

from __future__ import annotations

import platform
import shutil
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from bench import __version__
from bench.assemble import assemble
from bench.equipment import UnitSettings
from bench.errors import BenchError, EquipmentError, InputError, RunAborted
from bench.guards import DEFAULT_GUARDS, Guards, Signal
from bench.profile import Profile
from bench.recorder import Recorder
from bench.sequencer import Sequencer, Status
from bench.station import Station, StationSettings, open_station
from bench.store import RunFolder, create_run
from drivers.chamber import Write
from drivers.errors import DriverError

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
RECORDED_PACKAGES = ("numpy", "scipy", "pandas", "pymodbus", "python-can", "cantools", "pyarrow")


@dataclass(frozen=True)
class Job:
    """What to run and where to leave it; texts are the verbatim files."""

    profile: Profile
    profile_text: str
    station: StationSettings
    station_text: str
    model_texts: Mapping[str, str]
    serial: str | None = None
    out: Path = Path("reports")


@dataclass(frozen=True)
class RunResult:
    """How a run ended; `error` is None when it went to its end."""

    run: RunFolder
    error: BenchError | None


def run_job(job: Job, onlooker: Callable[[Station, Status], None] = lambda station, status: None) -> RunResult:
    """Execute the job and leave a finished run folder; InputError before anything moves.

    An aborted or failed run is returned with its error, not raised: its data are kept. What is our own bug (or an
    interrupt that nobody handled) is raised again, after the safe state and with the run folder finished.
    """
    unit = job.station.unit(job.serial)
    with open_station(job.station, [unit], job.profile.name) as station:
        recorder = _open_recorder(job, unit, station)
        try:
            error = _conduct(job, station, recorder, onlooker)
        finally:
            recorder.close()
            failure = _assemble(recorder.run, station)
    return RunResult(recorder.run, error or failure)


def _open_recorder(job: Job, unit: UnitSettings, station: Station) -> Recorder:
    texts = {"profile.yaml": job.profile_text, "station.yaml": job.station_text, **job.model_texts}
    folder = create_run(job.out, unit.serial, job.profile.name, station.clock.utc(), texts)
    meta = {
        "run": folder.path.name,
        "unit": unit.serial,
        "created": station.clock.utc().isoformat(timespec="seconds"),
        "profile": job.profile.name,
        "station": job.station.name,
        "simulated": job.station.simulated,
        "gyro": {"layout": unit.gyro, "number": unit.number, "bus": unit.bus},
        "seeds": job.station.seeds(job.profile.name),
        "versions": versions(),
    }
    try:
        return Recorder(folder, station.clock, meta)
    except OSError as error:
        raise InputError(_cannot_record(error), folder.path) from None


def _assemble(folder: RunFolder, station: Station) -> EquipmentError | None:
    """Finish the run folder; a disk that does not take the tables leaves the journals to make them from later."""
    try:
        assemble(folder, station.units[0].decoded())
    except OSError as error:
        text = f"the journals are complete; then `bench report {folder.path}` makes the tables"
        return EquipmentError(f"{_cannot_record(error)}; {text}")
    return None


def _state(error: BenchError | None) -> str:
    if error is None:
        return "done"
    return "aborted" if isinstance(error, RunAborted) else "failed"


def _conduct(
    job: Job, station: Station, recorder: Recorder, onlooker: Callable[[Station, Status], None]
) -> BenchError | None:
    """Run the sequence and make the equipment safe; the error that ended it, if any."""
    guards = Guards((*DEFAULT_GUARDS, *job.station.guards, *job.profile.guards))
    sequencer = Sequencer(station, guards, recorder, lambda status: onlooker(station, status))
    sequencer.extra_signals = lambda: {"disk_free_mb": _disk_free(recorder.run.path, station)}
    station.on_write = recorder.write
    error: BenchError | None = None
    with _stop_signals(sequencer):
        try:
            station.start_capture(recorder)
            recorder.event("run", "start")
            sequencer.check_before_start()
            sequencer.start_chamber()
            sequencer.run(job.profile.legs())
        except (BenchError, DriverError, OSError) as caught:
            error = _as_bench_error(caught, sequencer.moved)
        except BaseException as bug:
            error = EquipmentError(f"internal error: {type(bug).__name__}: {bug}")
            raise
        finally:
            error = _make_safe(station, recorder, error, sequencer.moved)
    return error


def _as_bench_error(caught: BenchError | DriverError | OSError, moved: bool) -> BenchError:
    """What ended the run, as an error of the bench; once equipment has moved, it is no more a matter of bad input."""
    if isinstance(caught, BenchError) and not (moved and isinstance(caught, InputError)):
        return caught
    error = EquipmentError(_cannot_record(caught) if isinstance(caught, OSError) else str(caught))
    error.__cause__ = caught
    return error


def _make_safe(station: Station, recorder: Recorder, error: BenchError | None, moved: bool) -> BenchError | None:
    """Set point to ambient, then off, each read back; says loudly what could not be verified.

    Equipment that was not commanded yet is left as it was found. The disk may be full: equipment first, records then.
    """
    writes: list[Write] = []
    station.on_write = writes.append
    steps = station.chamber.safe(station.settings.ambient_degc) if moved else []
    if failed := [f"{step.what}: {step.detail}" for step in steps if not step.ok]:
        cause = f" (run ended by: {error})" if error is not None else ""
        error = EquipmentError(f"SAFE STATE NOT VERIFIED: {'; '.join(failed)}; switch the chamber off by hand{cause}")
    try:
        for write in writes:
            recorder.write(write)
        for step in steps:
            recorder.event("safe_state", f"{step.what}: {step.detail}", ok=step.ok)
        station.stop_capture()
        recorder.event("end", str(error or "end of profile"), state=_state(error))
        recorder.sync()
    except OSError as caught:
        error = error or EquipmentError(_cannot_record(caught))
    return error


def _cannot_record(error: OSError) -> str:
    return f"cannot record: {error.strerror or error}; free disk space or choose another place with --out"


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


def versions() -> dict[str, str]:
    """Versions of everything that made the numbers."""
    found = {"bench": __version__, "python": platform.python_version()}
    for package in RECORDED_PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found
