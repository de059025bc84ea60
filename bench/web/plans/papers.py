"""`/stations/{station}/papers`: laboratory and equipment of a station, filled in once for all certificates."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException
from fastapi import Path as Part
from pydantic import BaseModel, Field

from bench.acquisition import load_recipients
from bench.base import Document, InputError, dump, parse_yaml, read_text, read_yaml
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
Kind = Literal["laboratory", "equipment", "notify"]
Station = Annotated[str, Part(min_length=1, max_length=100)]
_LOAD: dict[str, Callable[[Document], Any]] = {
    "laboratory": load_laboratory,
    "equipment": load_instruments,
    "notify": load_recipients,
}
_OWNERS_ONLY = 0o600


class Paper(BaseModel):
    """A file as it stands; `content` is null where there is none, `problem` says what is wrong with it."""

    file: str | None
    content: dict[str, Any] | None
    digest: str = ""
    """Names this state of the user's own file; empty where there is none."""
    problem: str = ""


class PapersOfStation(BaseModel):
    """Laboratory and equipment of a station, and who is told of its runs, without the addresses."""

    station: str
    laboratory: Paper
    equipment: Paper
    notify: Paper


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
    for kind in _LOAD:
        home = here.project / "profiles"
        own, digest = own_paper(kind, settings, home), ""
        try:
            given: Document | None
            if own.is_file():
                text = read_text(own)
                digest = text_digest(text)
                given = parse_yaml(text, own)
            else:
                given = getattr(Papers.of_station(settings, home), kind) if kind in PAPERS else None
            file = given and within(here.project, str(given.file))
            content = given and _shown(kind, given.content)
            found[kind] = Paper(file=file, content=content, digest=digest)
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
    home = here.project / "profiles"
    file = _writable(own_paper(kind, settings, home), here)
    refuse_changed(file, filled.digest, f"{kind}/{station}")
    if kind == "notify":
        content = {"recipients": _addressed(filled.content, file)}
        if not content["recipients"] and file == own_paper(kind, settings.model_copy(update={"notify": None}), home):
            file.unlink(missing_ok=True)
            return Paper(file=None, content=None)
    else:
        content = _without_empty(filled.content) or {}
    document = parse_yaml(f"{_head(kind)}{dump(content)}", file.name)
    try:
        _LOAD[kind](document)
    except InputError as error:  # who fills in a form sees no lines of a file
        raise InputError(re.sub(rf"(?m)^{re.escape(file.name)}:(?:\d+:)? ", "", str(error))) from None
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, document.text.encode(), mode=_OWNERS_ONLY if kind == "notify" else 0o644)
    kept = _shown(kind, content)
    return Paper(file=within(here.project, str(file)), content=kept, digest=text_digest(document.text))


def _shown(kind: str, content: dict[str, Any]) -> dict[str, Any]:
    """What the page may know of a file: of recipients all but their addresses, which have passwords."""
    if kind != "notify":
        return content
    listed = ((one.get("name"), {key: one[key] for key in ("name", "when") if key in one}) for one in _known(content))
    return {"recipients": [{"kept": name, **one} for name, one in listed]}


def _known(content: Any) -> list[dict[str, Any]]:
    """The recipients of a file, of a wrong one those that it has."""
    listed = content.get("recipients") if isinstance(content, dict) else None
    return [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []


def _addressed(filled: dict[str, Any], file: Path) -> list[dict[str, Any]]:
    """Recipients of a form; one without an address has that of the recipient that it was in the file (`kept`)."""
    addresses: dict[Any, str] = {}
    with contextlib.suppress(InputError):  # what cannot be read has no addresses
        addresses = {str(one.get("name")): str(one.get("url", "")) for one in _known(read_yaml(file).content)}
    return [
        {
            "name": str(one.get("name") or "").strip(),
            "url": str(one.get("url") or "").strip() or addresses.get(str(one.get("kept")), ""),
            **({"when": one["when"]} if "when" in one else {}),
        }
        for one in _known(filled)
    ]


def _head(kind: str) -> str:
    what = "Who is told of its runs" if kind == "notify" else f"The {kind} that certificates of this station name"
    return f"# Filled in on the page of the bench. {what}.\n"


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
