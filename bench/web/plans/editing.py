"""`/files`: profiles, stations, limits and plans as texts that are edited in the page and saved as one's own copies.

The text is saved as it was typed: comments and order stay. A shipped file is never written; a copy of the same name in
the project takes its place.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Annotated, Literal, get_args

from fastapi import APIRouter, HTTPException, Request
from fastapi import Path as Part
from pydantic import BaseModel, Field

from bench.base import library, read_text
from bench.record import slug, write_atomically
from bench.web.ground.problems import one_line
from bench.web.ground.settings import Here, Settings
from bench.web.jobs.jobs import Asked, submit
from bench.web.people.access import Engineer
from bench.web.plans.catalog import Catalog, is_shipped, loaded, named
from bench.web.plans.checking import FILE_NAME, Name

router = APIRouter(tags=["plans"])
Kind = Literal["profiles", "stations", "limits", "plans"]
Id = Annotated[str, Part(min_length=1, max_length=60, pattern=FILE_NAME)]
MOST_SIGNS = 200_000


class Listed(BaseModel):
    """Ids by kind; those of `own` are the user's own files, those of `changed` differ from any that is shipped."""

    profiles: list[str]
    stations: list[str]
    limits: list[str]
    plans: list[str]
    """Those of calibrations."""
    own: dict[str, list[str]]
    changed: dict[str, list[str]]


class Text(BaseModel):
    """A file as it stands; `own` where it is the user's own, `digest` names this state of it."""

    text: str
    own: bool
    digest: str


class Draft(BaseModel):
    """A text that is being edited; a profile, or a plan, is checked on a station."""

    text: str = Field(max_length=MOST_SIGNS)
    station: Name = "simulated"


class Saved(BaseModel):
    """A text to keep; `digest` is that of the file that it was made from, empty for a new name."""

    text: str = Field(max_length=MOST_SIGNS)
    digest: str = Field(max_length=64)


@router.get("/files")
def files(here: Here) -> Listed:
    """Profiles, stations, limits and plans that can be edited."""
    found = {kind: _files(kind, here) for kind in get_args(Kind)}
    own = {kind: [id_ for id_, path in known.items() if _is_own(path, here)] for kind, known in found.items()}
    changed = {
        kind: [id_ for id_ in ids if not is_shipped(found[kind][id_], _place(kind, library()) / f"{id_}.yaml")]
        for kind, ids in own.items()
    }
    return Listed(own=own, changed=changed, **{kind: list(known) for kind, known in found.items()})


@router.get("/files/{kind}/{id}")
def file(kind: Kind, id: Id, here: Here) -> Text:
    """A file as text; 400 where there is none."""
    path = named(_files(kind, here), id, kind)
    text = read_text(path)
    return Text(text=text, own=_is_own(path, here), digest=text_digest(text))


@router.post("/files/{kind}/{id}/checks", status_code=202)
def check(kind: Kind, id: Id, draft: Draft, request: Request, here: Here, who: Engineer) -> Asked:
    """Request the check of a text, with the findings by line; of a profile also `bench check` on a station."""
    station = named(Catalog(here.project, here.own).stations(), draft.station, "station")
    path = _place(kind, here.project / "profiles") / f"{id}.yaml"
    places = {"file": str(path), "station": str(station), "project": str(here.project)}
    wanted = {"kind": kind, "text": draft.text, **places}
    return submit(request, "check", "bench.web.plans.catalog:drafted", wanted)


@router.put("/files/{kind}/{id}")
def save(kind: Kind, id: Id, saved: Saved, here: Here, who: Engineer) -> Text:
    """Keep a text as the user's own file; 400 with what is wrong with it, 409 where the file has changed since."""
    if slug(id) != id:
        raise HTTPException(400, f"name is '{id}', which not every computer can keep: take '{slug(id)}'")
    existing = _files(kind, here).get(id)
    refuse_changed(existing, saved.digest, f"{kind}/{id}")
    path = _place(kind, here.project / "profiles") / f"{id}.yaml"
    if existing is None and path.exists():
        raise HTTPException(409, f"{kind}/{id} is a file of another kind: take another name")
    _, errors = loaded(kind, saved.text, str(path), here.project)
    if errors:
        told = (f"line {one['line']}: {one['text']}" if one["line"] else one["text"] for one in errors)
        raise HTTPException(400, one_line("\n".join(told)))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, saved.text.encode())
    return Text(text=saved.text, own=True, digest=text_digest(saved.text))


def _files(kind: str, here: Settings) -> dict[str, Path]:
    known = Catalog(here.project, here.own)
    listed = {"profiles": known.plans, "stations": known.stations, "limits": known.limits, "plans": known.calibrations}
    return listed[kind]()


def _place(kind: str, profiles: Path) -> Path:
    return (profiles if kind == "profiles" else profiles / kind).resolve()


def _is_own(path: Path, here: Settings) -> bool:
    return path.is_relative_to((here.project / "profiles").resolve())


def text_digest(text: str) -> str:
    """Names the state of a file by its text."""
    return sha256(text.encode()).hexdigest()


def refuse_changed(path: Path | None, opened: str, what: str) -> None:
    """HTTPException 409 where a file is not as it was when it was `opened`: its digest, empty where there was none."""
    if opened != ("" if path is None or not path.is_file() else text_digest(read_text(path))):
        raise HTTPException(409, f"{what} has changed since it was opened: copy your text, and open it again")
