"""The evidence for a certificate: run, calibration, verification and instruments, each refused where it is not valid.

Nothing is analysed again: the certificate repeats calibration.json, after a check that it was made from this data and
that the data were not altered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime
from pathlib import Path

import numpy as np

from bench.analysis import (
    MOST_EXTRAPOLATED,
    NEAR_RANGE,
    WIDEST_HOLE,
    Completeness,
    HeldOut,
    Judgement,
    Limits,
    Measurements,
    Quantity,
    Source,
    completeness,
    error_of,
    judge_limits,
    of_data,
    source_of,
)
from bench.base import FloatArray, InputError
from bench.deliver.certificate.combined import OF_TABLE, of_all, verified, with_table
from bench.deliver.certificate.laboratory import Instrument, refuse_overdue
from bench.deliver.export.delivering import calibration_id
from bench.record import (
    CalibrationRecord,
    Dataset,
    FlashRecord,
    Manifest,
    RunFolder,
    Verdict,
    VerificationRecord,
    averaged,
    load,
    prove,
    seconds_of,
)

LEAST_COVERED = 0.5
"""Share of the fitted range of temperature that the verification must cover."""


@dataclass(frozen=True)
class Coverage:
    """How much of the calibration's range of validity in temperature a verification covers."""

    share: float
    """Without the holes in its temperatures."""
    verified_degc: tuple[float, float]
    valid_degc: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Verification:
    """An independent run: its error, either of the unit's own corrected output or of the model applied to it."""

    run: RunFolder
    manifest: Manifest
    data: Dataset
    left: FloatArray
    """Bias that is left (n,) [deg/h]."""
    error: HeldOut
    in_unit: bool
    """The unit's own correction was on."""
    covered: Coverage
    verdict: Verdict | None
    """Verdict of `bench verify`; None where it has not judged the run."""
    done: Completeness
    """What of the run is there."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything on a certificate that does not come from the laboratory's own files."""

    run: RunFolder
    manifest: Manifest
    stored: CalibrationRecord
    source: Source
    verification: Verification | None
    judgement: Judgement | None
    instruments: tuple[Instrument, ...]
    done: Completeness
    """What of the calibration run is there."""
    flashed: FlashRecord | None = None
    """The record that `bench flash` wrote when it put the coefficients into the unit."""
    further: tuple[Verification, ...] = ()
    """Verification runs besides the first: further turn-ons."""

    @property
    def verifications(self) -> tuple[Verification, ...]:
        """All verification runs."""
        return (() if self.verification is None else (self.verification,)) + self.further

    @property
    def calibration_id(self) -> str:
        """The calibration's id as the unit's image holds it."""
        return f"0x{calibration_id(self.source):08X}"

    @property
    def verdict(self) -> Verdict | None:
        """The worse verdict of limits and verification; without limits only a FAIL of the verification counts."""
        verified = None if self.verification is None else self.verification.verdict
        if self.judgement is None:
            return verified if verified is Verdict.FAIL else None
        return max((self.judgement.verdict, verified or Verdict.PASS), key=list(Verdict).index)

    def quantities(self) -> tuple[Quantity, ...]:
        """Quantities of the run; where there is a verification, the error on unseen data comes from it."""
        known = {entry.name: Quantity.of(entry) for entry in self.stored.quantities or ()}
        known |= {quantity.name: quantity for quantity in of_data(self.done)}
        on = day(self.manifest)
        known |= {name: with_table(known[name], self.instruments, on) for name in OF_TABLE if name in known}
        if self.verification is not None:
            known |= {one.name: replace(one, in_verification=True) for one in verified(self.verification.error, known)}
            known |= {
                quantity.name: quantity for quantity in of_all([self.done, *(v.done for v in self.verifications)])
            }
        return tuple(known.values())


