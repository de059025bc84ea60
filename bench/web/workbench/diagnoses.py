"""`/diagnoses`: where a model fails, what is missing, what this data cannot tell, and the run that would."""

from __future__ import annotations

from fastapi import APIRouter, Request

from bench.web.ground.settings import Here
from bench.web.jobs.jobs import Asked, key_of, submit
from bench.web.people.access import Engineer
from bench.web.workbench.asking import ModelJson, RunChoice

router = APIRouter(tags=["workbench"])


class DiagnosisWish(RunChoice):
    """A model to question on runs of one unit."""

    model: ModelJson


@router.post("/diagnoses", status_code=202)
def diagnoses(request: Request, wish: DiagnosisWish, here: Here, who: Engineer) -> Asked:
    """Ask which effect a model lacks: the answer of `bench diagnose --json`, with a picture of each suspect.

    The next experiment that it proposes is a plan from then on: `next_experiment.plan` is its id.
    """
    wish.model.model()
    wanted = {**wish.resolved(request), "model": wish.model.content(), "plans": str(here.own / "plans")}
    target = "bench.web.workbench.diagnosing:diagnosis"
    return submit(request, "diagnosis", target, wanted, key=key_of(target, wanted), lane="slow")
