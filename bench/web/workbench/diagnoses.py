"""`/diagnoses`: where a model fails, missing effects, effects that the data cannot show, and a run that would."""

from __future__ import annotations

from fastapi import APIRouter, Request

from bench.web.ground.settings import Here
from bench.web.jobs.jobs import Asked, key_of, submit
from bench.web.people.access import Engineer
from bench.web.workbench.asking import ModelJson, RunChoice

router = APIRouter(tags=["workbench"])


class DiagnosisRequest(RunChoice):
    """A model to diagnose on runs of one unit."""

    model: ModelJson
    brief: bool = False
    """Leave out pictures and the next experiment; a request with them, made next, costs only these."""


@router.post("/diagnoses", status_code=202)
def diagnoses(request: Request, body: DiagnosisRequest, here: Here, who: Engineer) -> Asked:
    """Request a diagnosis: the result of `bench diagnose --json`, with a figure of each suspect.

    The profile of the proposed next experiment is saved as a plan: `next_experiment.plan` is its id.
    """
    body.model.model()
    inputs = {
        **body.resolved(request),
        "brief": body.brief,
        "model": body.model.content(),
        "plans": str(here.own / "plans"),
    }
    target = "bench.web.workbench.diagnosing:diagnosis"
    return submit(request, "diagnosis", target, inputs, key=key_of(target, inputs), lane="slow")
