"""`/runs`: the list, filtered and sorted from memory, and each run with all that its folder says."""

from __future__ import annotations

import contextlib
import csv
import io
import threading
from collections.abc import AsyncIterator, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote

from fastapi import APIRouter, FastAPI, HTTPException, Query, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from pydantic import BaseModel, Field

from bench.archive import printed_certificate
from bench.base import RATES, InputError
from bench.record import (
    LIVE,
    CalibrationRecord,
    CertificateRecord,
    ComparisonRecord,
    DiagnosisRecord,
    LimitsRecord,
    Manifest,
    RunFolder,
    VerificationRecord,
    channels_in,
    verified_by,
)
from bench.web.ground.policy import REPORT
from bench.web.ground.problems import within
from bench.web.ground.settings import Here
from bench.web.live import story
from bench.web.shelf.indexing import Index, RunEntry, index_of, ordered
from bench.web.shelf.steps import Steps, steps_of, whole_of

_MOST_EVENTS = 2000
_BATCH_ROWS = 4096

router = APIRouter(tags=["runs"])


@contextlib.asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Read the list before the first request: the first time it takes seconds for ten thousand runs."""
    app.state.index = Index(app.state.settings.out, app.state.settings.own)
    threading.Thread(target=app.state.index.entries, name="index", daemon=True).start()
    yield


Sort = Literal[
    "run", "unit", "profile", "start", "state", "verdict", "rms_dph", "held_out_rms_dph", "floor_dph", "duration_s",
    "-run", "-unit", "-profile", "-start", "-state", "-verdict", "-rms_dph", "-held_out_rms_dph", "-floor_dph",
    "-duration_s",
]  # fmt: skip


class RunQuery(BaseModel):
    """Every word of `q` (of `this|that` one) must stand in id, profile, state, verdict or date; others are the same."""

    q: str = Field("", max_length=1000)
    unit: str = ""
    state: str = ""
    verdict: str = ""
    profile: str = ""
    sort: Sort = "-start"
    limit: int = Field(100, ge=1, le=1000)
    offset: int = Field(0, ge=0, le=10_000_000)


class RunList(BaseModel):
    """Some of the runs that match, of all that there are; `profiles` and `verdicts` are what can be chosen from."""

    total: int
    matched: int
    runs: Sequence[RunEntry]
    profiles: list[str]
    verdicts: list[str]
    states: list[str]


class FileEntry(BaseModel):
    """A file of a run folder."""

    name: str
    bytes: int


class RunAnswer(BaseModel):
    """All that a run folder says; `manifest` without what has a key of its own."""

    run: str
    unit: str
    state: str
    verdict: str
    sentence: str
    manifest: dict[str, Any]
    segments: list[dict[str, Any]]
    losses: dict[str, Any]
    events: list[dict[str, Any]]
    warnings: list[str]
    limits: dict[str, Any] | None
    comparison: dict[str, Any] | None
    diagnosis: dict[str, Any] | None
    files: list[FileEntry]
    outputs: list[str]
    """Rates of a unit with several; empty where it has one."""
    table: bool
    """Whether the rate of a rate table was recorded."""
    report: bool
    certificate: bool
    steps: Steps
    calibration: bool
    """Whether it has a calibration of its own, or is part of that of a whole unit."""
    verifies: str | None
    """The run whose calibration it verifies."""


@router.get("/runs")
def runs(request: Request, asked: Annotated[RunQuery, Query()]) -> RunList:
    """Runs that match, sorted, a page of them."""
    index = index_of(request)
    given = {name: getattr(asked, name) for name in ("unit", "state", "verdict", "profile")}
    found = index.matching(asked.q, {name: value for name, value in given.items() if value})
    everything = index.entries().values()
    page = ordered(found, asked.sort)[asked.offset : asked.offset + asked.limit]
    return RunList(
        total=len(everything),
        matched=len(found),
        runs=page,
        profiles=sorted({entry.profile for entry in everything}),
        verdicts=sorted({entry.verdict for entry in everything if entry.verdict}),
        states=sorted({entry.state for entry in everything}),
    )


@router.get("/runs/{unit}/{run}")
def run(request: Request, here: Here, unit: str, run: str) -> RunAnswer:
    """One run, whole; one that goes on or was cut off tells what it has so far."""
    index = index_of(request)
    entry, folder = index.entry(f"{unit}/{run}"), RunFolder(index.folder(unit, run))
    damaged: list[str] = []
    manifest = story.sound(Manifest, folder.path, damaged)
    own = story.sound(CalibrationRecord, folder.path, damaged)
    verified = story.sound(VerificationRecord, folder.path, damaged)
    limits, comparison, diagnosis = (
        record.content() if (record := story.sound(kind, folder.path, damaged)) else None
        for kind in (LimitsRecord, ComparisonRecord, DiagnosisRecord)
    )
    said = manifest.content() if manifest else {}
    whole, origin, names = whole_of(folder.path), verified_by(folder.path), _channels(folder.path)
    apart = {"segments", "losses", "files"}
    return RunAnswer(
        run=entry.run,
        unit=manifest.unit if manifest else entry.unit,
        state=entry.state,
        verdict=entry.verdict,
        sentence=own.verdict.sentence if own else verified.sentence if verified else "",
        manifest={key: value for key, value in said.items() if key not in apart},
        segments=said.get("segments", []),
        losses=said.get("losses", {}),
        events=story.events(folder.path)[-_MOST_EVENTS:],
        warnings=[*(within(here.project, text, here.out) for text in damaged), *(own.verdict.warnings if own else ())],
        limits=limits or (verified.judged.content() if verified else None),
        comparison=comparison,
        diagnosis=diagnosis,
        files=_files(folder.path),
        outputs=[name for name in RATES if name in names and name != "rate"],
        table="applied_rate" in names,
        report=folder.report.is_file() or (whole / "report.html").is_file(),
        certificate=_printed(whole) is not None,
        steps=steps_of(folder.path),
        calibration=whole != folder.path or (own is not None and own.calibration is not None),
        verifies=f"{entry.run.split('/')[0]}/{origin.name}" if origin else None,
    )


@router.get("/runs/{unit}/{run}/report", response_class=Response)
def report(request: Request, unit: str, run: str) -> FileResponse:
    """The run's HTML report, or that of the whole unit by it, in a sandbox: its scripts reach neither page nor API."""
    folder = index_of(request).folder(unit, run)
    own = folder if RunFolder(folder).report.is_file() else whole_of(folder)
    path = _existing(own / "report.html", "report: make one with `bench report`")
    return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT})


