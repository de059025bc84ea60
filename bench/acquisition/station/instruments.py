"""The instruments of a station during a run: opened, set, read beside the chamber, off again in the safe state.

A real instrument has a thread of its own: a multimeter that takes seconds for a value does not hold up the loop of the
run. In simulated time everything is asked at once, so that same seed, same run.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np

from bench.acquisition.profile.guards import Signal
from bench.acquisition.recording.recorder import INSTRUMENT
from bench.acquisition.station.links import Link
from bench.acquisition.station.records import Journal
from bench.acquisition.station.safety import INSTRUMENT as INSTRUMENT_STEP
from bench.acquisition.station.settings.instrument import InstrumentSettings, ReadingSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.worker import Now, Threaded, Worker
from bench.base import EquipmentError
from drivers.chamber import SafeStep
from drivers.clock import Clock, WallClock
from drivers.errors import DriverError, LinkError
from drivers.instrument import Instrument, plausible

Values = list[tuple[float, str, float]]
"""Bench time [s], channel and value of what was read."""
TICK_S = 1.0
"""Time between two looks [s]."""
PATIENCE_S = 5.0
"""What an answer may need beyond the time-outs of the requests of a job before its thread counts as stuck [s]."""


@dataclass
class _Open:
    """One instrument that is open."""

    settings: InstrumentSettings
    driver: Instrument
    worker: Worker
    link: Link
    identity: str = ""
    due_s: dict[str, float] = field(default_factory=dict)
    """When each channel is read next [s]."""
    job: Future[Values] | None = None
    asked_s: float = 0.0
    """When the job was given [s]."""


class Instruments:
    """All instruments of a run. `latest` is the newest value of each channel."""

    def __init__(self, chosen: Sequence[InstrumentSettings], clock: Clock, journal: Journal, stack: ExitStack) -> None:
        """Open and identify; DriverError for one that is not there and not optional. `stack` closes them."""
        self.latest: dict[str, Signal] = {}
        self.commanded = False
        """Whether something was set or switched on."""
        self._clock, self._journal = clock, journal
        self._open: list[_Open] = []
        self._noted: dict[str, str] = {}
        for settings in chosen:
            driver = settings.open()
            worker = worker_of(settings, own_thread=isinstance(clock, WallClock))
            stack.callback(worker.close, driver.close)
            link = Link(f"instrument {settings.name}", settings.link, journal.event)
            one = _Open(settings, driver, worker, link, due_s=dict.fromkeys(_channels(settings), clock.now() + TICK_S))
            try:
                one.identity = one.worker.do(settings.identify, driver)
            except LinkError as error:
                if not settings.optional:
                    raise
                self._noted[settings.name] = f"{error}; it is optional, the run goes on without it"
            self._open.append(one)

    @property
    def channels(self) -> tuple[str, ...]:
        """What is measured."""
        return tuple(channel for one in self._open for channel in _channels(one.settings))

    def unit_switch(self) -> UnitSwitch | None:
        """What switches the units' power; None: there is no such instrument."""
        return next((UnitSwitch(one) for one in self._open if one.settings.powers_units), None)

    def start(self) -> None:
        """Make the settings, switch on what is to be on, read each back, and read every value once.

        What is set already is left alone. Raises DriverError when an instrument does not obey or answer; the silence
        of an optional one is noted.
        """
        for one in self._open:
            settings = one.settings
            self._tell(one)
            try:
                on = settings.switch[0] if settings.powers_units else settings.on
                for setting in (*settings.set, *filter(None, [on])):
                    self.commanded = True
                    if not one.worker.do(one.driver.is_set, setting):
                        one.worker.do(one.driver.set, setting)
                        text = f"{settings.name}: {setting.what}, read back"
                        self._journal.event("instrument", text, instrument=settings.name)
                self._keep(one.worker.do(self._read, one.driver, settings.read))
            except LinkError as error:
                if not settings.optional:
                    raise
                one.link.failed(self._clock.now(), str(error))

    def poll(self) -> None:
        """Ask for what is due and take in what was answered. EquipmentError when one that is not optional is lost."""
        for one in self._open:
            self._take(one)
            self._ask(one)
            self._take(one)  # in simulated time it was answered at once

    def safe(self) -> list[SafeStep]:
        """Switch off what has an `off` and is not to be left on; each read back. Never raises."""
        return [
            _switch_off(one.settings, one.worker, one.driver)
            for one in self._open
            if one.settings.off is not None and not one.settings.leave_on
        ]

    def _ask(self, one: _Open) -> None:
        now_s = self._clock.now()
        due = [reading for reading in one.settings.read if one.due_s[reading.channel] <= now_s + TICK_S / 2]
        if one.job is None and due and not one.worker.stuck and one.link.due(now_s):
            for reading in due:
                one.due_s[reading.channel] = max(one.due_s[reading.channel], now_s - TICK_S) + reading.period_s
            one.job, one.asked_s = one.worker.submit(self._read, one.driver, due), now_s

    def _read(self, driver: Instrument, due: Sequence[ReadingSettings]) -> Values:
        """In the thread of the instrument."""
        found: Values = []
        for reading in due:
            convert = reading.conversion()
            value = convert.factor * driver.read(reading) + convert.offset
            found.append((self._clock.now(), reading.channel, plausible(reading, value)))
        return found

    def _take(self, one: _Open) -> None:
        try:
            self._take_in(one)
        except EquipmentError:  # lost, which the link has told
            if not one.settings.optional:
                raise

    def _take_in(self, one: _Open) -> None:
        now_s = self._clock.now()
        if one.job is None or not one.job.done():
            if one.job is not None and now_s - one.asked_s > one.worker.patience_s:
                one.worker.give_up(one.job)
                one.link.gone(now_s, f"no answer within {one.worker.patience_s:g} s")
            one.link.judge(now_s)
            return
        job, one.job = one.job, None
        try:
            values = job.result()
        except DriverError as error:
            one.link.failed(now_s, str(error))
            return
        one.link.answered(now_s)
        self._keep(values)

    def _keep(self, values: Values) -> None:
        if values:
            self.latest |= {channel: Signal(value, t_s) for t_s, channel, value in values}
            self._journal.instrument(np.array(values, INSTRUMENT))

    def _tell(self, one: _Open) -> None:
        name = one.settings.name
        text = self._noted.get(name) or f"{name}: {one.identity or one.settings.address}"
        self._journal.event("instrument", text, instrument=name, identity=one.identity)


