"""The steps from a unit on the shelf to a certificate: each does one thing, and may be done again after any kill.

check       everything that can be known before anything moves
static      the isothermal run that the noise is read from, where the plan has one
run         the calibration run, raw rate
fit         the models, the effects that held-out data prove, the verdict against the limits
diagnose    what is left in doubt
flash       the calibration into the unit; one that is in force already is left
verify      another profile with the unit's own correction on, judged
certificate
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bench import deliver
from bench.acquisition import load_profile, refuse_errors
from bench.analysis import Limits, Model, load_limits
from bench.base import InputError
from bench.commands import acquisition, analysis
from bench.commands.calibration.doubts import decided, doubts, judged, verdict_of
from bench.commands.calibration.job import Case, Done, JobFile
from bench.commands.calibration.order import Order
from bench.commands.calibration.recording import AgainError, recorded
from bench.commands.ending_early import lot_of
from bench.commands.lots import complete_unit
from bench.commands.papers import Papers
from bench.deliver import lacking, load_instruments, refuse_overdue
from bench.record import CalibrationRecord, DiagnosisRecord, Manifest, RunFolder, UntilRecord, prove, put

if TYPE_CHECKING:
    from bench.acquisition import StationSettings

IMPROVED = "model-improved.yaml"
"""The model that the walk of `improve` ended with, in the run folder."""
_GIVE = (
    "give a file with {content} in the plan or the station file (`{kind}:`), or fill in the page 'Laboratory and "
    "equipment'"
)


class Step(Protocol):
    """One step. It reads what earlier ones left in the job file, and may be called again after it was cut off."""

    @property
    def name(self) -> str:
        """As it stands in the job file."""

    def do(self, order: Order, job: JobFile) -> Done:
        """Do it. BenchError or DriverError: it is not done; AgainError: an earlier one must be repeated."""


@dataclass(frozen=True)
class Check:
    """Files, equipment, both profiles rehearsed on the station, software."""

    name: str = "check"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        warnings = check_order(order)
        cases = [Case("warnings", text="; ".join(warnings))]
        many = "1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
        return Done(f"plan, station and equipment agree, {many}", {"warnings": warnings}, cases)


def check_order(order: Order) -> list[str]:
    """Warnings about a plan for a unit on a station; InputError where it cannot be carried out."""
    plan = order.plan
    station = acquisition.station_of(order.station_file())
    unit = station.chosen([order.serial])[0]
    limits = check_files(order, unit.channels)
    if unit.identity is None and not any(map(str.isdigit, order.serial)):
        raise InputError(f"unit '{order.serial}' has no number for its image; give its `identity`", order.station)
    warnings = check_papers(order, station)
    until = load_profile(order.document(plan.profile)).until
    if plan.certificate and until is not None and until.lot is not None:
        raise InputError(
            f"certificate: a run that ends early by its lot ({plan.profile}, `until`) gets none, which rests on the "
            "unit's own rows: set `certificate: false`, or leave `until` out of the profile",
            order.path,
        )
    late: list[str] = []
    for name in order.profiles():
        fitted = name == plan.profile
        profile = load_profile(order.document(name))
        acquisition.refuse_wrong(station, profile)
        checked = acquisition.check_on(profile, station, limits if fitted else None, fitted)
        refuse_errors(checked.findings)
        late += [segment.name for segment in checked.late]
        warnings += [f"{Path(name).name}: {finding.text}" for finding in checked.findings if finding.level == "warning"]
    if late:
        raise InputError(f"segments of the profiles would fail on this station: {', '.join(late)}", order.path)
    return warnings


def check_files(order: Order, channels: Collection[str] | None = None) -> Limits:
    """The limits of a plan; InputError where what it names cannot be used on any station, or for a unit that has these
    `channels`.
    """
    order.refuse_same()
    for model in order.plan.models:
        if why := deliver.undeliverable(order.load_model(model), channels=channels):
            raise InputError(f"model '{model}': {why}", order.path)
    return load_limits(order.document(order.plan.limits))


def check_papers(order: Order, station: StationSettings) -> list[str]:
    """Warnings; InputError for what would make the certificate impossible after a day of measurement."""
    papers = order.papers().over(Papers.of_station(station))
    warnings = []
    if order.plan.certificate:
        deliver.require_typst()
        for lack in lacking(papers.laboratory, papers.equipment, order.path, _GIVE):
            raise lack.error("a plan with `certificate: false` calibrates without one")
        if not station.simulated and deliver.signer_of(None, None, False) is None:
            warnings.append("the certificate will not be signed: this bench has no key of the laboratory")
    if papers.equipment is None:
        return [*warnings, "no equipment in the plan: the results are not metrologically traceable"]
    refuse_overdue(load_instruments(papers.equipment), datetime.now(UTC).date(), papers.equipment.file)
    return warnings


@dataclass(frozen=True)
class Static:
    """The isothermal run that the noise is read from, where the plan wants one."""

    name: str = "static"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        if order.plan.static is None:
            return Done("not in the plan", {"run": None}, [Case("static", skipped=True, text="not in the plan")])
        run = recorded(order, job, self.name, order.plan.static, "off", texts(order))
        took_s = run.manifest().duration_s
        return Done(f"{took_s / 3600:.2f} h at one temperature", {"run": run.path.name, "duration_s": took_s})


@dataclass(frozen=True)
class Run:
    """The calibration run: raw rate over the profile."""

    name: str = "run"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        run = recorded(order, job, self.name, order.plan.profile, "off", texts(order))
        manifest = run.manifest()
        lost = manifest.losses.get("lost", 0)
        sentence = f"{manifest.rows} rows in {manifest.duration_s / 3600:.2f} h, {lost} samples lost"
        facts = {"run": run.path.name, "rows": manifest.rows, "duration_s": manifest.duration_s, "lost": lost}
        return Done(sentence + ("; went on after an interruption" if len(run.parts()) > 1 else ""), facts)


def texts(order: Order) -> dict[str, str]:
    """Files of the plan that its run folders keep."""
    plan = order.plan
    kept = {"limits.yaml": order.document(plan.limits).text, "plan.yaml": order.documents[order.path].text}
    kept |= order.papers().texts()
    models = {analysis.model_file(i): order.load_model(name).to_yaml() for i, name in enumerate(plan.models)}
    return kept | models


def run_of(job: JobFile, step: str = "run") -> Path:
    """Run folder of a step that is done."""
    return job.folder.parent / str(job.facts(step)["run"])


def static_of(job: JobFile) -> Path | None:
    """Run folder of the isothermal run; None for a plan without one."""
    return run_of(job, "static") if job.facts("static").get("run") else None


@dataclass(frozen=True)
class Fit:
    """Models, effects proven on held-out data, verdict against the limits."""

    name: str = "fit"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        folder = run_of(job)
        models = [order.load_model(name) for name in order.plan.models]
        limits = load_limits(order.document(order.plan.limits))
        steps: list[dict[str, Any]] = []
        early = stopped(folder)
        if order.plan.improve and early is None:
            improved, steps = _walk(folder, models[0], static_of(job))
            if improved is not None:
                models.append(improved)
                put(folder, {IMPROVED: improved.to_yaml().encode()}, [Manifest.FILE])
        reported = analysis.report_on(RunFolder(folder), models, None, static=static_of(job), limits=limits)
        if not reported.analysis.admissible:
            raise AgainError("run", "the parts of the run do not fit together, or too much of it was left out")
        content = reported.analysis.to_json()
        word = str(content["limits"]["verdict"])
        refuse_pieces(RunFolder(folder), word, "run")
        hold, stop = verdict_of(word, order.plan.policy, "the calibration run")
        keys = ("model", "rms_dph", "held_out_rms_dph", "held_out_by", "floor_dph", "uncompensated_rms_dph")
        facts = {**{key: content[key] for key in keys}, "limits": word, "steps": steps}
        held = content["held_out_rms_dph"]
        sentence = f"{word}: {content['model']}, held-out {'-' if held is None else f'{held:.4f}'} deg/h"
        if early is not None:
            made = complete_unit(early, folder, order.out)
            put(made.run, {name: text.encode() for name, text in texts(order).items()})
            facts |= {"record": made.run.name, "lot": made.lot, "expected_dph": made.error_dph}
            sentence += f"; ended early: by lot {made.lot} {made.error_dph:.4f} deg/h expected over its whole run"
        return Done(sentence, facts, judged(content["limits"]), word, hold, stop)


def stopped(run: Path) -> Path | None:
    """Run folder of the lot that ended a run early, and that its calibration rests on; None for a whole run."""
    record, known = UntilRecord.find(run), lot_of(run)
    return known[0] if record is not None and known is not None and record.outcome == "stopped" else None


def calibration_of(job: JobFile) -> Path:
    """Folder of the calibration that the fit left: of its own beside the run, or the run's."""
    record = job.facts("fit").get("record")
    return run_of(job) if record is None else job.folder.parent / str(record)


