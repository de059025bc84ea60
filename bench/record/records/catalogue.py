"""All kinds of records, for their schemas and their documentation."""

from __future__ import annotations

from bench.record.records.calibration import CalibrationRecord
from bench.record.records.centre import ElsewhereRecord, EntryRecord
from bench.record.records.certificate import CertificateRecord
from bench.record.records.chain import ChainRecord
from bench.record.records.comparison import ComparisonRecord
from bench.record.records.diagnosis import DiagnosisRecord
from bench.record.records.flash import FlashRecord
from bench.record.records.imu import ImuRecord, ImuVerificationRecord
from bench.record.records.job import JobRecord
from bench.record.records.judged import LimitsRecord, VerificationRecord
from bench.record.records.lot import LotRecord
from bench.record.records.manifest import Manifest
from bench.record.records.notes import NotesRecord
from bench.record.records.start import StartRecord
from bench.record.records.stored import Record
from bench.record.records.until import UntilRecord

RECORDS: tuple[type[Record], ...] = (
    ChainRecord,
    Manifest,
    ComparisonRecord,
    DiagnosisRecord,
    CalibrationRecord,
    LimitsRecord,
    VerificationRecord,
    FlashRecord,
    CertificateRecord,
    JobRecord,
    LotRecord,
    ImuRecord,
    ImuVerificationRecord,
    NotesRecord,
    StartRecord,
    UntilRecord,
    EntryRecord,
    ElsewhereRecord,
)
"""In the order in which a unit's work makes them."""
