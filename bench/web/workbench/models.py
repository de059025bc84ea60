"""`/models` and `/effects`: models by name, the catalogue of effects, and user-defined terms."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import BaseModel, Field

from bench.analysis import FUNCTIONS, MODELS, Expression, catalogue, load_model, model_files, needing_bounds, variables
from bench.base import InputError, library
from bench.deliver import undeliverable
from bench.record import channels_in, slug, write_atomically
from bench.web.ground.problems import row
from bench.web.ground.settings import Here, Settings
from bench.web.jobs.jobs import jobs_of
from bench.web.people.access import Engineer
from bench.web.plans.catalog import is_text
from bench.web.plans.checking import FILE_NAME
from bench.web.shelf.indexing import resolved
from bench.web.workbench.asking import MOST_RUNS, ModelJson, RunId, model_json

router = APIRouter(tags=["workbench"])

_TIME_S, _SIZE = [10.0, 3600.0], [0.1, 10.0]
"""Bounds to begin with: of a time [s], and of anything else."""
Where = Literal["shipped", "project"]
"""Where a model comes from."""


class KnownModel(BaseModel):
    """A model by name; `problem` is the reason if it cannot be read."""

    name: str
    where: Where
    effects: list[dict[str, Any]] = []
    """Each `{effect, ...options}`."""
    rows: str = "all"
    yaml: str = ""
    problem: str = ""


class KnownModels(BaseModel):
    """All shipped models, and those of the project, where the page saves and commands look."""

    models: list[KnownModel]


class SaveRequest(BaseModel):
    """A model to keep under a name."""

    name: str = Field(min_length=1, max_length=60, pattern=FILE_NAME)
    model: ModelJson
    runs: list[RunId] = Field(default_factory=list, max_length=MOST_RUNS)
    """Runs that it was fitted to: their unit is to hold it."""


class Saved(BaseModel):
    """A saved model: `name` or `file` is the argument for `--model` on the command line."""

    name: str
    file: str
    yaml: str
    undeliverable: str = ""
    """Why no unit, or not that of the runs, can hold it, with models that one can; empty where one can."""


class ParameterAnswer(BaseModel):
    """A nonlinear parameter of an effect, searched between `low` and `high`."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str


class EffectAnswer(BaseModel):
    """An effect of the catalogue."""

    effect: str
    family: str
    summary: str
    needs: list[str]
    options: dict[str, Any]
    parameters: list[ParameterAnswer]
    look_alikes: list[str]
    sections: dict[str, str]
    suspect: bool


class Effects(BaseModel):
    """The catalogue, and the names that a formula may use."""

    effects: list[EffectAnswer]
    variables: list[str]
    functions: list[str]


class FormulaRequest(BaseModel):
    """A user-defined term, with bounds for its nonlinear parameters."""

    expression: str = Field(max_length=2000)
    bounds: dict[str, tuple[float, float]] = {}
    runs: list[RunId] = Field(default_factory=list, max_length=MOST_RUNS)
    """Runs that it will be fitted to: each must have its channels."""


class FormulaAnswer(BaseModel):
    """Whether a term is valid; `detail` is the reason if not, `parameters` are fitted, `needs` are its channels."""

    ok: bool
    detail: str = ""
    parameters: list[str] = []
    amplitudes: list[str] = []
    nonlinear: list[str] = []
    needs: list[str] = []
    bounds: dict[str, list[float]] = {}
    """Parameters that need bounds, also of a term that is not valid yet: each with bounds to begin with."""
    effect: dict[str, Any] | None = None


@router.get("/models")
def models(request: Request, here: Here) -> KnownModels:
    """All models; also starts the computing processes, because a computation usually follows."""
    jobs_of(request).warm()
    return KnownModels(models=[_known(path, here) for path in model_files(here.project).values() if is_text(path.stem)])


@router.post("/models", status_code=201)
def save(body: SaveRequest, request: Request, here: Here, who: Engineer, response: Response) -> Saved:
    """Save a model under an unused name; saving the same model twice is not an error."""
    known = model_files(here.project)
    model = ModelJson(name=body.name, effects=body.model.effects, rows=body.model.rows).model()
    text = model.to_yaml()
    path = here.project / MODELS / f"{slug(body.name)}.yaml"
    if (existing := known.get(path.stem)) is not None:
        if existing.read_text(encoding="utf-8") != text:
            told = f"the name '{body.name}' is used for another model ({_where(existing)}): choose another name"
            raise HTTPException(409, told)
        response.status_code = 200
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())
    has = [channels_in(Path(run["path"])) for run in resolved(request, body.runs)]
    why = undeliverable(model, here.project, set.intersection(*has) if has else None)
    return Saved(name=path.stem, file=str(path), yaml=text, undeliverable=why)


@router.get("/effects")
def effects() -> Effects:
    """The catalogue of physical effects, as in `bench effects`."""
    entries = [
        EffectAnswer(
            effect=entry.name,
            family=entry.family,
            summary=entry.summary,
            needs=list(entry.needs),
            options=entry.options,
            parameters=[
                ParameterAnswer(name=p.name, unit=p.unit, low=p.low, high=p.high, meaning=p.meaning)
                for p in entry.parameters
            ],
            look_alikes=list(entry.look_alikes),
            sections=entry.sections,
            suspect=entry.suspect,
        )
        for entry in catalogue()
    ]
    return Effects(effects=entries, variables=list(variables()), functions=list(FUNCTIONS))


@router.post("/effects/formula")
def formula(request: Request, body: FormulaRequest) -> FormulaAnswer:
    """Check a term while it is typed; nothing is computed."""
    needed = {name: _TIME_S if time else _SIZE for name, time in needing_bounds(body.expression).items()}
    try:
        term = Expression(body.expression, body.bounds)
        for run in resolved(request, body.runs):
            has = channels_in(Path(run["path"]))
            for channel in sorted({*term.needs} - has):
                known = ", ".join(name for name in variables() if name in has)
                raise InputError(f"{run['run']} has no channel '{channel}': choose one of {known}")
    except InputError as error:
        return FormulaAnswer(ok=False, detail=str(error).removeprefix("expression: "), bounds=needed)
    parsed, bounds = term.parsed, {name: list(pair) for name, pair in body.bounds.items()}
    return FormulaAnswer(
        ok=True,
        parameters=[*parsed.amplitudes, *parsed.nonlinear],
        amplitudes=list(parsed.amplitudes),
        nonlinear=list(parsed.nonlinear),
        needs=list(term.needs),
        bounds=needed,
        effect={"effect": "expression", "formula": body.expression, **({"bounds": bounds} if bounds else {})},
    )


def _where(path: Path) -> Where:
    return "shipped" if path.parent.resolve() == (library() / "models").resolve() else "project"


def _known(path: Path, here: Settings) -> KnownModel:
    where = _where(path)

    def made() -> KnownModel:
        model = load_model(path)
        content = model_json(model)
        return KnownModel(
            name=path.stem, where=where, effects=content["effects"], rows=content["rows"], yaml=model.to_yaml()
        )

    return row(here.project, made, lambda problem: KnownModel(name=path.stem, where=where, problem=problem))