def _walk(folder: Path, model: Model, static: Path | None) -> tuple[Model | None, list[dict[str, Any]]]:
    """The model with what it lacked (None: nothing was added), and the decisions on the way."""
    from bench.analysis import improve

    seconds, still = analysis.recovered([folder]), analysis.recovered([static] if static else [])
    (data,), calm = analysis.usual_means(seconds), analysis.usual_means(still)
    floor_dph = analysis.floor_of(seconds, data.interval_s, still)
    # A unit's memory holds effects of the catalogue, and no formula.
    found = improve([data], (), model, static=calm[0] if calm else None, floor_dph=floor_dph, formulas=False)
    steps = []
    for step in found.steps:
        suspects = {s.effect: s for s in step.diagnosis.suspects}
        alike = suspects[step.effect].look_alikes if step.effect in suspects else ()
        steps.append({"action": step.action, "effect": step.effect, "look_alikes": list(alike), "text": step.sentence})
    added = any(step["action"] == "added" for step in steps)
    return (found.model if added else None), steps


@dataclass(frozen=True)
class Diagnose:
    """What is left in doubt, against the plan's policy."""

    name: str = "diagnose"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        folder = run_of(job)
        diagnosis, calibration = DiagnosisRecord.find(folder), CalibrationRecord.read(folder)
        unmade = [text for text in calibration.verdict.warnings if text.startswith("not diagnosed")]
        added = [step for step in _delivered(calibration, job) if step["action"] == "added"]
        found = list(doubts(diagnosis, "; ".join(unmade).removeprefix("not diagnosed: "), added))
        cases, hold, stop = decided(found, order.plan.policy)
        sentence = "; ".join(doubt.sentence for doubt in found) or "nothing is left in doubt"
        facts = {"verdict": None if diagnosis is None else diagnosis.verdict,
                 "model": None if diagnosis is None else diagnosis.model,
                 "doubts": [{"kind": doubt.kind, "text": doubt.sentence} for doubt in found]}  # fmt: skip
        return Done(sentence, facts, cases, None, hold, stop)


