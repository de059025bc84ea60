"""`/models` and `/effects`: what a model is made of, models by name, and a term of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import BaseModel, Field

from bench.analysis import FUNCTIONS, Expression, catalogue, load_model, variables
from bench.base import InputError, library
from bench.record import slug, write_atomically
from bench.web.ground.problems import row
from bench.web.ground.settings import Here, Settings
from bench.web.jobs.jobs import jobs_of
from bench.web.people.access import Engineer
from bench.web.plans.catalog import is_text
from bench.web.workbench.asking import ModelJson, model_json

router = APIRouter(tags=["workbench"])

Where = Literal["shipped", "project", "saved"]
"""Where a model comes from."""


class KnownModel(BaseModel):
    """A model by name; one that cannot be read says why in `problem`."""

    name: str
    where: Where
    effects: list[dict[str, Any]] = []
    """Each `{effect, ...options}`."""
    rows: str = "all"
    yaml: str = ""
    problem: str = ""


class KnownModels(BaseModel):
    """All models of the library, of the project, and those saved on the page."""

    models: list[KnownModel]


class SaveWish(BaseModel):
    """A model to keep under a name."""

    name: str = Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$")
    model: ModelJson


class Saved(BaseModel):
    """Where a model is now: `file` is what `--model` of the command line takes."""

    name: str
    file: str
    yaml: str


class ParameterAnswer(BaseModel):
    """A nonlinear parameter of an effect: searched between its ends."""

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
    """The catalogue, and what a formula may use."""

    effects: list[EffectAnswer]
    variables: list[str]
    functions: list[str]


class FormulaWish(BaseModel):
    """A term of one's own, with bounds for its nonlinear parameters."""

    expression: str = Field(max_length=2000)
    bounds: dict[str, tuple[float, float]] = {}


class FormulaAnswer(BaseModel):
    """Whether it is understood; `detail` says why not, `parameters` what is fitted, `needs` the channels."""

    ok: bool
    detail: str = ""
    parameters: list[str] = []
    amplitudes: list[str] = []
    nonlinear: list[str] = []
    needs: list[str] = []
    effect: dict[str, Any] | None = None


@router.get("/models")
def models(request: Request, here: Here) -> KnownModels:
    """The models there are; whoever looks at them will soon compute, so a process is made ready."""
    jobs_of(request).warm()
    return KnownModels(models=[_known(path, where) for path, where in model_files(here).values()])


@router.post("/models", status_code=201)
def save(wish: SaveWish, here: Here, who: Engineer, response: Response) -> Saved:
    """Keep a model under a name that no other model has; the same model twice is no error."""
    known = model_files(here)
    model = ModelJson(name=wish.name, effects=wish.model.effects, rows=wish.model.rows).model()
    text = model.to_yaml()
    path = here.own / "models" / f"{slug(wish.name)}.yaml"
    if path.stem in known:
        there, where = known[path.stem]
        if where != "saved" or there.read_text(encoding="utf-8") != text:
            raise HTTPException(409, f"there is another model '{wish.name}' ({where}): choose another name")
        response.status_code = 200
    else:
        path.parent.mkdir(exist_ok=True)
        write_atomically(path, text.encode())
    return Saved(name=wish.name, file=str(path), yaml=text)


@router.get("/effects")
def effects() -> Effects:
    """The catalogue of physical effects, as `bench effects` tells it."""
    found = [
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
    return Effects(effects=found, variables=list(variables()), functions=list(FUNCTIONS))


@router.post("/effects/formula")
def formula(wish: FormulaWish) -> FormulaAnswer:
    """Whether a term is understood, as one types it; nothing is computed."""
    try:
        found = Expression(wish.expression, wish.bounds)
    except InputError as error:
        return FormulaAnswer(ok=False, detail=str(error).removeprefix("expression: "))
    parsed, bounds = found.parsed, {name: list(pair) for name, pair in wish.bounds.items()}
    return FormulaAnswer(
        ok=True,
        parameters=[*parsed.amplitudes, *parsed.nonlinear],
        amplitudes=list(parsed.amplitudes),
        nonlinear=list(parsed.nonlinear),
        needs=list(found.needs),
        effect={"effect": "expression", "formula": wish.expression, **({"bounds": bounds} if bounds else {})},
    )


def model_files(here: Settings) -> dict[str, tuple[Path, Where]]:
    """Model files by name; the project's own take the place of shipped ones."""
    found: dict[str, tuple[Path, Where]] = {}
    folders: tuple[tuple[Path, Where], ...] = (
        (library() / "models", "shipped"), (here.project / "profiles" / "models", "project"),
        (here.own / "models", "saved"),
    )  # fmt: skip
    for folder, where in folders:
        for path in sorted(folder.glob("*.yaml")) if folder.is_dir() else ():
            if not path.is_file() or not is_text(path.stem):
                continue
            if path.stem not in found or not path.samefile(found[path.stem][0]):
                found[path.stem] = (path, where)
    return found


def _known(path: Path, where: Where) -> KnownModel:
    def made() -> KnownModel:
        model = load_model(path)
        content = model_json(model)
        return KnownModel(
            name=path.stem, where=where, effects=content["effects"], rows=content["rows"], yaml=model.to_yaml()
        )

    return row(made, lambda problem: KnownModel(name=path.stem, where=where, problem=problem))
