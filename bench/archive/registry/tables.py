"""The tables. Times are ISO 8601 text in UTC, as in the manifests, so that every database sorts them equally."""

from __future__ import annotations

from datetime import date
from typing import Any, ClassVar

from sqlalchemy import JSON, BigInteger, Double, ForeignKey, Index, MetaData, String
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

NAMES = {
    "ix": "ix_%(column_0_label)s",
    "uq": "uq_%(table_name)s_%(column_0_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}
"""Every constraint has a name, so that a migration can change it on any database."""


class Table(DeclarativeBase):
    """Base of all tables."""

    metadata = MetaData(naming_convention=NAMES)
    type_annotation_map: ClassVar[dict[Any, Any]] = {float: Double()}


class Archive(Table):
    """A folder of run folders, identified by the id in its ledger, so that it may be moved."""

    __tablename__ = "archives"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    path: Mapped[str]
    """host:folder of its last use."""


class Unit(Table):
    """A gyro; `archive` is the one that recorded its lot last, or registered it first."""

    __tablename__ = "units"
    serial: Mapped[str] = mapped_column(primary_key=True)
    lot: Mapped[str | None] = mapped_column(index=True)
    archive: Mapped[str] = mapped_column(ForeignKey("archives.id"))


class Operator(Table):
    """A person who runs the bench."""

    __tablename__ = "operators"
    name: Mapped[str] = mapped_column(primary_key=True)
    archive: Mapped[str] = mapped_column(ForeignKey("archives.id"))


class Equipment(Table):
    """An instrument (chamber, sensor, rate table, time base) with the dates of its own calibration."""

    __tablename__ = "equipment"
    name: Mapped[str] = mapped_column(primary_key=True)
    serial: Mapped[str] = mapped_column(primary_key=True)
    kind: Mapped[str]
    calibrated_on: Mapped[date | None]
    due_on: Mapped[date | None]
    archive: Mapped[str] = mapped_column(ForeignKey("archives.id"))


class Run(Table):
    """One run folder; `id` is archive/path, with the path relative to the archive."""

    __tablename__ = "runs"
    id: Mapped[str] = mapped_column(primary_key=True)
    archive: Mapped[str] = mapped_column(ForeignKey("archives.id"), index=True)
    path: Mapped[str]
    unit: Mapped[str] = mapped_column(ForeignKey("units.serial"), index=True)
    profile: Mapped[str | None]
    profile_sha256: Mapped[str | None] = mapped_column(String(64))
    station: Mapped[str | None] = mapped_column(index=True)
    operator: Mapped[str | None] = mapped_column(ForeignKey("operators.name"))
    created: Mapped[str | None] = mapped_column(index=True)
    state: Mapped[str | None]
    cause: Mapped[str | None]
    simulated: Mapped[bool | None]
    corrected: Mapped[bool | None]
    """Whether the unit corrected its rate itself: such a run verifies, and nothing is fitted to it."""
    samples: Mapped[int | None] = mapped_column(BigInteger)
    lost: Mapped[int | None] = mapped_column(BigInteger)
    duration_s: Mapped[float | None]
    software: Mapped[str | None]
    manifest_sha256: Mapped[str] = mapped_column(String(64))
    seen: Mapped[int | None]
    """Line of the ledger in which the run was first seen: the order of runs, whatever clocks said."""


class Calibration(Table):
    """The calibration.json of a run: verdict, model, validity, and a hash that is equal for equal coefficients."""

    __tablename__ = "calibrations"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    verdict: Mapped[str | None]
    """Verdict of the analysis on the model."""
    judged: Mapped[str | None]
    """PASS, MARGINAL, FAIL or INVALID against the limits of limits.json."""
    limits: Mapped[str | None]
    model: Mapped[str | None]
    coefficients_sha256: Mapped[str | None] = mapped_column(String(64), index=True)
    validity: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    file_sha256: Mapped[str] = mapped_column(String(64))


class Diagnosed(Table):
    """The diagnosis.json of a run: what a model of it lacks."""

    __tablename__ = "diagnoses"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    model: Mapped[str]
    verdict: Mapped[str]
    lacks: Mapped[str]
    """Effects that are missing and that unseen data prove, by name, with commas between them; else empty."""
    file_sha256: Mapped[str] = mapped_column(String(64))


class Certificate(Table):
    """The certificate.json of a run: number, verdict against limits (PASS, MARGINAL, FAIL, INVALID), file hash."""

    __tablename__ = "certificates"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    number: Mapped[str | None]
    verdict: Mapped[str | None]
    issued: Mapped[str | None]
    operator: Mapped[str | None]
    file_sha256: Mapped[str] = mapped_column(String(64))


class Issue(Table):
    """A certificate that was issued from a run, the newest or an earlier one; `amends` is the one that it replaces."""

    __tablename__ = "issues"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    number: Mapped[str] = mapped_column(primary_key=True)
    verdict: Mapped[str | None]
    issued: Mapped[str | None]
    amends: Mapped[str | None]
    reason: Mapped[str | None]
    file_sha256: Mapped[str] = mapped_column(String(64))


class Withdrawal(Table):
    """A certificate that was withdrawn."""

    __tablename__ = "withdrawals"
    number: Mapped[str] = mapped_column(primary_key=True)
    reason: Mapped[str]
    utc: Mapped[str]
    archive: Mapped[str] = mapped_column(ForeignKey("archives.id"))


class Quantity(Table):
    """A number that describes a unit, from limits.json of its run, its certificate, or its calibration."""

    __tablename__ = "quantities"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    name: Mapped[str] = mapped_column(primary_key=True)
    unit: Mapped[str | None]
    value: Mapped[float]


class Summary(Table):
    """A unit in the list of units; it follows from the other tables and is made anew whenever they change."""

    __tablename__ = "summaries"
    __table_args__ = (
        Index("ix_summaries_last", "last", "serial", "standing", "words"),
        Index("ix_summaries_standing", "standing", "serial", "words"),
    )
    serial: Mapped[str] = mapped_column(primary_key=True)
    lot: Mapped[str | None]
    words: Mapped[str]
    """What a search looks through, in small letters."""
    standing: Mapped[str]
    """pass or fail by the newest judged run, unjudged where none was judged, uncalibrated where none was analysed."""
    runs: Mapped[int]
    calibrations: Mapped[int]
    last: Mapped[str | None]
    last_run: Mapped[str | None]
    state: Mapped[str | None]
    station: Mapped[str | None]
    calibrated: Mapped[str | None]
    model: Mapped[str | None]
    judged: Mapped[str | None]
    certificate: Mapped[str | None]
    unjudged: Mapped[str | None]
    """Path of the newest run where it is newer than the newest judged one and was not judged."""


IN_ORDER: tuple[type[Table], ...] = (
    Archive, Unit, Operator, Equipment, Withdrawal, Run, Calibration, Diagnosed, Certificate, Issue, Quantity,
)  # fmt: skip
"""All tables but `Summary`, each after the tables to which it refers."""

OF_A_RUN: tuple[type[Table], ...] = (Calibration, Diagnosed, Certificate, Issue, Quantity)
"""Tables whose rows belong to one run."""
