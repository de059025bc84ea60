"""A program that the station file names: started without a shell, ended with what it started."""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from drivers.errors import ConfigError
from drivers.system import end_group

_LAST_LINE = 200


class Program:
    """One start of a program; `close` ends it where it goes on."""

    def __init__(
        self,
        argv: Sequence[str],
        folder: Path,
        timeout_s: float,
        source: IO[bytes] | int = subprocess.DEVNULL,
        output: IO[bytes] | int = subprocess.DEVNULL,
    ) -> None:
        """`folder` is where it is started, `timeout_s` its longest time. ConfigError where it cannot be started."""
        self.code: int | None = None
        """Exit code after it has ended, negative for a signal; None: it took too long and was ended."""
        self.last_line = ""
        """The last line of its standard error."""
        self._until_s = time.monotonic() + timeout_s
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        try:
            self._process = subprocess.Popen(
                argv, stdin=source, stdout=output, stderr=self._said, cwd=folder, start_new_session=True
            )
        except (OSError, ValueError) as error:
            self._said.close()
            raise ConfigError(f"cannot be started in {folder}: {getattr(error, 'strerror', None) or error}") from None

    @property
    def ended(self) -> bool:
        """Whether it has ended, or has taken too long and is ended now."""
        if self._process.poll() is None and time.monotonic() < self._until_s:
            return False
        self.wait()
        return True

    def wait(self) -> None:
        """Wait until it has ended, no longer than it may take."""
        try:
            self.code = self._process.wait(max(0.0, self._until_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            pass
        else:
            self._said.seek(0)
            lines = [line.strip() for line in self._said.read().decode("utf-8", "replace").splitlines() if line.strip()]
            self.last_line = "".join(sign for sign in lines[-1] if sign.isprintable())[:_LAST_LINE] if lines else ""
        self.close()

    def close(self) -> None:
        """End it, with what it started."""
        if self._process.poll() is None:
            end_group(self._process)
            self._process.wait()
        self._said.close()
