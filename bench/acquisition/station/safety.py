"""The safe state of a station, for the run that ends and for the watchdog that outlives it.

Set point to ambient, warmed up first where it is cold inside so that nothing frosts, then off; every step limited in
time, read back, and tried again for a while where the chamber does not answer. Where nothing can be read back, each
command is sent all the same, and the chamber counts as not verified. Nothing here raises.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.acquisition.profile.legs import Leg
from bench.acquisition.station.settings.safety import SafeStateSettings
from bench.acquisition.station.settings.station import StationSettings
from drivers.backoff import BackOff
from drivers.chamber import Chamber, ChamberReading, SafeStep
from drivers.clock import Clock

Event = tuple[str, str, dict[str, Any]]
"""Kind, text and numbers of an event."""

HOME = "return to ambient"
"""Name of the leg that takes a chamber there."""
RETRY = BackOff(first_s=1.0, most_s=10.0)
INSTRUMENT = "instrument"
"""What the steps of instruments begin with."""
LOOK_S = 1.0
"""Time between two looks at a chamber that warms up [s]."""


def home_leg(settings: StationSettings, legs: Sequence[Leg], from_degc: float) -> Leg | None:
    """The way back to ambient, no faster than the profile moves the chamber in that direction; None: no time for it."""
    safe, to_degc = settings.safe_state, settings.ambient_degc
    if safe.warm_up_min == 0.0:
        return None
    direction = "heating" if to_degc > from_degc else "cooling"
    rates = [leg.rate_degc_per_min for leg in legs if leg.direction == direction and leg.rate_degc_per_min]
    return Leg(
        index=len(legs),
        name=HOME,
        kind="ramp",
        from_degc=from_degc,
        target_degc=to_degc,
        timeout_s=60.0 * safe.warm_up_min,
        nominal_start_s=legs[-1].nominal_end_s,
        nominal_s=0.0,
        rate_degc_per_min=max(rates, default=None),
        arrival_band_degc=safe.near_degc,
    )


@dataclass
class SafeState:
    """The way to the safe state of one station; `make()` goes it."""

    chamber: Chamber
    clock: Clock
    settings: SafeStateSettings
    ambient_degc: float
    retry_s: float
    """A chamber that does not answer is tried again for this long [s]."""
    stop_moving: Callable[[], list[SafeStep]] = list
    """Quick stop of a rate table and of the axes of a fixture, verified."""
    switch_off: Callable[[], list[SafeStep]] = list
    """Switches instruments off, verified."""
    beat: Callable[[], None] = lambda: None
    """Called before every step: the heartbeat that a watchdog listens to."""
    hurry: Callable[[], bool] = lambda: False
    """Whether somebody wants it now: then nothing is waited for any more."""
    report: Callable[..., None] = lambda kind, text, **facts: None
    """Takes events: kind, text, numbers."""
    _warmed: bool = field(default=False, init=False)

    def make(self) -> list[SafeStep]:
        """Go there; the steps of the last attempt, each verified or not."""
        until_s, failures = self.clock.now() + self.retry_s, 0
        moving = self.stop_moving()  # takes a second, and what turns does more harm than what is warm
        self.beat()
        off = self.switch_off()
        while True:
            self.beat()
            self._warm_up()
            steps = self.chamber.safe(self.ambient_degc, self.settings.step_s)
            if not all(step.ok for step in moving):
                moving = self.stop_moving()
            if not all(step.ok for step in off):
                off = self.switch_off()
            failed = [step for step in (*moving, *off, *steps) if not step.ok]
            if not failed or self.clock.now() >= until_s or self.hurry():
                break
            failures += 1
            if failures == 1:
                text = f"not reached yet, trying again for {self.retry_s:.0f} s: {_listed(failed)}"
                self.report("safe_state", text)
            self._wait(RETRY.wait_s(failures), until_s)
        every = [*moving, *off, *steps]
        tell(every, self.report)
        return every

    def _wait(self, wait_s: float, until_s: float) -> None:
        """Wait in small pieces, alive and ready to be hurried."""
        end_s = min(self.clock.now() + wait_s, until_s)
        while self.clock.now() < end_s and not self.hurry():
            self.beat()
            self.clock.sleep_until(min(self.clock.now() + LOOK_S, end_s))

    def _warm_up(self) -> None:
        """Let a cold chamber come near ambient, for as long as it answers and can be trusted; never twice."""
        if self._warmed or self.settings.warm_up_min == 0.0:
            return
        try:
            self.chamber.identify()
            reading = self.chamber.poll()
            if not self._cold(reading):
                return
            self.chamber.set_point(self.ambient_degc)
            from_degc, since_s = reading.temperature, self.clock.now()
            limit_s = 60.0 * self.settings.warm_up_min
            self.report("safe_state", f"{from_degc:.1f} degC inside: warming up before it is switched off")
            while self._cold(reading) and self.clock.now() - since_s < limit_s and not self.hurry():
                self.beat()
                self.clock.sleep_until(self.clock.now() + LOOK_S)
                reading = self.chamber.poll()
        except Exception:  # what cannot be read or commanded is not waited for, and off is still to come
            return
        self._warmed = True
        took_s = self.clock.now() - since_s
        text = f"warmed up from {from_degc:.1f} to {reading.temperature:.1f} degC in {took_s:.0f} s"
        self.report("safe_state", text, ok=not self._cold(reading))

    def _cold(self, reading: ChamberReading) -> bool:
        """Cold enough to frost, in a chamber that is on and shows nothing that speaks against heating."""
        sound = reading.on and not reading.alarm and not reading.door and not reading.sensor_break
        return sound and reading.temperature < self.ambient_degc - self.settings.near_degc


def tell(steps: Sequence[SafeStep], report: Callable[..., None]) -> None:
    """Each step as an event."""
    for step in steps:
        sent = {"sent": True} if step.sent else {}
        report("safe_state", f"{step.what}: {step.detail}", ok=step.ok, **sent)


def failures(steps: list[SafeStep]) -> str:
    """What could not be verified, and what to do; empty when all was."""
    failed = [step for step in steps if not step.ok]
    if not failed:
        return ""
    moving = {what: [step for step in failed if step.what.startswith(what)] for what in ("rate table", "fixture axis")}
    instruments = [step.what for step in failed if step.what.startswith(INSTRUMENT)]
    orders = [f"press the emergency stop of the {what}" for what, steps in moving.items() if steps]
    orders += [f"switch {', '.join(instruments)} off by hand"] if instruments else []
    others = len(failed) - len(instruments) - sum(map(len, moving.values()))
    orders += ["switch the chamber off by hand"] if others else []
    return f"SAFE STATE NOT VERIFIED: {_listed(failed)}; {' and '.join(orders)}"


def _listed(steps: Sequence[SafeStep]) -> str:
    """The steps with what became of them; a reason that several share is given once."""
    shared: dict[str, list[str]] = {}
    for step in steps:
        shared.setdefault(step.detail, []).append(f"{step.what} (sent)" if step.sent else step.what)
    return "; ".join(f"{', '.join(names)}: {detail}" for detail, names in shared.items())
