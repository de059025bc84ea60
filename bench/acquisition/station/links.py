"""The link to a device: ok, degraded, lost, by how long the device has been silent.

A silent device is asked again after 1, 2, 4, … s, one question at a time, so that the loop of the run is never held up
for longer than the link's own timeout allows. A chamber that answers again is identified again, and what it does is
compared with what it was told: the controller may have been switched off, or somebody may have turned its knob.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

from bench.acquisition.station.settings.link import LinkSettings
from bench.base import EquipmentError
from drivers.chamber import Chamber, ChamberReading
from drivers.clock import Clock
from drivers.controller import NOT_NOW
from drivers.errors import LinkError, RefusedError

State = Literal["ok", "degraded", "lost"]
TICK_S = 1.0
"""Bench time between two commands of a ramp that is stepped from here [s]."""
MOST_STEP_S = 5.0
"""Such a ramp moves by no more than this much time at once [s]: after an outage it does not jump."""
SAME_DEGC = 0.2
"""Set points this near to each other are the same; controllers display tenths."""


class Link:
    """State of the link to one device; every change is reported with its numbers."""

    def __init__(self, device: str, settings: LinkSettings, report: Callable[..., None]) -> None:
        """`report(kind, text, **facts)` takes the events."""
        self.state: State = "ok"
        self._device, self._settings, self._report = device, settings, report
        self._silent_since: float | None = None
        self._next_s = 0.0
        self._attempts = 0
        self._why = ""

    @property
    def failing(self) -> bool:
        """Whether the device did not answer when it was asked last."""
        return self._silent_since is not None

    def silent_s(self, now_s: float) -> float:
        """How long the device has not answered [s]."""
        return 0.0 if self._silent_since is None else now_s - self._silent_since

    def due(self, now_s: float) -> bool:
        """Whether it is time to ask the device (again)."""
        return not self.failing or now_s >= self._next_s

    def failed(self, now_s: float, why: str) -> None:
        """The device was asked and did not answer."""
        if self._silent_since is None:
            self._silent_since, self._attempts = now_s, 0
            self._report("link", f"{self._device} does not answer: {why}", device=self._device, state=self.state)
        self._attempts += 1
        self._why = why
        last_s = self._silent_since + self._settings.lost_after_s  # nothing is lost that was not asked once more
        next_s = now_s + min(2.0 ** min(self._attempts - 1, 10), self._settings.retry_most_s)
        self._next_s = min(next_s, last_s) if last_s > now_s else next_s
        self.judge(now_s)

    def gone(self, now_s: float, why: str) -> None:
        """The device says itself that it will not come back. Raises EquipmentError."""
        self._silent_since = now_s if self._silent_since is None else self._silent_since
        if self.state != "lost":
            self._why = why
            self._enter("lost", self.silent_s(now_s))
        raise EquipmentError(f"{self._device} is lost: {self._why}")

    def judge(self, now_s: float) -> None:
        """Let the silence grow old. Raises EquipmentError when it means that the device is lost."""
        silent_s = self.silent_s(now_s)
        if self.state == "ok" and silent_s >= self._settings.degraded_after_s:
            self._enter("degraded", silent_s)
        if self.state != "lost" and silent_s >= self._settings.lost_after_s:
            self._enter("lost", silent_s)
        if self.state == "lost":
            raise EquipmentError(f"{self._device} link lost for {silent_s:.0f} s: {self._why}")

    def answered(self, now_s: float, found: str = "") -> None:
        """The device answers; after a silence, `found` says what was made sure of.

        Raises EquipmentError when the policy is not to go on after it was degraded.
        """
        if self._silent_since is None:
            return
        silent_s, before = self.silent_s(now_s), self.state
        text = f"{self._device} answers again after {silent_s:.1f} s and {self._attempts} attempts"
        facts: dict[str, Any] = {"device": self._device, "state": "ok", "silent_s": round(silent_s, 3)}
        self._report("link", f"{text}; {found}" if found else text, **facts, attempts=self._attempts)
        self._silent_since, self.state = None, "ok"
        if before != "ok" and self._settings.on_return == "abort":
            raise EquipmentError(f"{text}; the station file says on_return: abort")

    def _enter(self, state: State, silent_s: float) -> None:
        text = f"{self._device} {state}: silent for {silent_s:.1f} s, {self._attempts} attempts: {self._why}"
        facts: dict[str, Any] = {"device": self._device, "state": state, "silent_s": round(silent_s, 3)}
        self._report("link", text, **facts, attempts=self._attempts)
        self.state = state


class ChamberLink:
    """Polls and commands a chamber over a link that may fail."""

    def __init__(self, chamber: Chamber, clock: Clock, settings: LinkSettings, report: Callable[..., None]) -> None:
        self.link = Link("chamber", settings, report)
        self.deviations: tuple[str, ...] = ()
        """What the chamber was found to do after a silence that it was not told; asked again until it is gone."""
        self._chamber, self._clock = chamber, clock
        self._unconfirmed: float | None = None

    def poll(self) -> ChamberReading | None:
        """A reading; None while the chamber does not answer. EquipmentError when it is lost."""
        if not self.link.due(self._clock.now()):
            self.link.judge(self._clock.now())
            return None
        try:
            found = self._recognise() if self.link.failing else ""
            if self.deviations:
                self.deviations = tuple(self._chamber.deviations())
            reading = self._chamber.poll()
        except (LinkError, RefusedError) as error:
            self._failed(error)
            return None
        self.link.answered(self._clock.now(), found)
        return reading

    def set_point(self, target: float) -> bool:
        """Command a set point [degC]; False when it has to be commanded again later."""
        return self._command(lambda: self._chamber.set_point(target), target)

    def ramp_to(self, target: float, rate: float) -> bool:
        """Command a ramp of the controller's own to `target` [degC] at `rate` [degC/min]; False as above."""
        return self._command(lambda: self._chamber.ramp_to(target, rate), target)

    def way_to(self, target: float, rate: float | None, here: float) -> Callable[[], bool]:
        """What to call before each tick to get to `target` [degC], until it returns True: nothing is left to command.

        `rate` [degC/min]; None: a jump. The controller's own ramp and a jump are commanded once; a link that fails
        makes that be tried again. Without a ramp of its own the controller gets a new set point every tick, from the
        one that was commanded last, or from `here` [degC].
        """
        if rate is None:
            return lambda: self.set_point(target)
        if self._chamber.native_ramp:
            return lambda: self.ramp_to(target, rate)
        start = self._chamber.commanded
        return self._steps(target, rate, here if start is None else start)

    def _steps(self, target: float, rate: float, at_degc: float) -> Callable[[], bool]:
        at_s = self._clock.now() - TICK_S

        def step() -> bool:
            nonlocal at_degc, at_s
            now_s = self._clock.now()
            reach = rate / 60.0 * min(now_s - at_s, MOST_STEP_S)
            distance = target - at_degc
            following = target if reach >= abs(distance) else at_degc + math.copysign(reach, distance)
            if not self.set_point(following):
                return False
            at_degc, at_s = following, now_s
            return at_degc == target

        return step

    def _command(self, action: Callable[[], None], target: float) -> bool:
        if self.link.failing:
            return False
        try:
            action()
        except (LinkError, RefusedError) as error:
            self._unconfirmed = target
            self._failed(error)
            return False
        self._unconfirmed = None
        return True

    def _recognise(self) -> str:
        """After a silence: still the same equipment, and does it do what it was told?"""
        identity = self._chamber.identify()
        sent = self._unconfirmed
        if sent is not None and abs(self._chamber.poll().setpoint - sent) <= SAME_DEGC:
            self._chamber.set_point(sent)  # our last command arrived, only its confirmation did not: it is ours
        self._unconfirmed = None
        self.deviations = tuple(self._chamber.deviations())
        return f"{identity.model}, {'; '.join(self.deviations) or 'set point and mode are ours'}"

    def _failed(self, error: LinkError | RefusedError) -> None:
        if isinstance(error, RefusedError) and error.code not in NOT_NOW:
            raise error
        self.link.failed(self._clock.now(), str(error))
