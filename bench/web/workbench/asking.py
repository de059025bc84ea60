"""Content of requests about runs and models, and its form for the computing process."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import Request
from pydantic import BaseModel, Field

from bench.analysis import Model, model_from, options_of
from bench.web.shelf.indexing import resolved

MOST_RUNS = 40
MOST_MODELS = 12
MOST_EFFECTS = 40

RunId = Annotated[str, Field(max_length=300)]
RunIds = Annotated[list[RunId], Field(min_length=1, max_length=MOST_RUNS)]


class ModelJson(BaseModel):
    """A model as JSON: each effect is `{effect, ...options}`."""

    name: str = Field(min_length=1, max_length=200)
    effects: list[dict[str, Any]] = Field(min_length=1, max_length=MOST_EFFECTS)
    rows: str = Field("all", max_length=20)

    def model(self) -> Model:
        """The model; InputError when the content is not valid."""
        return model_from(self.content())

    def content(self) -> dict[str, Any]:
        """The content of a model file."""
        entries = [{str(e.get("effect")): {k: v for k, v in e.items() if k != "effect"}} for e in self.effects]
        return {"name": self.name, "effects": entries, "rows": self.rows}


def model_json(model: Model) -> dict[str, Any]:
    """A model as the content of a `ModelJson`."""
    effects = [{"effect": effect.name, **options_of(effect)} for effect in model.effects]
    # Options may be mappings of other types than dict; JSON converts them.
    content: dict[str, Any] = json.loads(json.dumps({"name": model.name, "effects": effects, "rows": model.rows}))
    return content


class RunChoice(BaseModel):
    """Runs of one unit: runs to fit, held-out runs, and an isothermal run that gives the noise.

    `sisters` are isothermal runs of units like it: the diagnosis learns from them how the noise drifts.
    """

    runs: RunIds
    check: list[RunId] = Field(default_factory=list, max_length=MOST_RUNS)
    static: RunId | None = None
    sisters: list[RunId] = Field(default_factory=list, max_length=MOST_RUNS)
    output: str | None = Field(None, max_length=40)
    """Which output of units with several, as rate_x; None: their only one."""

    def resolved(self, request: Request) -> dict[str, Any]:
        """The runs for the computing process; raises what `resolved` raises."""
        return {
            "runs": self.entries(request, self.runs),
            "check": self.entries(request, self.check),
            "static": self.entries(request, [self.static])[0] if self.static else None,
            "sisters": self.entries(request, self.sisters),
        }

    def entries(self, request: Request, runs: list[RunId]) -> list[dict[str, str | None]]:
        """Runs with the chosen output."""
        return [{**entry, "output": self.output} for entry in resolved(request, runs)]
