"""A program of the laboratory that brings the fixture into an attitude: a driven table, a robot."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from bench.acquisition.station.settings.fixture import FixtureSettings
from bench.record import Attitude

_LAST_LINE = 200


class TurningProgram:
    """One start of the program, without a shell and beside the run, which goes on holding meanwhile."""

    def __init__(self, settings: FixtureSettings, attitude: Attitude) -> None:
        self._limit_s = time.monotonic() + settings.timeout_s
        self._timeout_s = settings.timeout_s
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `end`
        self._process: subprocess.Popen[bytes] | None = None
        self._failed = ""
        matrix = ",".join(f"{value:.12g}" for value in attitude.matrix.ravel())
        argv = [word.replace("{attitude}", attitude.name).replace("{matrix}", matrix) for word in settings.turn]
        folder = Path(settings.folder or ".")
        try:
            self._process = subprocess.Popen(
                argv, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._said, cwd=folder,
                start_new_session=True,
            )  # fmt: skip
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            self._failed = f"{argv[0]} cannot be started in {folder}: {why}"

    @property
    def ended(self) -> bool:
        """Whether it has ended, or has taken too long and is ended now."""
        if self._process is None:
            self.end()
            return True
        if self._process.poll() is None and time.monotonic() < self._limit_s:
            return False
        if self._process.returncode is None:
            self._failed = f"did not end within {self._timeout_s:g} s"
        elif self._process.returncode:
            self._said.seek(0)
            lines = self._said.read().decode("utf-8", "replace").strip().splitlines()
            last = "".join(sign for sign in lines[-1] if sign.isprintable())[:_LAST_LINE] if lines else "not a word"
            self._failed = f"ended with {self._process.returncode}: {last}"
        self.end()
        return True

    @property
    def trouble(self) -> str:
        """What went wrong, after it ended; empty: the units stand as was asked."""
        return self._failed

    def end(self) -> None:
        """End it, with what it started."""
        process, self._process = self._process, None
        if process is not None and process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._said.close()
