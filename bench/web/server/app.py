"""The application: gate, problems, API, page."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

from fastapi import Depends, FastAPI
from fastapi.middleware.gzip import GZipMiddleware

from bench.base import __version__
from bench.web.ground.problems import RESPONSES, add_problems
from bench.web.ground.settings import Settings
from bench.web.imports import imports
from bench.web.jobs import jobs
from bench.web.live import calibrating, live, starting
from bench.web.people import session
from bench.web.people.access import Access, at_least
from bench.web.plans import checking, editing, papers, plans
from bench.web.server.gate import API, Gate
from bench.web.server.pages import add_pages
from bench.web.shelf import actions, fleet, notes, runs, units
from bench.web.shelf.stock import Stock
from bench.web.workbench import analyses, diagnoses, figures, models, notebook

OPEN = (session.router,)
"""Routes that anybody may call: signing in."""
GUARDED = (
    plans.router,
    checking.router,
    papers.router,
    editing.router,
    starting.router,
    calibrating.router,
    live.router,
    runs.router,
    notes.router,
    actions.router,
    jobs.router,
    analyses.router,
    figures.router,
    diagnoses.router,
    models.router,
    notebook.router,
    units.router,
    fleet.router,
    imports.router,
)
"""Routes that need a role: a viewer to look, an operator to change something, or what a route says itself."""
PACKED_BYTES, PACKED_LEVEL = 1000, 5
"""Answers from this size on are packed for browsers that take them so, except events and what is packed already."""
LIFESPANS = (live.lifespan, runs.lifespan, jobs.lifespan, imports.lifespan)
"""What begins with the server and ends with it."""


def create_app(settings: Settings) -> FastAPI:
    """The application of one server; InputError when its access file is not sound."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for begin in LIFESPANS:
                await stack.enter_async_context(begin(app))
            yield

    app = FastAPI(
        title="Thermal test bench for gyroscopes",
        version=__version__,
        openapi_url=f"{API}/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        redirect_slashes=False,
        responses=RESPONSES,
    )
    app.state.settings = settings
    app.state.access = Access(settings)
    app.state.stock = Stock(settings.out, settings.registry, lambda: settings.own)
    add_problems(app)
    for router in OPEN:
        app.include_router(router, prefix=API)
    for router in GUARDED:
        app.include_router(router, prefix=API, dependencies=[Depends(at_least)])
    add_pages(app)
    app.add_middleware(GZipMiddleware, minimum_size=PACKED_BYTES, compresslevel=PACKED_LEVEL)
    app.add_middleware(Gate, settings=settings)
    return app