def gather(
    folder: Path, verifications: Sequence[Path], limits: Limits | None, instruments: tuple[Instrument, ...]
) -> Evidence:
    """The evidence for a certificate; InputError, one line, where no certificate may be made.

    The first verification is the one whose figures the certificate states; the others are further turn-ons.
    """
    run = RunFolder(folder)
    manifest = run.manifest()
    if manifest.of_lot:
        raise InputError("no certificate: it is calibrated by its lot; a certificate rests on a whole run", folder)
    prove(folder)
    source = source_of(folder)
    stored = CalibrationRecord.read(folder)
    if stored.quantities is None:
        raise InputError(f"an older bench wrote this file; {stored.ADVICE}", folder / stored.FILE)
    _refuse(folder, (*stored.refusals, *source.objections))
    _refuse_lost(run, manifest)
    _refuse_unlisted(run, manifest)
    done = _complete(run, manifest, limits)
    refuse_overdue(instruments, day(manifest), folder)
    if twice := [path for path in verifications if [p.resolve() for p in verifications].count(path.resolve()) > 1]:
        raise InputError("is given twice as a verification: each turn-on counts once", twice[0])
    verified = tuple(_verify(RunFolder(path), manifest, source, limits) for path in verifications)
    first, further = (verified[0] if verified else None), verified[1:]
    found = Evidence(run, manifest, stored, source, first, None, instruments, done, _flashed(run), further)
    for one in verified:
        refuse_overdue(instruments, day(one.manifest), one.run.path)
        if one.in_unit:
            _refuse(folder, _other_coefficients(found, one))
    if limits is None:
        return found
    measured = Measurements(load(folder, stored.averaging_s), source.fit) if limits.expressions else None
    judgement = judge_limits(limits, found.quantities(), measured=measured)
    # A required number that is missing makes the run INVALID, and an INVALID run gets no certificate.
    missing = [r for r in judgement.results if r.verdict == "INVALID"]
    _refuse(folder, [f"{r.quantity.name} is required by the limits: {r.quantity.reason}" for r in missing])
    return replace(found, judgement=judgement)


def day(manifest: Manifest) -> date:
    """The day of a run; InputError where its manifest has none."""
    try:
        return datetime.fromisoformat(manifest.created).date()
    except ValueError:
        raise InputError(
            f"run '{manifest.run}' has no date ({manifest.created!r}), so nothing proves that the "
            "instruments were calibrated on that day"
        ) from None


def _refuse(folder: Path, reasons: tuple[str, ...] | list[str]) -> None:
    if reasons:
        raise InputError(f"no certificate: {'; '.join(reasons)}", folder)


def _flashed(run: RunFolder) -> FlashRecord | None:
    record = FlashRecord.find(run.path)
    return record if record is not None and record.state == "done" else None


def _other_coefficients(evidence: Evidence, verified: Verification) -> list[str]:
    """Why a unit that corrected itself may have used other coefficients than those of this calibration."""
    flashed, own = evidence.flashed, evidence.calibration_id
    if flashed is None:
        return ["the unit corrected itself in the verification, and no flash.json says with which calibration"]
    if flashed.calibration_id != own:
        return [f"the unit was given calibration {flashed.calibration_id}, not this one, {own}: flash it first"]
    if flashed.coefficient_set is None:  # by a command: what `bench verify` read from the unit proves it
        judged = VerificationRecord.find(verified.run.path)
        held = None if judged is None else judged.in_unit.get("calibration_id")
        return [] if held == own else [f"the unit held calibration {held} when it was verified, not this one, {own}"]
    identity = verified.manifest.unit_identity
    used = identity.coefficient_set if identity else None
    if used != flashed.coefficient_set:
        return [f"the verification ran with coefficient set {used}, this calibration is {flashed.coefficient_set}"]
    return []


def _refuse_lost(run: RunFolder, manifest: Manifest) -> None:
    if not (run.path / "data.parquet").is_file():
        _refuse(run.path, ["data.parquet is missing"])
    if manifest.state != "done":
        _refuse(run.path, [f"the run is '{manifest.state}'; a certificate needs one that the bench completed"])


