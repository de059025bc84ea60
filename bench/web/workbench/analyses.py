"""`/analyses` and `/differences`: models side by side on runs of a unit, and two runs side by side."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request
from pydantic import BaseModel, Field

from bench.web.jobs.jobs import Asked, key_of, submit
from bench.web.people.access import Engineer
from bench.web.workbench.asking import MOST_MODELS, ModelJson, RunChoice, RunId, resolved

router = APIRouter(tags=["workbench"])


class AnalysisWish(RunChoice):
    """Models to fit to `runs`, in the order of the ladder."""

    models: list[ModelJson] = Field(min_length=1, max_length=MOST_MODELS)


class DifferenceWish(BaseModel):
    """Two runs, of one unit or of two."""

    a: RunId
    b: RunId


@router.post("/analyses", status_code=202)
def analyses(request: Request, wish: AnalysisWish, who: Engineer) -> Asked:
    """Ask how far models are off: in-sample, on unseen data, beside the noise floor.

    The answer is that of `bench compare --json`, with the YAML of each model, the rungs of the ladder and its figure.
    """
    for model in wish.models:
        model.model()
    wanted = {**wish.resolved(request), "models": [model.content() for model in wish.models]}
    target = "bench.web.workbench.computing:analysis"
    return submit(request, "analysis", target, wanted, key=key_of(target, wanted))


@router.post("/differences", status_code=202)
def differences(request: Request, wish: DifferenceWish, who: Engineer) -> Asked:
    """Ask what differs between two analysed runs, worst first: the answer of `bench diff --json` and a figure."""
    if wish.a == wish.b:
        raise HTTPException(400, f"{wish.a} twice: choose two runs")
    a, b = resolved(request, [wish.a, wish.b])
    # An analysis changes calibration.json beside the same data, so nothing is kept.
    return submit(request, "difference", "bench.web.workbench.computing:difference", {"a": a, "b": b})
