"""The modules that serve the API; each has a `router` without prefix, some a `lifespan(app)`."""

from __future__ import annotations

import importlib
from types import ModuleType

NAMES = (
    "session",
    "plans",
    "checking",
    "starting",
    "live",
    "runs",
    "jobs",
    "analyses",
    "figures",
    "diagnoses",
    "models",
    "units",
    "fleet",
    "imports",
)


def modules() -> list[ModuleType]:
    """All of them, in order."""
    return [importlib.import_module(f"bench.web.{name}") for name in NAMES]
