"""The steps that a whole inertial unit has in place of a single gyro's: fit, diagnose, verify, certificate.

fit         all axes from the run's attitudes and rates, as a folder beside the run: record, parameters, report
diagnose    what is wrong with outputs, fixture, place or an axis; what the run does not determine
verify      another profile, other positions or rates, judged; the unit sends its raw outputs
certificate
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.commands.calibration.doubts import Doubt, decided, judged, verdict_of
from bench.commands.calibration.job import Case, Done, JobFile
from bench.commands.calibration.order import Order
from bench.commands.calibration.recording import AgainError, recorded
from bench.commands.calibration.steps import calibration_of, in_the_unit, refuse_pieces, run_of, texts
from bench.commands.imu import imu, verify_imu
from bench.commands.papers import Papers
from bench.record import ImuRecord, put


def options_of(order: Order) -> Path | None:
    """File with the options of the fit; None for the usual ones."""
    return order.file(order.plan.imu) if isinstance(order.plan.imu, str) else None


@dataclass(frozen=True)
class FitImu:
    """All parameters of the unit over temperature."""

    name: str = "fit"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        run = run_of(job)
        folder = run.with_name(f"{run.name}_imu")
        made = imu([run], options_of(order), folder, order.serial)
        papers = order.papers().over(Papers.of_run(run)).texts()
        put(folder, {name: text.encode() for name, text in papers.items()})
        facts = {
            "record": folder.name,
            "findings": [f"{finding.where}: {finding.text}" for finding in made.findings],
            "undetermined": list(made.undetermined),
        }
        low, high = sorted(made.range_degc)
        return Done(f"{made.rows} rows from {low:.1f} to {high:.1f} degC, {len(made.findings)} findings", facts)


@dataclass(frozen=True)
class DiagnoseImu:
    """What is wrong, and what the run does not determine, against the plan's policy."""

    name: str = "diagnose"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        known = job.facts("fit")
        found = [Doubt("missing_effect", text) for text in known["findings"]]
        found += [Doubt("undecided", f"not determined: {text}") for text in known["undetermined"]]
        cases, hold, stop = decided(found, order.plan.policy)
        sentence = "; ".join(doubt.sentence for doubt in found) or "nothing is left in doubt"
        facts = {"doubts": [{"kind": doubt.kind, "text": doubt.sentence} for doubt in found]}
        return Done(sentence, facts, cases, None, hold, stop)


@dataclass(frozen=True)
class VerifyImu:
    """The calibration by other positions and rates than it was fitted to."""

    name: str = "verify"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        inside = in_the_unit(order)
        if inside["calibration_id"] != job.facts("flash")["calibration_id"]:
            raise AgainError("flash", f"the unit holds calibration {inside['calibration_id']}")
        run = recorded(order, job, self.name, order.plan.verification, "off", texts(order))
        limits = order.file(order.plan.limits)
        found = verify_imu([run.path], options_of(order), calibration_of(job), limits).verification
        refuse_pieces(run, found.verdict, self.name)
        hold, stop = verdict_of(found.verdict, order.plan.policy, "the verification")
        worst = max(found.axes, key=lambda axis: axis.over_floor)
        facts = {"run": run.path.name, "rows": found.rows, "worst": worst.name, "over_floor": worst.over_floor}
        sentence = f"{found.verdict}: {found.rows} rows of other positions or rates, {worst.name} at most "
        cases = [] if found.limits is None else judged(found.limits.content())
        return Done(f"{sentence}{worst.over_floor:.2f} x its noise floor", facts, cases, found.verdict, hold, stop)


@dataclass(frozen=True)
class CertifyImu:
    """The certificate, where the plan wants one."""

    name: str = "certificate"

    def do(self, order: Order, job: JobFile) -> Done:
        """See the protocol."""
        from bench.commands.certifying import CertificateOptions
        from bench.commands.imu_certifying import imu_certificate

        if not order.plan.certificate:
            return Done("not wanted by the plan", {"pdf": None}, [Case("certificate", skipped=True, text="not wanted")])
        made = imu_certificate(calibration_of(job), CertificateOptions(), job.folder / "certificate.pdf").facts
        unit = ImuRecord.of(calibration_of(job)).unit
        kept = {"pdf": "certificate.pdf", "number": made["number"], "signer": made["signer"]}
        return Done(f"{made['number']}: unit {unit}", kept)
