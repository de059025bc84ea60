"""What every result of a command can be asked."""

from __future__ import annotations

from pathlib import Path


class Result:
    """What a command did or found."""

    @property
    def exit_code(self) -> int:
        """0 done and within limits, 1 done and outside limits, 3 aborted, 4 equipment failed."""
        return 0

    @property
    def runs(self) -> tuple[Path, ...]:
        """Run folders that it made or analysed, for the registry."""
        return ()
