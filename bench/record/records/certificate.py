"""certificate.json: the facts of a certificate, as they are attached to its PDF."""

from __future__ import annotations

from typing import Any, ClassVar

from bench.record.records.calibration import StoredQuantity
from bench.record.records.judged import Verdict
from bench.record.records.stored import Record


class CertificateRecord(Record):
    """What a printed certificate says. `bench certificate` writes its text, whose hash is the certificate's number."""

    FILE: ClassVar[str] = "certificate.json"
    TITLE: ClassVar[str] = "certificate"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json", "calibration.json")
    ADVICE: ClassVar[str] = "make it again with `bench certificate`"

    number: str
    title: str | None = None
    simulated: bool | None = None
    draft: tuple[str, ...] | None = None
    """What it lacks; a draft is not a certificate."""
    amends: dict[str, str | None] | None = None
    """Number, day, hash and reason of the certificate that it replaces."""
    issued: str | None = None
    verdict: Verdict | None = None
    operator: str | None = None
    item: dict[str, Any] | None = None
    calibrated: str | None = None
    verified: str | None = None
    results: tuple[StoredQuantity, ...] = ()
    chain: dict[str, Any] | None = None
    """SHA-256 of all files that it rests on."""
