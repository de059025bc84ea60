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
from bench.errors import BenchError, EquipmentError, RunAborted
from bench.guards import DEFAULT_GUARDS, Guards, Signal
from bench.profile import Profile
from bench.recorder import Recorder
from bench.sequencer import Sequencer, Status
from bench.station import Station, StationSettings, open_station
from bench.store import RunFolder, create_run
from drivers.errors import DriverError

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

    An aborted or failed run is returned with its error, not raised: its data are kept.
    """
    unit = job.station.unit(job.serial)
    with open_station(job.station, [unit]) as station:
        folder = create_run(job.out, unit.serial, job.profile.name, station.clock.utc())
        (folder.path / "profile.yaml").write_text(job.profile_text)
        (folder.path / "station.yaml").write_text(job.station_text)
        for name, text in job.model_texts.items():
            (folder.path / name).write_text(text)
        meta = {
            "run": folder.path.name,
            "unit": unit.serial,
            "created": station.clock.utc().isoformat(timespec="seconds"),
            "profile": job.profile.name,
            "simulated": job.station.simulated,
            "gyro": {"layout": unit.gyro, "number": unit.number, "bus": unit.bus},
            "seeds": job.station.seeds(),
            "versions": versions(),
        }
        recorder = Recorder(folder, station.clock, meta)
        try:
            error = _conduct(job, station, recorder, onlooker)
        finally:
            recorder.close()
    outcome = {"state": _state(error), "cause": str(error) if error is not None else "end of profile"}
    assemble(folder, outcome, station.units[0].decoded())
    return RunResult(folder, error)


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
    error: BenchError | None = None
    with _stop_signals(sequencer):
        try:
            station.start_capture(recorder)
            recorder.event("run", "start")
            sequencer.check_before_start()
            sequencer.start_chamber()
            sequencer.run(job.profile.legs())
            recorder.event("run", "end of profile")
        except BenchError as caught:
            error = caught
        except DriverError as caught:
            error = EquipmentError(f"{type(caught).__name__}: {caught}")
            error.__cause__ = caught
        except OSError as caught:
            error = EquipmentError(f"cannot record: {caught.strerror or caught}; free disk space under {job.out}")
        finally:
            error = _make_safe(station, recorder, error)
    return error


def _make_safe(station: Station, recorder: Recorder, error: BenchError | None) -> BenchError | None:
    """Set point to ambient, then off, each read back; says loudly what could not be verified."""
    steps = station.chamber.safe(station.settings.ambient_degc)
    failed = [f"{step.what}: {step.detail}" for step in steps if not step.ok]
    try:
        if error is not None:
            recorder.event("run", f"ended early: {error}")
        for step in steps:
            recorder.event("safe_state", f"{step.what}: {step.detail}", ok=step.ok)
        station.stop_capture()
    except OSError as caught:  # the disk may be full; the equipment is safe already
        error = error or EquipmentError(f"cannot record: {caught.strerror or caught}")
    if failed:
        cause = f" (run ended by: {error})" if error is not None else ""
        return EquipmentError(f"SAFE STATE NOT VERIFIED: {'; '.join(failed)}; switch the chamber off by hand{cause}")
    return error


def _disk_free(path: Path, station: Station) -> Signal:
    return Signal(shutil.disk_usage(path).free / 1e6, station.clock.now())


@contextmanager
def _stop_signals(sequencer: Sequencer) -> Iterator[None]:
    """Ctrl-C and SIGTERM end the run at the next tick, through the safe state."""

    def stop(number: int, frame: Any) -> None:
        sequencer.request_stop("operator (Ctrl-C)" if number == signal.SIGINT else signal.Signals(number).name)

    try:
        previous = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
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
