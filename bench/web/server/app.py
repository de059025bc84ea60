"""The application: gate, problems, API, page."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

from fastapi import Depends, FastAPI

from bench.base import __version__
from bench.web.ground.problems import RESPONSES, add_problems
from bench.web.ground.settings import Settings
from bench.web.people.access import Access, at_least
from bench.web.server.gate import Gate
from bench.web.server.pages import add_pages
from bench.web.server.routers import MODULES

API = "/api/v1"


def create_app(settings: Settings) -> FastAPI:
    """The application of one server; InputError when its access file is not sound."""
    routers = MODULES

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for module in routers:
                if hasattr(module, "lifespan"):
                    await stack.enter_async_context(module.lifespan(app))
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
    add_problems(app)
    for module in routers:
        # A route that says nothing of roles is not open to everybody.
        guards = [] if module.__name__.endswith(".session") else [Depends(at_least)]
        app.include_router(module.router, prefix=API, dependencies=guards)
    add_pages(app)
    app.add_middleware(Gate, settings=settings)
    return app