@router.get("/runs/{unit}/{run}/certificate", response_class=Response)
def certificate(request: Request, unit: str, run: str, draft: bool = False) -> FileResponse:
    """The certificate of the run's calibration, or of the whole unit by it, or its draft, PDF."""
    folder, name = whole_of(index_of(request).folder(unit, run)), "draft" if draft else "certificate"
    own = folder / f"{name}.pdf"
    path = _existing(own if draft else _printed(folder) or own, f"{name}: make one with `bench certificate`")
    return FileResponse(path, media_type="application/pdf", filename=f"{unit}-{run}-{name}.pdf")


def _printed(folder: Path) -> Path | None:
    """The PDF of the certificate of a calibration: in the folder of its run, or in that of the job which issued it."""
    if (own := folder / "certificate.pdf").is_file():
        return own
    told = story.sound(CertificateRecord, folder)
    return printed_certificate(folder.parent.parent, folder.parent.name, told.number) if told else None


@router.get("/runs/{unit}/{run}/data.csv", response_class=Response)
def data(request: Request, unit: str, run: str) -> StreamingResponse:
    """The run's 1 s means as CSV, as it is read: columns as in `means.parquet`, an empty cell for a gap."""
    path = _existing(index_of(request).folder(unit, run) / "means.parquet", "means: it has not ended whole")
    named = {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(f'{unit}-{run}.csv', safe='')}"}
    return StreamingResponse(_rows(path), media_type="text/csv; charset=utf-8", headers=named)


def _rows(path: Path) -> Iterator[str]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path, page_checksum_verification=True) as table:
        yield ",".join(table.schema_arrow.names) + "\n"
        for batch in table.iter_batches(batch_size=_BATCH_ROWS):
            text = io.StringIO()
            csv.writer(text, lineterminator="\n").writerows(zip(*(c.to_pylist() for c in batch.columns), strict=True))
            yield text.getvalue()


def _existing(path: Path, what: str) -> Path:
    if not path.is_file() or path.is_symlink():
        raise HTTPException(404, f"this run has no {what}")
    return path


def _channels(folder: Path) -> set[str]:
    """Channels of a run; none where they cannot be read."""
    with contextlib.suppress(InputError):
        return channels_in(folder)
    return set()


def _files(folder: Path) -> list[FileEntry]:
    found = []
    for path in sorted(folder.rglob("*")):
        with contextlib.suppress(OSError):  # removed meanwhile
            if path.is_file() and not path.name.startswith((".", LIVE)):
                found.append(FileEntry(name=path.relative_to(folder).as_posix(), bytes=path.stat().st_size))
    return found
