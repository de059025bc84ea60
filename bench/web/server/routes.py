"""All routes of the API. Their imports take most of a server's start, so the application imports this module last."""

from __future__ import annotations

from fastapi import Depends, FastAPI

from bench.web.imports import imports
from bench.web.jobs import jobs
from bench.web.live import calibrating, live, starting
from bench.web.people import session
from bench.web.people.access import at_least
from bench.web.plans import checking, editing, papers, plans
from bench.web.server.gate import API
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
LIFESPANS = (live.lifespan, runs.lifespan, jobs.lifespan, imports.lifespan)
"""What begins with the server and ends with it."""


def add_routes(app: FastAPI) -> None:
    """The API of an application, and what its routes share."""
    settings = app.state.settings
    app.state.stock = Stock(settings.out, settings.registry, lambda: settings.own)
    for router in OPEN:
        app.include_router(router, prefix=API)
    for router in GUARDED:
        app.include_router(router, prefix=API, dependencies=[Depends(at_least)])
