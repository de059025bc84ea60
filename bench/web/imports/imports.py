"""`/imports`: takes a foreign table, shows how a confined process understands it, and imports it.

An upload lies in its own folder under `.web/imports` until it is imported, discarded, or abandoned.
`bench.web.imports.parsing` reads and checks it within limits, and writes only the run.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, HTTPException, Request
from pydantic import BaseModel, Field

from bench.acquisition import IMPORTED, examples
from bench.base import CHANNELS
from bench.record import slug
from bench.web.ground.settings import Here, Settings
from bench.web.imports.uploads import ENDINGS, Upload, boundary_of
from bench.web.jobs.jobs import Asked, submit
from bench.web.people.access import Engineer, Who

router = APIRouter(tags=["imports"])

KEPT_S = 2 * 3600.0
"""An upload that nobody has looked at for so long is removed [s]."""
MOST = 8
"""Number of uploads that may wait."""
_ASK = "bench.web.imports.confined:ask"
_FORM = {
    "required": True,
    "content": {"multipart/form-data": {"schema": {
        "type": "object", "required": ["file"],
        "properties": {"file": {"type": "string", "format": "binary"}, "dbc": {"type": "string", "format": "binary"}},
    }}},
}  # fmt: skip


class ImportChannel(BaseModel):
    """A channel for a column, its unit, and usual units of columns."""

    name: str
    unit: str
    required: bool
    examples: list[str]


class Waiting(BaseModel):
    """An upload that was neither imported nor discarded; `left_s`: time until it is removed [s]."""

    import_id: str = Field(serialization_alias="import")
    file: str
    bytes: int
    left_s: float


class ImportKinds(BaseModel):
    """Channels and files that can be imported, and uploads that wait."""

    channels: list[ImportChannel]
    endings: list[str]
    most_bytes: int
    most_waiting: int
    waiting: list[Waiting]


class Uploaded(Asked):
    """An upload; the result of its job is the understanding of the table."""

    import_id: str = Field(serialization_alias="import")
    file: str


class Understanding(BaseModel):
    """Unit of the table, and its columns: `{channel: {column, unit}}`; without an entry the header decides."""

    unit: str = Field(default="unknown", min_length=1, max_length=64)
    columns: dict[str, dict[str, Any]] = Field(default={}, max_length=len(CHANNELS))


@contextlib.asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Remove abandoned uploads at the start."""
    _sweep(app.state.settings)
    yield


@router.get("/imports")
def kinds(here: Here) -> ImportKinds:
    """Channels, units and kinds of files; uploads that wait."""
    _sweep(here)
    channels = [
        ImportChannel(name=one.name, unit=one.unit, required=one.required, examples=list(examples(one.name)))
        for one in map(CHANNELS.__getitem__, IMPORTED)
    ]
    return ImportKinds(
        channels=channels, endings=list(ENDINGS), most_bytes=here.upload_bytes, most_waiting=MOST,
        waiting=list(_waiting(here)),
    )  # fmt: skip


@router.post("/imports", status_code=202, openapi_extra={"requestBody": _FORM})
async def take(request: Request, here: Here, who: Engineer) -> Uploaded:
    """Take a table (part `file`), and for a CAN log its layout (part `dbc`); the job shows the understanding."""
    boundary = boundary_of(request.headers.get("content-type", ""))
    folder = _new(here)
    upload = Upload(folder, boundary)
    try:
        await upload.take(request.stream())
        asked = _read(request, folder, Understanding())
    except BaseException:
        upload.close()
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return Uploaded(**asked.model_dump(), import_id=folder.name, file=upload.files["file"].name)


@router.post("/imports/{import_id}/preview", status_code=202)
def preview(import_id: str, wanted: Understanding, request: Request, here: Here, who: Engineer) -> Asked:
    """Show the understanding with these columns."""
    return _read(request, _existing(here, import_id), wanted)


@router.post("/imports/{import_id}", status_code=202)
def make(import_id: str, wanted: Understanding, request: Request, here: Here, who: Engineer) -> Asked:
    """Import it: the job's result is `{run, warnings}`."""
    folder = _existing(here, import_id)
    if slug(wanted.unit) != wanted.unit:
        raise HTTPException(400, f"unit is '{wanted.unit}': letters, digits and . _ + - only, not first . or -; "
                            f"for example '{slug(wanted.unit)}'")  # fmt: skip
    return _submit(request, "make", folder, wanted, who, out=str(here.out.resolve()))


@router.delete("/imports/{import_id}")
def give_up(import_id: str, here: Here, who: Engineer) -> dict[str, str]:
    """Discard an upload."""
    folder = _existing(here, import_id)
    shutil.rmtree(folder, ignore_errors=True)
    return {"import": import_id, "state": "gone"}


def _read(request: Request, folder: Path, wanted: Understanding) -> Asked:
    return _submit(request, "preview", folder, wanted, None)


def _submit(request: Request, do: str, folder: Path, wanted: Understanding, who: Who | None, **more: Any) -> Asked:
    files = {part: next((folder / part).iterdir(), None) for part in ("file", "dbc") if (folder / part).is_dir()}
    table, layout = files.get("file"), files.get("dbc")
    if table is None:
        raise HTTPException(404, "no such import, or not any more: send the file again")
    content = {
        "do": do, "folder": str(folder), "file": table.name, "dbc": f"../dbc/{layout.name}" if layout else None,
        "serial": wanted.unit, "columns": wanted.columns, "operator": who.name if who else None,
        **more,
    }  # fmt: skip
    return submit(request, "import" if do == "make" else "preview", _ASK, content, lane="slow")


def _home(here: Settings) -> Path:
    home = here.own.resolve() / "imports"
    home.mkdir(mode=0o700, exist_ok=True)
    return home


def _new(here: Settings) -> Path:
    _sweep(here)
    home = _home(here)
    if len(list(home.iterdir())) >= MOST:
        raise HTTPException(
            503, f"{MOST} uploads wait already: discard one of them, or wait until one expires", {"Retry-After": "60"}
        )
    folder = home / secrets.token_hex(8)
    folder.mkdir(mode=0o700)
    return folder


def _existing(here: Settings, import_id: str) -> Path:
    """The folder of an upload, found in the listing of all."""
    found = next((path for path in _home(here).iterdir() if path.name == import_id and path.is_dir()), None)
    if found is None:
        raise HTTPException(404, "no such import (any more): send the file again")
    os.utime(found)
    return found


def _waiting(here: Settings) -> Iterator[Waiting]:
    for folder in sorted(_home(here).iterdir(), key=lambda path: path.stat().st_mtime):
        table = next(iter((folder / "file").glob("*")), None)
        if table is not None:
            left_s = max(0.0, KEPT_S - (time.time() - folder.stat().st_mtime))
            size = table.stat().st_size
            yield Waiting(import_id=folder.name, file=table.name, bytes=size, left_s=round(left_s))


def _sweep(here: Settings) -> None:
    home = here.out / ".web" / "imports"
    for path in home.iterdir() if home.is_dir() else ():
        with contextlib.suppress(OSError):
            if time.time() - path.stat().st_mtime > KEPT_S:
                shutil.rmtree(path, ignore_errors=True)
