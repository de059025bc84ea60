"""The receive loop of a capture process: writes every frame of a bus to a journal, and publishes a heartbeat.

It does not use a Notifier, decode or print: nothing here may take longer than the kernel buffers frames.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import can

from drivers.backoff import BackOff
from drivers.can_record import CLASSICAL_BYTES
from drivers.errors import DriverError, one_line
from drivers.frames import to_record
from drivers.health import Beat, Tally
from drivers.journal import JournalWriter, Kind
from drivers.lag import Lag, both_clocks

BATCH_FRAMES = 1024
BATCH_NS = 100_000_000
SYNC_S = 1.0
POLL_S = 0.05
BACK_OFF = BackOff(first_s=0.5, most_s=5.0)
ERROR_BUS_OFF = 0x40


class Recorder:
    """Receives from a bus into a journal until it is stopped; opens the bus again when it fails."""

    def __init__(
        self,
        open_bus: Callable[[], can.BusABC],
        writer: JournalWriter,
        beat: Beat,
        start_ns: int,
        room: int = CLASSICAL_BYTES,
    ) -> None:
        """`room` is how many bytes of data the longest frame of the bus has."""
        self._room = room
        self._open_bus = open_bus
        self._writer = writer
        self._beat = beat
        self._start_ns = start_ns
        self._tally = Tally()
        self._off = False  # the controller has reported bus off
        self._lag = Lag()

    def run(self, ready: Callable[[], None], stopped: Callable[[], bool]) -> None:
        """Record until `stopped()`; calls `ready()` once the bus is open.

        DriverError when the bus does not open at first; OSError when the journal cannot be written (a full disk).
        """
        bus = self._open_bus()
        self._beat.publish(self._tally)  # the heartbeat must exist before `ready`
        ready()
        with self._synced():
            while True:
                try:
                    self._receive(bus, stopped)
                    self._summarise()
                    return
                except can.CanError as error:
                    self._report(f"bus failed: {one_line(error)}")
                finally:
                    _shut(bus)
                reopened = self._reopen(stopped)
                if reopened is None:
                    self._summarise()
                    return
                bus = reopened
                self._report("")

    def _receive(self, bus: can.BusABC, stopped: Callable[[], bool]) -> None:
        while not stopped():
            self._batch(bus, BATCH_NS)
        while self._batch(bus, 0) == BATCH_FRAMES:  # frames that still wait on the bus
            pass

    def _batch(self, bus: can.BusABC, within_ns: int) -> int:
        """Journal the frames that arrive within a time [ns], or those that wait already; returns their number."""
        deadline_ns = time.monotonic_ns() + within_ns
        records: list[bytes] = []
        behind_ns = 0
        try:
            while len(records) < BATCH_FRAMES:
                left_ns = deadline_ns - time.monotonic_ns()
                if left_ns <= 0 < within_ns:
                    break
                try:
                    message = bus.recv(max(left_ns, 0) * 1e-9)
                    now_ns, calendar_ns = both_clocks()
                    if message is None:
                        self._lag.caught_up(now_ns)
                        _refuse_off(bus)
                        break
                    age_ns = self._lag.age_ns(now_ns, calendar_ns - round(message.timestamp * 1e9))
                    t_ns = now_ns - age_ns - self._start_ns
                    records.append(to_record(message, t_ns, 0, self._room))
                except (ValueError, IndexError):  # a long CAN FD frame, or a line that the interface cannot parse
                    self._tally.unreadable += 1
                    if within_ns:
                        continue
                    break
                self._tally.last_ns = t_ns
                behind_ns = age_ns if age_ns > behind_ns else behind_ns
                if message.is_error_frame:
                    self._tally.error_frames += 1
                self._watch_controller(message)
        except can.CanError:
            raise
        except Exception as error:  # an OSError, or whatever else an interface of others raises
            raise can.CanOperationError(one_line(error)) from error
        finally:
            self._watch_lag(behind_ns)
            self._flush(records)
        return len(records)

    def _watch_lag(self, behind_ns: int) -> None:
        """Journal an event when the capture falls behind its bus, and when it has caught up."""
        tally = self._tally
        tally.behind_ns, tally.most_behind_ns = behind_ns, max(tally.most_behind_ns, behind_ns)
        now_s = (time.monotonic_ns() - self._start_ns) * 1e-9
        if text := self._lag.news(behind_ns, now_s):
            tally.spells = self._lag.spells
            event(self._writer, text, now_s, most_behind_ms=self._lag.most_ns // 1_000_000)

    def _flush(self, records: list[bytes]) -> None:
        if records:
            self._tally.frames += len(records)
            last_s = self._tally.last_ns * 1e-9
            self._writer.append(Kind.FRAMES, b"".join(records), len(records), last_s, time.time_ns())
        self._beat.publish(self._tally)

    def _watch_controller(self, message: can.Message) -> None:
        """SocketCAN raises nothing at bus off: an error frame reports it, and the next frame shows that it is over.

        linux/can/error.h: class CAN_ERR_BUSOFF is bit 0x40 of the identifier.
        """
        if message.is_error_frame and message.arbitration_id & ERROR_BUS_OFF and not self._off:
            self._off = True
            self._report(
                "bus off: too many errors on the wire; the driver starts the controller again if restart-ms is set"
            )
        elif self._off and not message.is_error_frame:
            self._off = False
            self._report("")

    def _reopen(self, stopped: Callable[[], bool]) -> can.BusABC | None:
        failures = 0
        while not stopped():
            try:
                return self._open_bus()
            except DriverError as error:
                failures += 1
                self._beat.fail(str(error))
                again_ns = time.monotonic_ns() + round(BACK_OFF.wait_s(failures) * 1e9)
            while time.monotonic_ns() < again_ns and not stopped():
                self._beat.publish(self._tally)
                time.sleep(POLL_S)
        return None

    def _report(self, text: str) -> None:
        now_ns = time.monotonic_ns() - self._start_ns
        event(self._writer, text or self._recovered(now_ns), now_ns * 1e-9)
        self._tally.recoveries += not text
        self._tally.since_ns = now_ns if text else -1
        self._beat.publish(self._tally)
        self._beat.fail(text)

    def _recovered(self, now_ns: int) -> str:
        return f"bus open again after {(now_ns - self._tally.since_ns) * 1e-9:.1f} s; no frames in between"

    def _summarise(self) -> None:
        """Write the counts of errors to the journal, for the report."""
        now_s = (time.monotonic_ns() - self._start_ns) * 1e-9
        summarise(self._writer, self._tally, now_s, quiet=True)

    @contextmanager
    def _synced(self) -> Iterator[None]:
        """Force the journal to the disk once a second, from a thread that does not block the loop."""
        done = threading.Event()

        def sync() -> None:
            while not done.wait(SYNC_S):
                try:
                    self._writer.sync()
                except OSError as error:
                    self._beat.fail(f"journal not on disk: {one_line(error)}", ended=True)

        thread = threading.Thread(target=sync, name="journal sync", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


def raise_priority() -> None:
    """Raise the priority of this process; without permission, nothing changes."""
    try:
        os.nice(-10)
    except OSError:
        return


def event(writer: JournalWriter, text: str, t_s: float, **facts: int) -> None:
    """Write an event of the capture to the journal of its bus."""
    content = {"kind": "capture", "text": text, **facts}
    writer.append(Kind.EVENT, json.dumps(content).encode(), 1, t_s, time.time_ns())


def summarise(writer: JournalWriter, tally: Tally, t_s: float, quiet: bool = False) -> None:
    """Write the error counts of a bus as an event; all 0: no event, or with `quiet` one that is not shown."""
    wrong = tally.error_frames or tally.recoveries or tally.unreadable or tally.spells
    if not wrong and not quiet:
        return
    text = (
        f"{tally.frames} frames, {tally.error_frames} error frames, {tally.unreadable} unreadable, "
        f"{tally.recoveries} times open again, at most {tally.most_behind_ns * 1e-9:.3f} s behind the bus"
    )
    counts = {"error_frames": tally.error_frames, "unreadable": tally.unreadable, "recoveries": tally.recoveries}
    behind = {"most_behind_ms": tally.most_behind_ns // 1_000_000, "behind_spells": tally.spells}
    event(writer, text, t_s, **counts, **behind, **({} if wrong else {"no_news": 1}))


def _refuse_off(bus: can.BusABC) -> None:
    """CanOperationError at bus off, for interfaces that neither raise nor send an error frame then (IXXAT, Systec)."""
    if bus.state is can.BusState.ERROR:
        raise can.CanOperationError("bus off: too many errors on the wire; the controller is started again")


def _shut(bus: can.BusABC) -> None:
    """Close a bus that may have failed already."""
    with suppress(can.CanError, OSError):
        bus.shutdown()


def stop_when(control: Any, parent_pid: int) -> Callable[[], bool]:
    """A function that is true once the parent sends on the pipe `control`, closes its end, or has died."""
    return lambda: control.poll() or os.getppid() != parent_pid
