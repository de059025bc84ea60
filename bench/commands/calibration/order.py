"""A plan for one unit on one station: what the steps are given."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from bench.analysis import Model, load_model
from bench.base import BenchError, Document, InputError, library, load_config, read_yaml
from bench.commands.acquisition import station_file
from bench.commands.calibration.plan import Plan
from bench.commands.papers import Papers
from bench.commands.slots import seated


def named_by(plan: Path, name: str) -> Path:
    """A file that a plan names: beside it, else a shipped one, which a copy of a shipped plan names in the same way."""
    own, shipped = places(plan, name)
    return shipped if shipped.is_file() and not own.is_file() else own


def places(plan: Path, name: str) -> tuple[Path, Path]:
    """Where a file that a plan names may be."""
    return plan.parent / name, library() / "plans" / name


@dataclass
class Together:
    """Units whose run of a step is made at once, by serial number; `errors`: what ended it for each."""

    serials: tuple[str, ...]
    errors: Mapping[str, BenchError] = field(default_factory=dict)


@dataclass(frozen=True)
class Order:
    """A plan for one unit: everything that the steps need to know. Each file is read once, when the order is made."""

    plan: Plan
    path: Path
    station: Path | None
    documents: Mapping[Path, Document]
    """The plan and all files behind it."""
    serial: str
    out: Path
    quiet: bool = False
    operator: str = ""
    """Who works on it, if not the user of this process."""
    place: str = ""
    """Text of the station with this unit alone in its slot: the neighbours make no other job of it."""
    together: Together = field(default_factory=lambda: Together(()))

    @classmethod
    def load(cls, plan: Path | Document, station: Path | None, unit: str, out: Path, quiet: bool = False) -> Order:
        """Read the plan; InputError where it, or a file that it names, is wrong or missing.

        `unit` is a unit of the station, or a new one in the slot of one (`NEW@KNOWN`).
        """
        return cls.load_all(plan, station, [unit], out, quiet)[0]

    @classmethod
    def load_all(
        cls, plan: Path | Document, station: Path | None, units: Sequence[str], out: Path, quiet: bool = False
    ) -> list[Order]:
        """The same for several units of the station, each in its slot; InputError where one is named twice."""
        own = plan if isinstance(plan, Document) else read_yaml(plan)
        path = Path(own.file)
        order = cls(load_config(own, Plan), path, station, {path: own}, "", out, quiet)
        known = {file: read_yaml(file) for file in order.files() if file != path}
        free = known[station] if station else station_file(None)
        place, serials = seated(free, units)
        if twice := sorted({serial for serial in serials if serials.count(serial) > 1}):
            raise InputError(f"unit '{twice[0]}' is named twice: name each unit once")
        alone = [seated(free, [unit])[0] for unit in units]
        if serials != list(units):
            station = station or Path(free.file)
            known[station] = place
        order = replace(order, documents={path: own} | known, station=station)
        return [replace(order, serial=serial, place=one.text) for serial, one in zip(serials, alone, strict=True)]

    def file(self, name: str) -> Path:
        """A file that the plan names; one that appears beside it after they were read changes nothing."""
        read = [file for file in places(self.path, name) if file in self.documents]
        return read[0] if read else named_by(self.path, name)

    def document(self, name: str) -> Document:
        """A file that the plan names, as it was read."""
        return self.documents[self.file(name)]

    def profiles(self) -> list[str]:
        """The profiles that the plan names, in the order in which they are run."""
        plan = self.plan
        return [name for name in (plan.static, plan.profile, plan.verification) if name]

    def papers(self) -> Papers:
        """Laboratory and equipment that the plan names."""
        plan = self.plan
        named = (plan.laboratory, plan.equipment)
        return Papers(*(None if name is None else self.document(name) for name in named))

    def station_file(self) -> Document:
        """The station, as it was read."""
        return station_file(None) if self.station is None else self.documents[self.station]

    def model(self, name: str) -> str | Path:
        """A model that the plan names: a file beside it, or a name."""
        beside = self.file(name)
        return beside if beside.is_file() else name

    def load_model(self, name: str) -> Model:
        """The same, loaded."""
        wanted = self.model(name)
        return load_model(self.documents[wanted] if isinstance(wanted, Path) else wanted)

    def files(self) -> Iterator[Path]:
        """The plan and all files behind it."""
        plan = self.plan
        yield self.path
        if self.station is not None:
            yield self.station
        yield from (self.file(name) for name in (plan.profile, plan.verification, plan.limits))
        named = (plan.static, plan.laboratory, plan.equipment, plan.imu)
        yield from (self.file(name) for name in named if isinstance(name, str))
        yield from (Path(model) for model in map(self.model, plan.models) if isinstance(model, Path))

    def digest(self) -> str:
        """SHA-256 of the unit and of all files: another plan is another job."""
        files = (self.place if file == self.station else self.documents[file].text for file in self.files())
        texts = [self.serial, *files]
        return hashlib.sha256("\0".join(texts).encode()).hexdigest()

    def refuse_same(self) -> None:
        """InputError where fit and verification would be the same profile: that proves nothing."""
        first, second = (self.document(name).content for name in (self.plan.profile, self.plan.verification))
        if first.get("segments") == second.get("segments"):
            raise InputError("verification has the segments of the calibration run: take another profile", self.path)
