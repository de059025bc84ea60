"""Simulated time that a test lets pass: at once, or in the background while the program under test waits."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from bench import acquisition

if TYPE_CHECKING:
    from bench.testing.stations import BenchStation
    from drivers.clock import SimClock


class Passing:
    """Equipment whose time passes when a test says so."""

    def __init__(self, stage: acquisition.Stage, clock: SimClock) -> None:
        self._stage, self._clock = stage, clock

    @property
    def now_s(self) -> float:
        """Simulated time since the equipment was opened [s]."""
        return self._clock.now()

    def advance(self, seconds: float) -> None:
        """Let so much simulated time [s] pass, at once."""
        self._clock.sleep_until(self._clock.now() + seconds)

    @contextmanager
    def running(self, speed: float = 100.0) -> Iterator[None]:
        """Let simulated time pass at `speed` times wall time, in a thread, for programs that wait by themselves."""
        over = threading.Event()
        start_s = self._clock.now()

        def advance(_: float, to_s: float) -> None:
            self._clock.sleep_until(start_s + to_s)

        thread = threading.Thread(
            target=acquisition.keep_running, args=(advance, speed, over.is_set), name="simulated time"
        )
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


@contextmanager
def staged(station: BenchStation, *, units: bool) -> Iterator[tuple[acquisition.Stage, SimClock]]:
    """The equipment of a station with its own clock; without its units if nobody asks for them."""
    from drivers.clock import SimClock

    with ExitStack() as stack:
        chosen = station.settings.units if units else ()
        stage = stack.enter_context(
            acquisition.open_stage(station.settings, chosen, acquisition.Occasion(senders=station.senders))
        )
        clock = SimClock()
        clock.attach(stage.advance)
        yield stage, clock