class UnitSwitch:
    """Switches the units' power by the instrument that they are on."""

    def __init__(self, instrument: _Open) -> None:
        self._instrument = instrument

    def switch(self, on: bool) -> None:
        """Switch the power and read it back; ReadBackError when it is not as it was told."""
        one = self._instrument
        one.worker.do(one.driver.set, one.settings.switch[0 if on else 1])


def switch_off(settings: StationSettings) -> list[SafeStep]:
    """The same as `Instruments.safe`, from outside, when the bench that opened them is gone; never raises."""
    steps = []
    for one in settings.instruments:
        if one.off is None or one.leave_on:
            continue
        try:
            driver = one.open()
        except DriverError as error:
            steps.append(SafeStep(f"{INSTRUMENT_STEP} {one.name}", False, str(error)))
            continue
        worker = worker_of(one)  # a library that never returns does not keep the chamber from being made safe
        steps.append(_switch_off(one, worker, driver))
        worker.close(driver.close)
    return steps


def worker_of(settings: InstrumentSettings, own_thread: bool = True) -> Worker:
    """What asks an instrument."""
    patience_s = (3 + len(settings.read)) * settings.timeout_s + PATIENCE_S
    return Worker(settings.name, Threaded(f"instrument {settings.name}") if own_thread else Now(), patience_s)


def _switch_off(settings: InstrumentSettings, worker: Worker, driver: Instrument) -> SafeStep:
    assert settings.off is not None
    what = f"{INSTRUMENT_STEP} {settings.name}"
    try:
        worker.do(driver.set, settings.off)
    except Exception as error:  # whatever it is, the other equipment still has to be made safe
        return SafeStep(what, False, str(error))
    return SafeStep(what, True, f"{settings.off.what}, read back")


def _channels(settings: InstrumentSettings) -> list[str]:
    return [reading.channel for reading in settings.read]
