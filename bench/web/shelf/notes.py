"""`/runs/…/notes` and `/runs/…/views`: what people write about an ended run, and views of the workbench."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, HTTPException, Request
from fastapi import Path as Part
from pydantic import BaseModel, Field

from bench.record import Note, NotesRecord, View
from bench.web.people.access import Operator
from bench.web.shelf.indexing import index_of, resolved

router = APIRouter(tags=["runs"])
MOST = 500
"""Notes, and views, of one run."""
Name = Annotated[str, Part(min_length=1, max_length=80, pattern=r"^[^\x00-\x1f]+$")]


class Writing(BaseModel):
    """A note."""

    text: str = Field(min_length=1, max_length=4000, pattern=r"\S")


class Shown(BaseModel):
    """The query of the workbench's address."""

    address: str = Field(max_length=16000, pattern=r"^\?[\x21-\x7e]+$")


@router.get("/runs/{unit}/{run}/notes")
def notes(request: Request, unit: str, run: str) -> NotesRecord:
    """Notes and saved views of a run, oldest first."""
    return NotesRecord.find(index_of(request).folder(unit, run)) or NotesRecord()


@router.post("/runs/{unit}/{run}/notes", status_code=201)
def note(request: Request, unit: str, run: str, wanted: Writing, who: Operator) -> NotesRecord:
    """Write a note; it stays as it is."""
    made = Note(text=wanted.text.strip(), who=who.name, utc=_now())
    return _changed(request, unit, run, lambda known: known.noted(made))


@router.put("/runs/{unit}/{run}/views/{name:path}")
def keep(request: Request, unit: str, run: str, name: Name, wanted: Shown, who: Operator) -> NotesRecord:
    """Save a view; it takes the place of one of the same name."""
    made = View(name=name, address=wanted.address, who=who.name, utc=_now())
    return _changed(request, unit, run, lambda known: known.kept(made))


@router.delete("/runs/{unit}/{run}/views/{name:path}")
def remove(request: Request, unit: str, run: str, name: Name, who: Operator) -> NotesRecord:
    """Remove a view."""
    return _changed(request, unit, run, lambda known: known.without(name))


def _changed(request: Request, unit: str, run: str, change: Callable[[NotesRecord], NotesRecord]) -> NotesRecord:
    (entry,) = resolved(request, [f"{unit}/{run}"])

    def bounded(known: NotesRecord) -> NotesRecord:
        made = change(known)
        if max(len(made.notes), len(made.views)) > MOST:
            raise HTTPException(409, f"run {unit}/{run} has {MOST} notes or views already: remove a view first")
        return made

    return NotesRecord.change(Path(entry["path"]), bounded)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
