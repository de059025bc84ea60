"""How a run ends: the equipment made safe and read back, the records closed, the error that is told."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.sequencer import Sequencer
from bench.acquisition.run.watch import Watch
from bench.acquisition.station.safety import SafeState, failures, tell
from bench.acquisition.station.station import Station
from bench.base import BenchError, EquipmentError, InputError, RunAborted
from drivers.errors import DriverError


def _state(error: BenchError | None) -> str:
    if error is None:
        return "done"
    return "aborted" if isinstance(error, RunAborted) else "failed"


def as_bench_error(caught: BenchError | DriverError | OSError, moved: bool, folder: Path) -> BenchError:
    """What ended the run, as an error of the bench; once equipment has moved, bad input is an equipment error too."""
    if isinstance(caught, BenchError) and not (moved and isinstance(caught, InputError)):
        return caught
    error = EquipmentError(cannot_record(caught, folder) if isinstance(caught, OSError) else str(caught))
    error.__cause__ = caught
    return error


def make_safe(
    station: Station, recorder: Recorder, error: BenchError | None, sequencer: Sequencer, watch: Watch
) -> BenchError | None:
    """The safe state, read back; says loudly what could not be verified, and leaves that to the watchdog.

    Equipment that was not commanded yet is left as it was found. The disk may be full: equipment first, records then.
    """
    recorder.hold_back()
    if sequencer.moved:
        trouble = _go_to_safe_state(station, recorder, sequencer, watch)
    else:
        trouble = _switched_off(station, recorder)
    watch.end(verified=not trouble)
    if trouble:
        further = "; the watchdog goes on trying" if watch.over else ""
        cause = f" (run ended by: {error})" if error is not None else ""
        error = EquipmentError(f"{trouble}{further}{cause}")
        with suppress(OSError):  # now, and not after minutes of tables and report
            print(f"bench: {error}", file=sys.stderr, flush=True)
    elif error is not None and sequencer.moved:
        with suppress(OSError):
            print(f"bench: {error}; the safe state was reached and read back", file=sys.stderr, flush=True)
    try:
        recorder.write_held()
        station.stop_capture()
        recorder.event("end", str(error or sequencer.decision or "end of profile"), state=_state(error))
        recorder.sync()
    except OSError as caught:
        error = error or EquipmentError(cannot_record(caught, recorder.run.path))
    return error


def _go_to_safe_state(station: Station, recorder: Recorder, sequencer: Sequencer, watch: Watch) -> str:
    """What could not be verified; empty when all was."""
    settings = station.settings
    way = SafeState(
        station.chamber,
        station.clock,
        settings.safe_state,
        settings.ambient_degc,
        60.0 * settings.safe_state.retry_min,
        stop_moving=station.stop_moving,
        switch_off=station.instruments.safe,
        beat=lambda: watch.allow(60.0 + 4.0 * settings.safe_state.step_s),
        hurry=lambda: sequencer.asked_to_stop,
        report=recorder.event,
    )
    return failures(way.make())


def _switched_off(station: Station, recorder: Recorder) -> str:
    """The instruments of a run that ended before the chamber was commanded: off again what was switched on."""
    if not station.instruments.commanded:
        return ""
    steps = station.instruments.safe()
    tell(steps, recorder.event)
    return failures(steps)


def cannot_record(error: OSError, folder: Path) -> str:
    """Why a record could not be written to a folder, on which disk, and what helps."""
    if not folder.exists():
        return f"cannot record: the run folder {folder} was removed while the run was under way; what it held is lost"
    disk = next(place for place in (folder.resolve(), *folder.resolve().parents) if place.is_mount())
    where = f"{folder}, on the disk at {disk}"
    return f"cannot record: {error.strerror or error}: {where}; free disk space or choose another place with --out"
