"""The diagnosis of a run as its report shows it: what is missing, and how the error falls when it is added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis, SuspectedEffect
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.experiment import next_experiment
from bench.analysis.diagnosis.held_out import unseen, without_pauses, without_spikes
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import FitRows, fit_rows
from bench.analysis.fit.disturbances import undisturbed
from bench.analysis.fit.fitting import fit_model
from bench.base import FloatArray, InputError
from bench.record import Dataset, DiagnosisRecord

_RIVALS = 2


@dataclass(frozen=True)
class Rung:
    """One model of the ladder: the diagnosed one, with effects found added, or with a rival in place of the strongest.

    Amplitudes are fitted anew at each rung, nonlinear parameters are those found; errors in RMS [deg/h].
    """

    name: str
    in_sample_dph: float
    held_out_dph: float
    rival: bool = False


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """The answer and its ladder; without an answer `reason` says why."""

    answer: Diagnosis | None = None
    rungs: tuple[Rung, ...] = ()
    reason: str = ""
    profile_yaml: str = ""
    """Profile of the answer's next experiment, where there is one."""

    @property
    def record(self) -> DiagnosisRecord | None:
        """The whole answer, as it stands in diagnosis.json."""
        return None if self.answer is None else DiagnosisRecord.model_validate(self.answer.to_json())

    def to_json(self) -> dict[str, Any]:
        """What `bench run --json` says about it; the whole answer is in diagnosis.json."""
        if self.answer is None:
            return {"verdict": None, "sentence": self.reason or None, "suspects": []}
        names = [suspect.effect for suspect in self.answer.suspects]
        return {"verdict": self.answer.verdict, "sentence": self.answer.sentence, "suspects": names}


def diagnosed(  # noqa: PLR0913, PLR0917 - what a diagnosis rests on
    data: Dataset,
    model: Model,
    check: Sequence[Dataset],
    static: Dataset | None,
    floor_dph: float,
    plan: Path,
    sisters: Sequence[Dataset] = (),
    workers: int | None = None,
) -> Diagnosed:
    """Diagnose `model` on a run, its check runs, its isothermal run and those of sister units.

    Where no diagnosis is possible, the answer is a reason, never an error. `floor_dph` is NaN where the floor is not
    known; `plan` is where the next experiment's profile will be.
    """
    try:
        answer = diagnose(
            [data], model, check=check, static=static, sisters=sisters, floor_dph=floor_dph, workers=workers
        )
        proposal = next_experiment(answer, [data], check=check, static=static)
        proposed = {} if proposal is None else proposal.to_json(str(plan))
        yaml = "" if proposal is None else proposal.profile_yaml
        rungs = improvement_rungs(answer, [data], check)
        return Diagnosed(replace(answer, next_experiment=proposed or None), rungs, profile_yaml=yaml)
    except (InputError, ArithmeticError, ValueError) as error:
        # A numerical failure on unexpected data must not cost the operator the report of hours in the chamber.
        known = isinstance(error, InputError)
        return Diagnosed(reason=str(error) if known else f"the diagnosis failed ({type(error).__name__}: {error})")


def improvement_rungs(answer: Diagnosis, runs: Sequence[Dataset], check: Sequence[Dataset]) -> tuple[Rung, ...]:
    """The model, each effect found added to it, what is proved before what is not, strongest first, then the rivals of
    the strongest; on the same runs.
    """
    rungs = [Rung(answer.model.name, answer.rms_dph, answer.held_out_rms_dph)]
    if answer.found:
        base = fit_model(answer.model, runs, covariance="none", weights="count")
        check = [without_spikes(base, without_pauses(undisturbed(run))) for run in check]
        rows = fit_rows(base.model, tuple(runs), [np.isfinite(residual) for residual in base.residuals])
        theta = np.array(list(base.theta.values()), dtype=np.float64)
        for suspect in sorted(answer.found, key=lambda one: one not in answer.named):
            rows = replace(rows, model=rows.model.adding(suspect.model.effects[-1]))
            theta = np.append(theta, suspect.theta)
            rungs.append(_rung(f"+ {suspect.effect}", rows, theta, tuple(check)))
    return (*rungs, *_rivals(answer))


def _rivals(answer: Diagnosis) -> list[Rung]:
    if not answer.found:
        return []
    strongest = answer.found[0]
    others = rivals(answer, strongest)[:_RIVALS]
    name = f"{{}} instead of {strongest.effect}"
    return [Rung(name.format(s.effect), np.nan, s.held_out_rms_dph, rival=True) for s in others]


def rivals(answer: Diagnosis, suspect: SuspectedEffect) -> list[SuspectedEffect]:
    """Other effects that could stand in place of a suspect: its look-alikes, then the next in evidence."""
    others = [s for s in answer.suspects if not s.found]
    return sorted(others, key=lambda s: (s.effect not in suspect.look_alikes, -s.evidence))


def _rung(name: str, rows: FitRows, theta: FloatArray, check: tuple[Dataset, ...]) -> Rung:
    scored = unseen(rows, theta, check)
    if not scored.residuals:
        return Rung(name, np.nan, scored.rms_dph)
    left = np.concatenate([r[mask] for r, mask in zip(scored.residuals, rows.masks, strict=True)])
    return Rung(name, float(np.sqrt(np.mean(left**2))), scored.rms_dph)
