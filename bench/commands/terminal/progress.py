"""Live display of a run: segment, temperatures, sample rate, losses, time left; plain lines when not a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from bench.acquisition import time_left
from bench.base import clock

if TYPE_CHECKING:
    from bench.acquisition import Profile, Station, Status

REFRESH_WALL_S = 0.25
PLAIN_LINE_WALL_S = 15.0


class Progress:
    """Context manager; call it with (station, status) at every tick."""

    def __init__(self, profile: Profile, quiet: bool = False, notice: Callable[[], str] = str) -> None:
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

    def __call__(self, station: Station, status: Status) -> None:
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

    def _news(self, status: Status) -> bool:
        """Whether another segment has begun, or something else holds the run than before."""
        # Behind the colon a guard has its value, which changes.
        now = status.leg.index, tuple(text.partition(":")[0] for text in status.holding)
        new, self._seen = now != self._seen, now
        return new

    def left_s(self, status: Status) -> float:
        """Bench time left [s]: the nominal rest of the profile, late by as much as this leg already is."""
        return time_left(status, self._nominal_s)[1]

    def _line(self, station: Station, status: Status) -> str:
        losses = station.losses()
        return (
            f"[{clock(status.t_s)}] {status.leg.index + 1}/{status.legs} {status.leg.name}: "
            f"chamber {status.reading.temperature:.1f} degC, {_units_text(station, status)}, "
            f"{losses['received']} frames, {losses['lost']} lost, {clock(self.left_s(status))} left"
            f"{'; HELD by ' + ', '.join(status.holding) if status.holding else ''}"
        )

    def _table(self, station: Station, status: Status) -> Table:
        losses = station.losses()
        wall_s = max(time.monotonic() - self._started_wall_s, 1e-3)
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim")
        grid.add_column()
        grid.add_row("segment", f"{status.leg.index + 1}/{status.legs}  {status.leg.name}")
        grid.add_row("", ProgressBar(total=max(self._nominal_s, 1.0), completed=status.t_s, width=50))
        grid.add_row("time", f"{clock(status.t_s)}, {clock(self.left_s(status))} left")
        grid.add_row(
            "chamber", f"{status.reading.temperature:7.2f} degC   set point {status.reading.setpoint:7.2f} degC"
        )
        for name, text in _unit_rows(station, status):
            grid.add_row(name, text)
        grid.add_row(
            "frames",
            f"{losses['received']} received, {losses['lost']} lost, {losses['corrupt']} corrupt, "
            f"{losses['received'] / max(status.t_s, 1.0):.0f}/s of bench time, {status.t_s / wall_s:.0f} x real time",
        )
        if status.holding:
            grid.add_row("HOLD", ", ".join(status.holding))
        if notice := self._notice():
            grid.add_row("keys", notice)
        return grid


def _units_text(station: Station, status: Status) -> str:
    """Temperature of the unit, or the span of several, and how many have left."""
    if len(station.everyone) == 1:
        return f"unit {status.unit_degc:.2f} degC"
    degc = [unit.temperature.value for unit in station.units if unit.temperature is not None]
    span = f"{min(degc):.2f} to {max(degc):.2f} degC" if degc else "of unknown temperature"
    gone = f" ({', '.join(gone.unit.serial for gone in station.dropped)} left)" if station.dropped else ""
    return f"{len(station.units)} units {span}{gone}"


def _unit_rows(station: Station, status: Status) -> Iterator[tuple[str, str]]:
    """A row for each unit: its temperature and losses, or why it has left."""
    if len(station.everyone) == 1:
        yield "unit", f"{status.unit_degc:7.2f} degC"
        return
    reasons = {gone.unit.serial: gone.reason for gone in station.dropped}
    for unit in station.everyone:
        degc = "      -" if unit.temperature is None else f"{unit.temperature.value:7.2f}"
        losses = unit.decoder.losses
        text = f"{degc} degC   {losses.received} frames, {losses.lost} lost"
        yield unit.serial, f"left: {reasons[unit.serial]}" if unit.serial in reasons else text
