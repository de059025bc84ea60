"""Live display of a run: segment, temperatures, sample rate, losses, time left; plain lines when not a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from bench import acquisition
from bench.acquisition import time_left
from bench.base import clock, in_own, say

REFRESH_WALL_S = 0.25
PLAIN_LINE_WALL_S = 15.0


class Progress:
    """Context manager; call it with (station, status) at every tick."""

    def __init__(self, profile: acquisition.Profile, quiet: bool = False, notice: Callable[[], str] = str) -> None:
        self._notice = notice
        self._nominal_s = profile.duration_s
        self._console = Console(stderr=True)
        self._quiet = quiet
        self._live: Live | None = None
        self._shown_wall_s = -1e9
        self._seen: tuple[int, tuple[str, ...]] = (-1, ())
        self._started_wall_s = time.monotonic()

    def __enter__(self) -> Progress:
        if self._console.is_terminal and not self._quiet:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, station: acquisition.Station, status: acquisition.Status) -> None:
        """Show one tick; cheap when it is not yet time to draw."""
        now_s = time.monotonic()
        if self._quiet:
            return
        if self._live is not None:
            if now_s - self._shown_wall_s >= REFRESH_WALL_S:
                self._shown_wall_s = now_s
                self._live.update(self._table(station, status), refresh=True)
        elif self._news(status) or now_s - self._shown_wall_s >= PLAIN_LINE_WALL_S:
            self._shown_wall_s = now_s
            print(self._line(station, status), file=sys.stderr, flush=True)

    def _news(self, status: acquisition.Status) -> bool:
        """Whether another segment has begun, or something else holds the run than before."""
        # Behind the colon a guard has its value, which changes.
        now = status.leg.index, tuple(text.partition(":")[0] for text in status.holding)
        new, self._seen = now != self._seen, now
        return new

    def left_s(self, status: acquisition.Status) -> float:
        """Bench time left [s]: the nominal rest of the profile, late by as much as this leg already is."""
        return time_left(status, self._nominal_s)[1]

    def _line(self, station: acquisition.Station, status: acquisition.Status) -> str:
        losses = station.losses()
        line = say(
            "progress.line", time=clock(status.t_s), n=status.leg.index + 1, of=status.legs, segment=status.leg.name,
            chamber=f"{status.reading.temperature:.1f}", units=_units_text(station, status),
            received=losses["received"], lost=losses["lost"], left=clock(self.left_s(status)),
        )  # fmt: skip
        return line + (say("progress.held", who=", ".join(map(in_own, status.holding))) if status.holding else "")

    def _table(self, station: acquisition.Station, status: acquisition.Status) -> Table:
        losses = station.losses()
        wall_s = max(time.monotonic() - self._started_wall_s, 1e-3)
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim")
        grid.add_column()
        grid.add_row(say("progress.segment"), f"{status.leg.index + 1}/{status.legs}  {status.leg.name}")
        grid.add_row("", ProgressBar(total=max(self._nominal_s, 1.0), completed=status.t_s, width=50))
        left = say("progress.left", time=clock(status.t_s), left=clock(self.left_s(status)))
        grid.add_row(say("progress.time"), left)
        now, wanted = f"{status.reading.temperature:7.2f}", f"{status.reading.setpoint:7.2f}"
        grid.add_row(say("progress.chamber"), say("progress.chamber_now", now=now, set=wanted))
        for name, text in _unit_rows(station, status):
            grid.add_row(name, text)
        rate, speed = f"{losses['received'] / max(status.t_s, 1.0):.0f}", f"{status.t_s / wall_s:.0f}"
        counts = {name: losses[name] for name in ("received", "lost", "corrupt")}
        grid.add_row(say("progress.frames"), say("progress.frames_now", rate=rate, speed=speed, **counts))
        if status.holding:
            grid.add_row(say("progress.hold"), ", ".join(map(in_own, status.holding)))
        if notice := self._notice():
            grid.add_row(say("progress.keys"), notice)
        return grid


def _units_text(station: acquisition.Station, status: acquisition.Status) -> str:
    """Temperature of the unit, or the span of several, and how many have left."""
    if len(station.everyone) == 1:
        return say("progress.unit_at", degc=f"{status.unit_degc:.2f}")
    degc = [unit.temperature.value for unit in station.units if unit.temperature is not None]
    span = say("progress.unknown")
    if degc:
        span = say("progress.span", low=f"{min(degc):.2f}", high=f"{max(degc):.2f}")
    serials = ", ".join(gone.unit.serial for gone in station.dropped)
    gone = say("progress.gone", serials=serials) if station.dropped else ""
    return say("progress.units_at", n=len(station.units), span=span, gone=gone)


def _unit_rows(station: acquisition.Station, status: acquisition.Status) -> Iterator[tuple[str, str]]:
    """A row for each unit: its temperature and losses, or why it has left."""
    if len(station.everyone) == 1:
        yield say("progress.unit"), say("progress.degc", degc=f"{status.unit_degc:7.2f}")
        return
    reasons = {gone.unit.serial: gone.reason for gone in station.dropped}
    for unit in station.everyone:
        degc = "      -" if unit.temperature is None else f"{unit.temperature.value:7.2f}"
        losses = unit.decoder.losses
        text = say("progress.unit_frames", degc=degc, received=losses.received, lost=losses.lost)
        yield (
            unit.serial,
            say("progress.unit_left", reason=in_own(reasons[unit.serial])) if unit.serial in reasons else text,
        )
