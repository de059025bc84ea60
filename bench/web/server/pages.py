"""The page and its files: one HTML page for all of its addresses, and nothing that the package did not ship."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

STATIC = Path(__file__).parents[1] / "static"
PLOTLY = Path(__file__).parents[2] / "deliver" / "report" / "assets" / "plotly-cartesian.min.js"

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


def add_pages(app: FastAPI) -> None:
    """Serve the page at its addresses, and its files below `/static`."""

    async def index() -> FileResponse:
        return FileResponse(STATIC / "index.html")

    async def plotly() -> FileResponse:
        return FileResponse(PLOTLY)

    further = tuple(f"{address}/{{rest:path}}" for address in ("/live", "/verdict", "/workbench"))
    for address in ADDRESSES + further:
        app.add_api_route(address, index, include_in_schema=False)
    app.add_api_route("/static/vendor/plotly-cartesian.min.js", plotly, include_in_schema=False)
    app.mount("/static", StaticFiles(directory=STATIC, check_dir=False))
