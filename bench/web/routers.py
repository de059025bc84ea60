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
    found = []
    for name in NAMES:
        try:
            found.append(importlib.import_module(f"bench.web.{name}"))
        except ModuleNotFoundError as error:
            if error.name != f"bench.web.{name}":
                raise
    return found