def _delivered(calibration: CalibrationRecord, job: JobFile) -> list[dict[str, Any]]:
    """The walk's steps where the model that it ended with is the one delivered."""
    fitted = calibration.calibration
    effects = [] if fitted is None else [entry.effect for entry in fitted.model.effects]
    return [step for step in job.facts("fit")["steps"] if step["effect"] in effects]


@dataclass(frozen=True)
class Flash:
    """The calibration into the unit, read back, in force."""

    name: str = "flash"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        from bench.commands.flashing import FlashOptions, flash

        options = FlashOptions(run=calibration_of(job), form=order.plan.form)
        flashed = flash(order.serial, order.station_file(), options, order.out, order.quiet)
        keys = ("calibration_id", "form", "bank", "crc", "coefficient_set")
        facts = {key: flashed.record.get(key) for key in keys}
        how = "was in the unit already" if flashed.already_there else "written into the unit"
        return Done(f"calibration {flashed.calibration_id} {how}", facts)


@dataclass(frozen=True)
class Verify:
    """Another profile with the unit's own correction on, judged against the limits."""

    name: str = "verify"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        from bench.analysis import verify

        inside = in_the_unit(order)
        if inside["calibration_id"] != job.facts("flash")["calibration_id"]:
            raise AgainError("flash", f"the unit holds calibration {inside['calibration_id']}")
        prove(run_of(job))
        run = recorded(order, job, self.name, order.plan.verification, "on", texts(order))
        found = verify(run, run_of(job), load_limits(order.document(order.plan.limits)), inside)
        content, word = found.to_json(), found.verdict.value
        refuse_pieces(run, word, self.name)
        hold, stop = verdict_of(word, order.plan.policy, "the verification")
        known = ("rms_dph", "factor", "turning_factor", "floor_dph", "over_floor")
        facts = {"run": run.path.name, **{key: content[key] for key in known}}
        cases, sentence = judged(content["limits"]), f"{word}: {facts['rms_dph']:.4f} deg/h RMS of its own output"
        ratio = f"{found.over_floor:.2f} x its noise floor" if np.isfinite(found.over_floor) else ""
        sentence = ", ".join(filter(None, (sentence, ratio, found.change.words)))
        return Done(sentence, facts, cases, word, hold, stop)


def refuse_pieces(run: RunFolder, word: str, step: str) -> None:
    """AgainError where a run that was interrupted does not pass: its unit is judged by a whole one."""
    if word in {"FAIL", "INVALID"} and len(run.parts()) > 1:
        text = f"the run was interrupted, and its parts together are {word}: they say nothing of the unit"
        raise AgainError(step, text)


def in_the_unit(order: Order) -> dict[str, Any]:
    """The calibration that is in force in the unit, read over its bus."""
    from bench.commands.flash_record import newest_record
    from bench.commands.flashing import in_unit

    settings = acquisition.station_of(order.station_file())
    unit = settings.chosen([order.serial])[0]
    return in_unit(settings, unit, newest_record(order.out, order.serial), order.out)


@dataclass(frozen=True)
class Certify:
    """The certificate, where the plan wants one."""

    name: str = "certificate"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        from bench.commands.certifying import CertificateOptions, certificate

        if not order.plan.certificate:
            return Done("not wanted by the plan", {"pdf": None}, [Case("certificate", skipped=True, text="not wanted")])
        plan, options = order.plan, CertificateOptions(verifications=(run_of(job, "verify"),))
        facts = certificate(calibration_of(job), options, job.folder / "certificate.pdf").facts
        word = facts["verdict"]
        hold, stop = verdict_of(word or "PASS", plan.policy, "the certificate")
        kept = {"pdf": "certificate.pdf", "number": facts["number"], "signer": facts["signer"]}
        return Done(f"{facts['number']}: {word}", kept, (), word, hold, stop)


STEPS: tuple[Step, ...] = (Check(), Static(), Run(), Fit(), Diagnose(), Flash(), Verify(), Certify())
"""Of a single gyro."""
STEP_NAMES = tuple(step.name for step in STEPS)
