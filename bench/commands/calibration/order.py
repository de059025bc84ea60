"""A plan for one unit on one station: what the steps are given."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.base import InputError, load_config, read_text, read_yaml
from bench.commands.calibration.plan import Plan


@dataclass(frozen=True)
class Order:
    """A plan for one unit: everything that the steps need to know."""

    plan: Plan
    path: Path
    station: Path | None
    serial: str
    out: Path
    quiet: bool = False

    @classmethod
    def load(cls, path: Path, station: Path | None, serial: str, out: Path, quiet: bool = False) -> Order:
        """Read the plan; InputError where it, or a file that it names, is wrong or missing."""
        order = cls(load_config(path, Plan), path, station, serial, out, quiet)
        for file in order.files():
            read_text(file)
        return order

    def file(self, name: str) -> Path:
        """A file that the plan names."""
        return self.path.parent / name

    def model(self, name: str) -> str | Path:
        """A model that the plan names: a file beside it, or a name."""
        beside = self.file(name)
        return beside if beside.is_file() else name

    def files(self) -> Iterator[Path]:
        """The plan and all files behind it."""
        plan = self.plan
        yield self.path
        if self.station is not None:
            yield self.station
        yield from (self.file(name) for name in (plan.profile, plan.verification, plan.limits))
        yield from (self.file(name) for name in (plan.laboratory, plan.equipment) if name is not None)
        yield from (Path(model) for model in map(self.model, plan.models) if isinstance(model, Path))

    def digest(self) -> str:
        """SHA-256 of the unit and of all files: another plan is another job."""
        texts = [self.serial, *(read_text(file) for file in self.files())]
        return hashlib.sha256("\0".join(texts).encode()).hexdigest()

    def refuse_same(self) -> None:
        """InputError where fit and verification would be the same profile: that proves nothing."""
        first, second = (self.file(name) for name in (self.plan.profile, self.plan.verification))
        if read_yaml(first).content.get("segments") == read_yaml(second).content.get("segments"):
            raise InputError("verification has the segments of the calibration run: take another profile", self.path)
