"""A verification run judged: the remaining error of a unit that corrects itself, against limits or its noise floor.

Nothing is fitted. The record is another one than the calibration's, of another profile, and its unit computed what it
sent: this is the error that its user will see.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis.diagnosis.compare import error_of
from bench.analysis.diagnosis.decision import bound_only
from bench.analysis.diagnosis.notes import bound_notes
from bench.analysis.diagnosis.scores import HeldOut
from bench.analysis.judging.change import Change, Figures
from bench.analysis.judging.completeness import Completeness, completeness
from bench.analysis.judging.expressed import Measurements
from bench.analysis.judging.limits import Limits, judge_limits
from bench.analysis.judging.quantities import level_of, of_data, over_floor
from bench.analysis.judging.quantity import Quantity
from bench.analysis.noise.floor import Floor, noise_floor
from bench.analysis.thresholds import VERIFIED_RATIO
from bench.base import Document, InputError, finite, read_yaml
from bench.record import CalibrationRecord, Dataset, RunFolder, Verdict, VerificationRecord, averaged, seconds_of, use

_NAMING = {"name", "description"}
_MEASURED = {
    "residual_rms_dph",
    "residual_peak_dph",
    "residual_over_floor",
    "samples_lost",
    "samples_missing_ppm",
    "longest_gap_s",
    "bias_max_dph",
    "bias_span_dph",
}


@dataclass(frozen=True)
class Verification:
    """What a verification found; its change is from the raw output of the calibration run, where that is known."""

    run: RunFolder
    change: Change
    error: HeldOut
    floor: Floor
    verdict: Verdict
    judged: Mapping[str, Any]
    done: Completeness
    """What of the run is there."""
    done_before: Completeness | None = None
    """What of the calibration run is there."""

    @property
    def over_floor(self) -> float:
        """Error over noise floor; NaN where that is not known, or an upper bound only."""
        known = not bound_only(self.floor.floor_dph, self.error.rms_dph)
        return self.error.rms_dph / self.floor.floor_dph if known else np.nan

    def to_json(self) -> dict[str, Any]:
        """What stands in verification.json."""
        manifest = self.run.manifest()
        return {
            "unit": manifest.unit,
            "run": manifest.run,
            "profile": manifest.profile,
            "created": manifest.created,
            "verdict": self.verdict.value,
            **self.change.to_json(),
            "rms_dph": self.error.rms_dph,
            "rms_interval_dph": [finite(end) for end in self.error.interval_dph],
            "floor_dph": finite(self.floor.floor_dph),
            "over_floor": finite(self.over_floor),
            "unit_identity": manifest.unit_identity.content() if manifest.unit_identity else None,
            "data": self.done.counts(),
            "calibration_data": self.done_before.counts() if self.done_before else None,
            **self.judged,
        }


def refuse_same_profile(profile: Document, calibration: Path | None) -> None:
    """InputError where the profile is the one that the calibration was fitted to, whatever it is called there."""
    if calibration is None:
        return
    known = calibration / "profile.yaml"
    use(calibration, known.name)
    if known.is_file() and _steps(read_yaml(known)) == _steps(profile):
        raise InputError(
            f"is the profile of the calibration run {known.parent.name}; verify with another one", profile.file
        )


def _steps(profile: Document) -> Any:
    """What a profile does: without comments, name and description."""
    content = profile.content
    return {k: v for k, v in content.items() if k not in _NAMING} if isinstance(content, dict) else content


def verify(run: RunFolder, calibration: Path | None, limits: Limits | None, serials: Mapping[str, Any]) -> Verification:
    """Judge a verification run and leave verification.json in its folder.

    `calibration` is the run that the unit's calibration was fitted to, for the figures before; `serials` goes into the
    file: what is in the unit. InputError for a run that is not a verification.
    """
    manifest = run.manifest()
    if manifest.purpose != "verification":
        raise InputError("is not a verification: its unit sent the raw rate; make one with `bench verify`", run.path)
    interval_s, raw, done_before = _before(calibration)
    seconds = seconds_of(run.path)
    data, done = averaged(seconds, interval_s), completeness(run, manifest, averaged(seconds, 1.0, whole=True))
    change = Change.between(raw, data)
    error = error_of("verification", (data,), (data.bias,))
    floor = noise_floor([averaged(seconds, 1.0)], interval_s)
    refusals = tuple(_refusals(done, done_before, () if limits is None else limits.quantities))
    quantities = tuple(replace(one, in_verification=True) for one in _quantities(done, error, Figures.of(data), floor))
    if limits is None:
        verdict, judged = by_floor(error, floor, refusals)
    else:
        own = tuple(limit for limit in limits.limits if limit.within(_MEASURED))
        if not own:
            raise InputError(
                f"limits {limits.name}: none is for a quantity of a verification: {', '.join(sorted(_MEASURED))}"
            )
        judgement = judge_limits(limits.model_copy(update={"limits": own}), quantities, refusals, Measurements(data))
        verdict, judged = judgement.verdict, {"limits": judgement.to_json()}
    content = {**judged, "in_unit": dict(serials), "calibration_run": None if calibration is None else str(calibration)}
    content["quantities"] = [quantity.to_json() for quantity in quantities]
    verification = Verification(run, change, error, floor, verdict, content, done, done_before)
    VerificationRecord.model_validate(verification.to_json()).write(run.path)
    return verification


def _refusals(done: Completeness, before: Completeness | None, limited: Collection[str]) -> Iterator[str]:
    """Why the run must not be judged: it or the calibration run has not ended, or lacks too much."""
    if not done.ended:
        failed = "".join(f", segment '{segment.name}' failed" for segment in done.failed)
        yield f"the run is '{done.state}': {done.cause}{failed}"
    yield from done.lacking(limited)
    if before is not None:
        yield from (f"calibration run: {reason}" for reason in before.lacking(limited))


def _before(calibration: Path | None) -> tuple[float, Dataset | None, Completeness | None]:
    """Averaging time [s] of the calibration, the raw output of its run, and what of that is there."""
    stored = None if calibration is None else CalibrationRecord.find(calibration)
    if calibration is None or stored is None:
        return 30.0, None, None
    run, seconds = RunFolder(calibration), seconds_of(calibration)
    done = completeness(run, run.manifest(), averaged(seconds, 1.0, whole=True))
    return stored.averaging_s, averaged(seconds, stored.averaging_s), done


def by_floor(error: HeldOut, floor: Floor, refusals: tuple[str, ...]) -> tuple[Verdict, dict[str, Any]]:
    """Without limits: the error must not be above `VERIFIED_RATIO` times the floor with certainty."""
    rule = f"RMS of the corrected rate at most {VERIFIED_RATIO:g} times the noise floor"
    rule += "; MARGINAL where only its 95 % interval reaches below"
    judged: dict[str, Any] = {"rule": rule, "refusals": list(refusals)}
    unknown = [floor.reason] if not np.isfinite(floor.floor_dph) else bound_notes(floor.floor_dph, error.rms_dph)
    if refusals or unknown:
        judged["refusals"] = list(refusals or unknown)
        return Verdict.INVALID, judged
    most = VERIFIED_RATIO * floor.floor_dph
    low = error.interval_dph[0]
    if error.rms_dph <= most:
        return Verdict.PASS, judged
    return (Verdict.MARGINAL if low <= most else Verdict.FAIL), judged


def _quantities(done: Completeness, error: HeldOut, after: Figures, floor: Floor) -> list[Quantity]:
    low, high = error.interval_dph
    noise = floor.noise
    white_dph = float(np.sqrt(noise.white_variance(after.interval_s))) if noise else floor.floor_dph
    return [
        Quantity("residual_rms_dph", error.rms_dph, low, high),
        Quantity.positive("residual_peak_dph", error.peak_dph, white_dph),
        over_floor(error, level_of(floor)),
        Quantity.expanded("bias_span_dph", after.span_dph, np.sqrt(2.0) * white_dph),
        Quantity.positive("bias_max_dph", after.peak_dph, white_dph),
        *(quantity for quantity in of_data(done) if quantity.name in _MEASURED),
    ]
