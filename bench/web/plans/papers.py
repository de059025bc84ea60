"""`/stations/{station}/papers`: laboratory and equipment of a station, filled in once for all certificates."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException
from fastapi import Path as Part
from pydantic import BaseModel, Field

from bench.base import Document, InputError, dump, parse_yaml, read_text
from bench.commands import PAPERS, Papers, own_paper
from bench.deliver import load_instruments, load_laboratory
from bench.record import write_atomically
from bench.web.ground.problems import one_line, within
from bench.web.ground.settings import Here, Settings
from bench.web.people.access import Engineer
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, named
from bench.web.plans.editing import refuse_changed, text_digest

router = APIRouter(tags=["plans"])
Kind = Literal["laboratory", "equipment"]
Station = Annotated[str, Part(min_length=1, max_length=100)]
_LOAD: dict[str, Callable[[Document], Any]] = {"laboratory": load_laboratory, "equipment": load_instruments}


class Paper(BaseModel):
    """A file as it stands; `content` is null where there is none, `problem` says what is wrong with it."""

    file: str | None
    content: dict[str, Any] | None
    digest: str = ""
    """Names this state of the user's own file; empty where there is none."""
    problem: str = ""


class PapersOfStation(BaseModel):
    """Laboratory and equipment of a station."""

    station: str
    laboratory: Paper
    equipment: Paper


class Filled(BaseModel):
    """A form as it was filled in; the description of the file is its schema (docs/reference/schemas.md).

    `digest` is that of the paper that it was made from.
    """

    content: dict[str, Any] = Field(max_length=20)
    digest: str = Field(max_length=64)


@router.get("/stations/{station}/papers")
def papers(station: Station, here: Here) -> PapersOfStation:
    """The files of a station, its own or shipped ones."""
    settings = catalog.station(named(Catalog(here.project, here.own).stations(), station, "station"))
    found: dict[str, Paper] = {}
    for kind in PAPERS:
        home = here.project / "profiles"
        own, digest = own_paper(kind, settings, home), ""
        try:
            if own.is_file():
                text = read_text(own)
                digest = text_digest(text)
                given = parse_yaml(text, own)
            else:
                given = getattr(Papers.of_station(settings, home), kind)
            file = given and within(here.project, str(given.file))
            found[kind] = Paper(file=file, content=given and given.content, digest=digest)
        except InputError as error:
            problem = within(here.project, one_line(str(error)))
            found[kind] = Paper(file=within(here.project, str(own)), content=None, digest=digest, problem=problem)
    return PapersOfStation(station=station, **found)


@router.put("/stations/{station}/papers/{kind}")
def fill_in(station: Station, kind: Kind, filled: Filled, here: Here, who: Engineer) -> Paper:
    """Write a file of the station; 400 with what is wrong.

    409 where the station names a file of another folder, or the file has changed since.
    """
    settings = catalog.station(named(Catalog(here.project, here.own).stations(), station, "station"))
    file = _writable(own_paper(kind, settings, here.project / "profiles"), here)
    refuse_changed(file, filled.digest, f"{kind}/{station}")
    content = _without_empty(filled.content) or {}
    document = parse_yaml(f"{_head(kind)}{dump(content)}", file.name)
    try:
        _LOAD[kind](document)
    except InputError as error:  # who fills in a form sees no lines of a file
        raise InputError(re.sub(rf"(?m)^{re.escape(file.name)}:(?:\d+:)? ", "", str(error))) from None
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, document.text.encode())
    return Paper(file=within(here.project, str(file)), content=content, digest=text_digest(document.text))


def _head(kind: str) -> str:
    return f"# Filled in on the page of the bench. The {kind} that certificates of this station name.\n"


def _writable(file: Path, here: Settings) -> Path:
    if not file.resolve().is_relative_to(here.project.resolve()):
        raise HTTPException(409, f"the station names {file}, which is not in this project: edit it there")
    return file


def _without_empty(value: Any) -> Any:
    """Without empty texts, lists and groups: an empty field of a form is none."""
    if isinstance(value, dict):
        kept = {key: found for key, one in value.items() if (found := _without_empty(one)) is not None}
        return kept or None
    if isinstance(value, list):
        return [found for one in value if (found := _without_empty(one)) is not None] or None
    if isinstance(value, str):
        return value.strip() or None
    return value
