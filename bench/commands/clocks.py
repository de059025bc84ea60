"""Times that have not come yet: a clock was wrong, or is."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

FUTURE_S = 300.0
"""Clocks of two computers may differ by so much [s]."""


def tell_ahead(times: Iterable[tuple[str, str]]) -> None:
    """Warn once, on stderr, of each name whose time (ISO 8601) has not come yet."""
    latest = datetime.now(UTC) + timedelta(seconds=FUTURE_S)
    for name, created in times:
        try:
            when = datetime.fromisoformat(created)
        except ValueError:
            continue
        if when.tzinfo is not None and when > latest:
            text = f"says that it was made {created}, which has not come yet: a clock was or is wrong"
            print(f"bench: warning: {name} {text}", file=sys.stderr)
