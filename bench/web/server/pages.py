"""The page and its files: one HTML page for all of its addresses, and what `hatch_build.py` has built from `page/`."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

from bench.base import InputError

STATIC = Path(__file__).parents[1] / "static"

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
    "/login",
)
"""What the page's own router knows; below `/live`, `/verdict` and `/workbench` it may go on as it likes."""


def require_page() -> None:
    """InputError when the bench was installed without its page."""
    if not (STATIC / "index.html").is_file():
        raise InputError(_NOT_BUILT)


def add_pages(app: FastAPI) -> None:
    """Serve the page at its addresses, and its files below `/static`."""

    async def index() -> FileResponse:
        return FileResponse(STATIC / "index.html")

    further = tuple(f"{address}/{{rest:path}}" for address in ("/live", "/verdict", "/workbench"))
    for address in ADDRESSES + further:
        app.add_api_route(address, index, include_in_schema=False)
    app.mount("/static", StaticFiles(directory=STATIC, check_dir=False))
