"""Brings the units into the attitudes of the legs: asks for each, takes the answer, and looks at gravity.

Before a leg with another attitude the run holds until somebody confirms that the units stand so, as any hold is
released; or until a program of the laboratory or the drives of the fixture have turned it. The accelerometers of each
unit then have to show gravity where it should be; where they do not, the run holds again and says what they show. Who
confirms the same twice is believed: outputs may be swapped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bench.acquisition.station.records import Journal
from bench.acquisition.station.settings.fixture import FixtureSettings
from bench.acquisition.station.turning_axes import FixtureAxes
from bench.acquisition.station.turning_program import TurningProgram
from bench.base import FloatArray, InputError
from bench.record import ATTITUDES, WRONG_DEG, nearest_attitude, off_deg
from drivers.clock import Clock
from drivers.rate_table import SafeStep

if TYPE_CHECKING:
    from bench.acquisition.station.unit import LiveUnit

LOOK_S = 3.0
"""After this time all that was captured before the confirmation is through [s]; gravity is then the mean of a tick."""
SIMULATED = "the simulated operator"


class Fixture:
    """The fixture of a station during a run."""

    def __init__(
        self,
        settings: FixtureSettings,
        clock: Clock,
        journal: Journal,
        units: Sequence[LiveUnit] = (),
        turn: Callable[[FloatArray], None] | None = None,
        axes: FixtureAxes | None = None,
    ) -> None:
        """`units`: those in it now. `turn` turns a simulated fixture, `axes` are its drives."""
        self.attitude: str | None = None
        """The one that was confirmed last."""
        self.heading_deg = 0.0
        """By how much it is turned against its heading with its name [deg]."""
        self.waiting = ""
        """What is waited for, for people; empty: nothing."""
        self._settings, self._clock, self._journal, self._units, self._turn = settings, clock, journal, units, turn
        self._asked, self._by, self._changes = "", "", 0
        self._heading_deg = 0.0
        self._ready_s = self._looks_s = np.inf
        self._seen: FloatArray | None = None
        self._program: TurningProgram | None = None
        self._axes, self._moves = axes, False

    def ask(self, attitude: str) -> None:
        """Ask for an attitude."""
        self._asked, self._seen, self._changes = attitude, None, self._changes + 1
        if self._axes is not None:
            if (to := self._settings.position(attitude)) is None:
                raise InputError(f"the axes of the fixture do not reach {attitude}")
            self._axes.go(to)
            self._moves, self._heading_deg = True, to.heading_deg
            self.waiting = f"the fixture, which its drives turn to {attitude}"
            return
        if not self._settings.turn:
            self._request("")
            return
        self.close()
        self._program = TurningProgram(self._settings, ATTITUDES[attitude])
        self.waiting = f"the fixture, which its program turns to {attitude}"

    def poll(self) -> None:
        """See what its drives say, where it has such; EquipmentError or DriverError when one has failed."""
        if self._axes is not None:
            self._axes.poll()

    def safe(self) -> list[SafeStep]:
        """Stop its drives, verified; nothing to do without."""
        return [] if self._axes is None else self._axes.safe()

    def close(self) -> None:
        """End the program, if it is turning."""
        if self._program is not None:
            self._program.end()
            self._program = None

    def confirm(self, who: str) -> None:
        """Somebody says that the units stand as was asked; nothing happens without a question, or while it turns."""
        if not self.waiting or self._looks_s < np.inf or self._program is not None or self._moves:
            return
        forgotten = who == SIMULATED and self._seen is None and self._changes in self._settings.forgets
        if self._turn is not None and not forgotten:
            self._turn(ATTITUDES[self._asked].matrix)
        self._by, self._ready_s, self._looks_s = who, np.inf, self._clock.now() + LOOK_S
        self.waiting = f"gravity, looked at in {self._asked}"

    def tick(self) -> None:
        """Once a tick, after the units were heard."""
        if not self.waiting:
            return
        now_s = self._clock.now()
        forces = {unit.serial: unit.force() for unit in self._units}  # a mean since the last tick
        if self._moves and self._axes is not None:
            if self._axes.arrived:
                self._moves = False
                self.confirm(self._settings.driven)
        elif self._program is not None:
            self._turned(self._program)
        elif now_s >= self._ready_s:
            self.confirm(SIMULATED)
        elif now_s >= self._looks_s:
            self._look({serial: force for serial, force in forces.items() if force is not None})

    def _turned(self, program: TurningProgram) -> None:
        """Go on where the program has ended well; else ask people."""
        if not program.ended:
            return
        self._program = None
        if not program.trouble:
            self.confirm(self._settings.driven)
            return
        text = f"the fixture's program for {self._asked}: {program.trouble}"
        self._journal.event("attitude", text, asked=self._asked)
        self._request(text)

    def _look(self, forces: dict[str, FloatArray]) -> None:
        if not all(np.isfinite(force).all() for force in forces.values()):
            return  # not heard within this tick
        up = ATTITUDES[self._asked].matrix[:, 2]
        off = {serial: float(off_deg(up, force)) for serial, force in forces.items()}
        worst = max(off, key=lambda serial: off[serial], default="")
        self._looks_s = np.inf
        if worst and off[worst] > WRONG_DEG and not self._insisted(forces[worst]):
            self._seen = forces[worst]
            like = nearest_attitude(self._seen).name
            text = f"gravity of unit {worst}, {off[worst]:.0f} deg from where {self._asked} has it, as in {like}"
            self._journal.event("attitude", text, unit=worst, asked=self._asked, like=like, off_deg=off[worst])
            self._request(text)
            return
        self.attitude, self.heading_deg, self.waiting = self._asked, self._heading_deg, ""
        told = f", gravity at most {off[worst]:.1f} deg off" if worst else ", unseen: no unit has three accelerometers"
        self._journal.event(
            "attitude", f"{self.attitude}, confirmed by {self._by}{told}", attitude=self.attitude, who=self._by,
            off_deg=off,
        )  # fmt: skip

    def _insisted(self, force: FloatArray) -> bool:
        """Whether the same was confirmed before."""
        return self._seen is not None and float(off_deg(self._seen / np.linalg.norm(self._seen), force)) < WRONG_DEG

    def _request(self, trouble: str) -> None:
        self.waiting = f"the fixture, to be turned to {self._asked}: confirm by going on"
        if trouble:
            self.waiting = f"{trouble}: turn the fixture and go on, or go on to measure as it is"
        if self._settings.operator == "simulated":
            self._ready_s = self._clock.now() + self._settings.takes_s
