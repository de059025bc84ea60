"""How a run of a test ended: its state, what was lost, what happened, and its record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import api, base, record
from bench.base import BenchError


@dataclass(frozen=True, repr=False)
class Outcome:
    """A run that has ended."""

    folder: Path
    """Its run folder."""
    state: str
    """done, aborted (by a guard), failed (equipment), or refused (nothing was recorded)."""
    cause: str
    """Why it ended so."""
    exit_code: int
    """What `bench run` would end with."""
    losses: Mapping[str, int]
    """Frames by what happened to them: received, lost, corrupt, repeated, late, …"""
    left_out: tuple[str, ...]
    """Why samples that were received are not in the record, with their number."""
    events: tuple[dict[str, Any], ...]
    """What happened, in order: `t_s`, `kind`, `text`."""

    @classmethod
    def of(cls, run: record.RunFolder, error: BenchError | None) -> Outcome:
        """From the run folder."""
        code, text = (0, "") if error is None else (error.exit_code, str(error))
        try:
            told = run.manifest()
        except base.InputError as missing:
            return cls(run.path, "refused", text or str(missing), code or missing.exit_code, {}, (), ())
        out = tuple(f"{one.why}: {one.samples} samples" for one in told.left_out)
        return cls(run.path, told.state, text or told.cause, code, told.losses, out, tuple(run.events()))

    @property
    def done(self) -> bool:
        """Whether the profile was run to its end."""
        return self.state == "done"

    def record(self, interval_s: float = 2.0) -> api.Run:
        """The record as means over so many seconds: `fit`, `compare`, `diagnose`, `to_dataframe`."""
        return api.open(self.folder, interval_s=interval_s)

    def __repr__(self) -> str:
        lost = ", ".join(f"{name} {count}" for name, count in self.losses.items() if count)
        text = f"{self.state}, exit code {self.exit_code}: {self.cause or 'end of profile'}; {lost or 'no frames'}"
        return f"<Outcome {'; '.join((text, *self.left_out))}>"
