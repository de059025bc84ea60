"""Ids of runs that are the same on every bench."""

from __future__ import annotations

import re

_RUN = re.compile(r"[0-9a-f]{12}/[^/]+/[^/]+")


def is_run_id(text: str) -> bool:
    """Whether a text may be the id of a run at a centre: archive/unit/folder."""
    return _RUN.fullmatch(text) is not None