def _refuse_unlisted(run: RunFolder, manifest: Manifest) -> None:
    if not manifest.files:
        _refuse(run.path, ["the manifest names no files: nothing proves what was recorded"])


def _complete(run: RunFolder, manifest: Manifest, limits: Limits | None) -> Completeness:
    """What of a run is there; refused where too much is missing."""
    done = completeness(run, manifest, averaged(seconds_of(run.path), 1.0, whole=True))
    _refuse(run.path, tuple(done.lacking(() if limits is None else limits.quantities)))
    return done


def _verify(run: RunFolder, manifest: Manifest, source: Source, limits: Limits | None) -> Verification:
    """The verification run judged; refused where it is not independent, not whole, or of another unit."""
    theirs = run.manifest()
    if theirs.unit != manifest.unit:
        _refuse(run.path, [f"the verification is of unit {theirs.unit}, the run is of {manifest.unit}"])
    shared = set(theirs.files.items()) & set(manifest.files.items())
    data = sorted(name for name, _ in shared if name.endswith(".parquet") or name.startswith("journal"))
    if data or theirs.run in source.fit.runs:
        what = f" ({', '.join(data)})" if data else ""
        _refuse(run.path, [f"the verification shares data with the fit{what}: run another profile"])
    prove(run.path)
    _refuse_lost(run, theirs)
    _refuse_unlisted(run, theirs)
    failed = [segment.name for segment in theirs.segments if segment.outcome == "timeout"]
    _refuse(run.path, [f"segment '{name}' of the verification failed" for name in failed])
    verdict = _verdict_of(run.path)
    done = _complete(run, theirs, limits)
    record = load(run.path, source.dataset.interval_s)
    outside = float(source.fit.out_of_range(record, NEAR_RANGE).mean())
    if outside > MOST_EXTRAPOLATED:
        _refuse(run.path, [f"{outside:.0%} of the verification lie outside the calibration's range of validity"])
    covered = _coverage(record, source)
    if covered.share < LEAST_COVERED:
        own, whole = (f"{low:.1f} to {high:.1f}" for low, high in (covered.verified_degc, covered.valid_degc))
        what = f"{covered.share:.0%} of the calibration's range of temperature, {own} of {whole} degC"
        least = f"at least {LEAST_COVERED:.0%} are needed: verify with a wider profile"
        _refuse(run.path, [f"the verification covers only {what}, {least}"])
    in_unit = record.corrected
    left = record.bias if in_unit else record.bias - source.fit.predict(record).bias
    error = error_of("verification", (record,), (left,), outside)
    return Verification(run, theirs, record, left, error, in_unit, covered, verdict, done)


def _verdict_of(folder: Path) -> Verdict | None:
    """The verdict of `bench verify` on its run; refused where it is INVALID or cannot be read."""
    record = VerificationRecord.find(folder)
    if record is None:
        return None
    if record.verdict is Verdict.INVALID:
        reasons = record.refusals or (record.limits.refusals if record.limits else ())
        why = next(iter(reasons), "a required value does not exist")
        _refuse(folder, [f"the verification is INVALID: {why}; verify again"])
    return record.verdict


def _coverage(record: Dataset, source: Source) -> Coverage:
    fitted = source.dataset.channel("temperature")
    low, high = source.fit.validity.get("temperature", (float(np.nanmin(fitted)), float(np.nanmax(fitted))))
    values = record.channel("temperature")[np.isfinite(record.bias)]
    inside = np.sort(values[(values >= low) & (values <= high)])
    steps = np.diff(inside)
    share = float(steps[steps <= WIDEST_HOLE * (high - low)].sum()) / (high - low)
    return Coverage(share, (float(np.nanmin(values)), float(np.nanmax(values))), (low, high))
