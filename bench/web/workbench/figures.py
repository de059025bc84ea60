"""`/figures`: figures of runs and a model, the finer the narrower the shown range."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field, FiniteFloat

from bench.web.jobs.jobs import Asked, key_of, submit
from bench.web.workbench.asking import ModelJson, RunChoice, RunId

router = APIRouter(tags=["workbench"])

Kind = Literal["time", "temperature", "map", "loop", "axes", "allan", "ladder", "channels"]


class FigureRequest(RunChoice):
    """A figure. The model is fitted to all `runs`; the figure shows the run `of`, by default the first of them.

    `from_s` … `to_degc` are the shown range: the narrower, the finer the data. `width` [pixels] limits the points of a
    curve. `over` is the abscissa of `axes`: time, dT_dt or a channel; with `every`, all runs are drawn in it.
    """

    kind: Kind
    model: ModelJson | None = None
    of: RunId | None = None
    over: str = Field("temperature", max_length=100)
    every: bool = False
    from_s: FiniteFloat | None = None
    to_s: FiniteFloat | None = None
    from_degc: FiniteFloat | None = None
    to_degc: FiniteFloat | None = None
    width: int = Field(1000, ge=50, le=2000)


@router.post("/figures", status_code=202)
def figures(request: Request, body: FigureRequest) -> Asked:
    """Request a figure: plotly JSON, its description as text, its numbers as rows of a CSV."""
    if body.model is not None:
        body.model.model()
    inputs: dict[str, Any] = {
        **body.resolved(request),
        "of": body.entries(request, [body.of])[0] if body.of else None,
        "model": body.model.content() if body.model else None,
        **body.model_dump(include={"kind", "over", "every", "from_s", "to_s", "from_degc", "to_degc", "width"}),
    }
    target = "bench.web.workbench.drawing:draw"
    return submit(request, "figure", target, inputs, key=key_of(target, inputs))
