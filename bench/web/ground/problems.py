"""Errors as answers of the API: a status and `{"detail": "<one line>"}`."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from bench.base import BenchError, EquipmentError, InputError, RunAborted, library
from bench.web.ground.settings import Settings
from drivers.errors import ConfigError, DriverError, IdentityError, LimitError

_log = logging.getLogger("bench.web")
_REASON = 400
"""Characters of a reason."""

_MEANINGS = {
    400: "Bad input: what, where, the value, what is allowed",
    401: "The token is missing or not valid",
    403: "The role, the origin or the host does not allow this",
    404: "Not found",
    405: "The method is not allowed here",
    409: "The present state does not allow this",
    413: "The request is too large",
    415: "The content type is not accepted",
    422: "The request does not match its description",
    429: "Too many wrong tokens or requests; Retry-After says when to try again",
    502: "The equipment or the run failed",
    503: "Not available at present",
}


class NotFoundError(InputError):
    """A request names something that does not exist; the answer is 404."""


class CountingError(BenchError):
    """What a request asks for takes longer than anybody waits; the answer is 202 with Retry-After."""


class Problem(BaseModel):
    """An error, in one line that also says what to do."""

    detail: str


_JSON = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {"description": meaning, **({"model": Problem} if status == 400 else {"content": _JSON})}
    for status, meaning in _MEANINGS.items()
}
"""Error answers for the OpenAPI description; one has the model, as each route makes a validator of each model."""

COUNTING: dict[int | str, dict[str, Any]] = {
    202: {"description": "Still being counted; Retry-After says when to ask again", "content": _JSON}
}
"""Of a route whose answer may be a CountingError."""


def problem(status: int, detail: str, headers: dict[str, str] | None = None) -> JSONResponse:
    """An error as an answer."""
    return JSONResponse({"detail": one_line(detail)}, status, headers)


def one_line(text: str) -> str:
    """The lines of a message as one."""
    return "; ".join(line.strip() for line in text.splitlines() if line.strip())


def within(project: Path, text: str, *folders: Path) -> str:
    """The text with paths below the project and other `folders` as they are from there, shipped files in `profiles/`.

    Nobody at a page needs the server's folders.
    """
    for folder, name in (*((one, "") for one in (project, *folders)), (library(), "profiles/")):
        for place in {str(folder.absolute()), str(folder.resolve())}:
            text = re.sub(rf"(?<![\w.-]){re.escape(place)}/", name, text)
    return text


def _problem_of(request: Request, status: int, detail: str, headers: dict[str, str] | None = None) -> JSONResponse:
    here: Settings = request.app.state.settings
    return problem(status, within(here.project, detail, here.out), headers)


M = TypeVar("M", bound=BaseModel)


def row(project: Path, make: Callable[[], M], bad: Callable[[str], M]) -> M:
    """A row of a list that is made of a user's file: `make`, or `bad` with the reason where that fails.

    Whatever is wrong with one file, the other rows are answered.
    """
    try:
        made = make()
        json.dumps(made.model_dump(mode="json"), allow_nan=False, ensure_ascii=False).encode()
    except Exception as error:
        known = isinstance(error, (BenchError, DriverError, OSError))
        text = within(project, one_line(str(error).encode(errors="replace").decode()))
        return bad((text if known else f"cannot be read ({type(error).__name__}: {text})")[:_REASON])
    return made


def add_problems(app: FastAPI) -> None:
    """Turn the errors of bench, drivers and request validation into answers."""
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _unlike)
    app.add_exception_handler(BenchError, _bench)
    app.add_exception_handler(DriverError, _driver)
    app.add_exception_handler(OSError, _files)
    app.add_exception_handler(Exception, _ours)


async def _http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    headers = dict(error.headers) if error.headers else None
    return _problem_of(request, error.status_code, str(error.detail), headers)


async def _unlike(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    told = []
    for wrong in error.errors()[:5]:
        place = ".".join(str(part) for part in wrong["loc"])
        value = repr(wrong.get("input"))
        told.append(f"{place}: {wrong['msg']}" + (f", not {value[:60]}" if len(value) <= 200 else ""))
    return problem(422, "; ".join(told))


async def _bench(request: Request, error: Exception) -> JSONResponse:
    kinds = ((NotFoundError, 404), (CountingError, 202), (EquipmentError, 502), (RunAborted, 409), (BenchError, 400))
    status = next(status for kind, status in kinds if isinstance(error, kind))
    again = {"Retry-After": "1"} if isinstance(error, CountingError) else None
    return _problem_of(request, status, str(error), again)


async def _driver(request: Request, error: Exception) -> JSONResponse:
    return _problem_of(request, 400 if isinstance(error, (ConfigError, LimitError, IdentityError)) else 502, str(error))


async def _files(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, OSError)
    _log.error("%s %s", request.method, request.url.path, exc_info=error)
    file, advice = error.filename or "its files", "tell whoever is in charge of its computer"
    text = f"the server cannot read or write {file}: {error.strerror or error}; runs go on: {advice}"
    return _problem_of(request, 503, text)


async def _ours(request: Request, error: Exception) -> JSONResponse:
    _log.error("%s %s", request.method, request.url.path, exc_info=error)
    return problem(500, "the server failed with an internal error; its terminal shows the details, please report them")
