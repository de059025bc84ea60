"""The modules that serve the API; each has a `router` without prefix, some a `lifespan(app)`."""

from __future__ import annotations

from bench.web.imports import imports
from bench.web.jobs import jobs
from bench.web.live import live, starting
from bench.web.people import session
from bench.web.plans import checking, plans
from bench.web.shelf import fleet, runs, units
from bench.web.workbench import analyses, diagnoses, figures, models

MODULES = (
    session,
    plans,
    checking,
    starting,
    live,
    runs,
    jobs,
    analyses,
    figures,
    diagnoses,
    models,
    units,
    fleet,
    imports,
)
