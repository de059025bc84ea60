"""The application: gate, problems and page at once; the API as soon as it is imported."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from importlib import import_module

from fastapi import FastAPI
from fastapi.middleware.gzip import GZipMiddleware

from bench.base import __version__
from bench.web.ground.problems import RESPONSES, add_problems
from bench.web.ground.settings import Settings
from bench.web.people.access import Access
from bench.web.server.gate import API, Gate
from bench.web.server.pages import add_pages

PACKED_BYTES, PACKED_LEVEL = 1000, 5
"""Answers from this size on are packed for browsers that take them so, except events and what is packed already."""
_ROUTES = "bench.web.server.routes"


def create_app(settings: Settings) -> FastAPI:
    """The application of one server; InputError when its access file is not sound.

    It serves the page from the beginning; requests to the API wait until `app.state.api` is done.
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            app.state.api = asyncio.create_task(_begin(app, stack))
            try:
                yield
            finally:
                await asyncio.wait([app.state.api])

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
    add_problems(app)
    add_pages(app)
    app.add_middleware(GZipMiddleware, minimum_size=PACKED_BYTES, compresslevel=PACKED_LEVEL)
    app.add_middleware(Gate, settings=settings)
    return app


async def _begin(app: FastAPI, stack: AsyncExitStack) -> None:
    """Import the API while the page is served already, and begin what it needs."""
    routes = await asyncio.to_thread(import_module, _ROUTES)
    for begin in routes.LIFESPANS:
        await stack.enter_async_context(begin(app))
    routes.add_routes(app)


def failure(app: FastAPI) -> BaseException | None:
    """Why the API could not begin; None where it did, or still may."""
    api: asyncio.Task[None] | None = getattr(app.state, "api", None)
    return api.exception() if api and api.done() and not api.cancelled() else None
