"""`/analyses` and `/differences`: models side by side on runs of a unit, and two runs side by side."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request
from pydantic import BaseModel, Field

from bench.web.jobs.jobs import Asked, key_of, submit
from bench.web.people.access import Engineer
from bench.web.shelf.indexing import resolved
from bench.web.workbench.asking import MOST_MODELS, ModelJson, RunChoice, RunId

router = APIRouter(tags=["workbench"])


class AnalysisRequest(RunChoice):
    """Models to fit to `runs`, in the order of the ladder."""

    models: list[ModelJson] = Field(min_length=1, max_length=MOST_MODELS)
    turning: bool = False
    """Judge each model beside a scale factor, as a report does, where a rate table turned the unit."""


class DifferenceRequest(BaseModel):
    """Two runs, of one unit or of two."""

    a: RunId
    b: RunId


@router.post("/analyses", status_code=202)
def analyses(request: Request, body: AnalysisRequest, who: Engineer) -> Asked:
    """Request the errors of models, in-sample and on unseen data, and the noise floor.

    The result is that of `bench compare --json`, with the YAML of each model, the rungs of the ladder and its figure;
    `turned` says that the models got a scale factor.
    """
    for model in body.models:
        model.model()
    models = [model.content() for model in body.models]
    inputs = {**body.resolved(request), "models": models, "turning": body.turning}
    target = "bench.web.workbench.computing:analysis"
    return submit(request, "analysis", target, inputs, key=key_of(target, inputs))


@router.post("/differences", status_code=202)
def differences(request: Request, body: DifferenceRequest, who: Engineer) -> Asked:
    """Request the differences of two analysed runs, largest first: the result of `bench diff --json` and a figure."""
    if body.a == body.b:
        raise HTTPException(400, f"{body.a} twice: choose two runs")
    a, b = resolved(request, [body.a, body.b])
    # An analysis changes calibration.json without changing the data, so the result is not cached.
    return submit(request, "difference", "bench.web.workbench.computing:difference", {"a": a, "b": b})
