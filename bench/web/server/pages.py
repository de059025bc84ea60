"""The page and its files: one HTML page for all of its addresses, and what `hatch_build.py` has built from `page/`."""

from __future__ import annotations

import re
from mimetypes import guess_type
from pathlib import Path

from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from bench.base import InputError
from bench.web.ground.problems import problem

STATIC = Path(__file__).parents[1] / "static"

_BUILT = re.compile(r"[\w./-]{1,200}(?<!\.gz)")
_DIGEST = re.compile(r"-[A-Z0-9]{8}\.(js|css)$")
"""Of a file whose name changes with its content (build.js)."""

_NOT_BUILT = (
    "`bench ui` has no page: npm failed when the bench was installed; to build it, install again from the source "
    "folder where npm can be reached: `pip install --force-reinstall --no-deps .` (`-e .` if editable)"
)

ADDRESSES = (
    "/",
    "/start",
    "/live",
    "/verdict",
    "/workbench",
    "/units",
    "/units/{serial}",
    "/fleet",
    "/import",
    "/calibrations",
    "/laboratory",
    "/files",
    "/runs/{unit}/{run}",
    "/login",
)
"""What the page's own router knows; below some it may go on as it likes."""


def require_page() -> None:
    """InputError when the bench was installed without its page."""
    if not (STATIC / "index.html").is_file():
        raise InputError(_NOT_BUILT)


def add_pages(app: FastAPI) -> None:
    """Serve the page at its addresses, and its files below `/static`."""

    async def index() -> FileResponse:
        return FileResponse(STATIC / "index.html")

    further = tuple(f"{address}/{{rest:path}}" for address in ("/live", "/verdict", "/workbench", "/calibrations"))
    for address in ADDRESSES + further:
        app.add_api_route(address, index, include_in_schema=False)
    app.mount("/static", _Files(directory=STATIC, check_dir=False))

    @app.exception_handler(404)
    async def nowhere(request: Request, error: HTTPException) -> Response:
        """An address that nothing has: the page says so to people."""
        if request.method == "GET" and not request.url.path.startswith(("/api/", "/static/")):
            return FileResponse(STATIC / "index.html", 404)
        return problem(404, str(error.detail))


class _Files(StaticFiles):
    """What was built: packed where the browser takes it so; kept by browsers where its name has its digest."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        headers = Headers(scope=scope)
        takes = "gzip" in headers.get("accept-encoding", "") and _BUILT.fullmatch(path) is not None
        packed = takes and self.lookup_path(f"{path}.gz")[1] is not None
        answer = await super().get_response(f"{path}.gz" if packed else path, scope)
        if packed and answer.status_code == 200:
            answer.headers["Content-Encoding"] = "gzip"
            answer.headers["Content-Type"] = guess_type(path)[0] or "application/octet-stream"
        answer.headers["Vary"] = "Accept-Encoding"
        if _DIGEST.search(path) and answer.status_code in {200, 304}:
            answer.headers["Cache-Control"] = "public, max-age=31536000, immutable"
        return answer
