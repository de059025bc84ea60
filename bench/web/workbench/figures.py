"""`/figures`: a picture of runs and a model, as fine as the stretch that is looked at."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field, FiniteFloat

from bench.web.jobs.jobs import Asked, key_of, submit
from bench.web.workbench.asking import ModelJson, RunChoice, RunId, resolved

router = APIRouter(tags=["workbench"])

Kind = Literal["time", "temperature", "map", "loop", "allan", "ladder", "channels"]


class FigureWish(RunChoice):
    """What to draw. The model is fitted to all `runs`; drawn is the run `of`, by default the first of them.

    `from_s` … `to_degc` are the stretch that is looked at: the narrower, the finer the data. `width` [pixels] bounds
    the points of a curve.
    """

    kind: Kind
    model: ModelJson | None = None
    of: RunId | None = None
    from_s: FiniteFloat | None = None
    to_s: FiniteFloat | None = None
    from_degc: FiniteFloat | None = None
    to_degc: FiniteFloat | None = None
    width: int = Field(1000, ge=50, le=2000)


@router.post("/figures", status_code=202)
def figures(request: Request, wish: FigureWish) -> Asked:
    """Ask for a figure: plotly JSON, a text of what it shows, its numbers as rows of a CSV."""
    if wish.model is not None:
        wish.model.model()
    wanted: dict[str, Any] = {
        **wish.resolved(request),
        "of": resolved(request, [wish.of])[0] if wish.of else None,
        "model": wish.model.content() if wish.model else None,
        **wish.model_dump(include={"kind", "from_s", "to_s", "from_degc", "to_degc", "width"}),
    }
    target = "bench.web.workbench.drawing:draw"
    return submit(request, "figure", target, wanted, key=key_of(target, wanted))
