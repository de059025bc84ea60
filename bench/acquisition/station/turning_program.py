"""A program of the laboratory that brings the fixture into an attitude: a driven table, a robot."""

from __future__ import annotations

from pathlib import Path

from bench.acquisition.station.settings.fixture import FixtureSettings
from bench.record import Attitude
from drivers.errors import ConfigError
from drivers.program import Program


class TurningProgram:
    """One start of the program, beside the run, which goes on holding meanwhile."""

    def __init__(self, settings: FixtureSettings, attitude: Attitude) -> None:
        matrix = ",".join(f"{value:.12g}" for value in attitude.matrix.ravel())
        argv = [word.replace("{attitude}", attitude.name).replace("{matrix}", matrix) for word in settings.turn]
        self._timeout_s = settings.timeout_s
        self._program: Program | None = None
        self._failed = ""
        try:
            self._program = Program(argv, Path(settings.folder or "."), settings.timeout_s)
        except ConfigError as error:
            self._failed = f"{argv[0]} {error}"

    @property
    def ended(self) -> bool:
        """Whether it has ended, or has taken too long and is ended now."""
        return self._program is None or self._program.ended

    @property
    def trouble(self) -> str:
        """What went wrong, after it ended; empty: the units stand as was asked."""
        if self._program is None:
            return self._failed
        if self._program.code is None:
            return f"did not end within {self._timeout_s:g} s"
        return (
            f"ended with {self._program.code}: {self._program.last_line or 'not a word'}" if self._program.code else ""
        )

    def end(self) -> None:
        """End it, with what it started."""
        if self._program is not None:
            self._program.close()
