"""The table of the campaign, from its cached results."""

from __future__ import annotations

from typing import Any


def document(results: list[dict[str, Any]]) -> str:
    return f"{len(results)} cases\n"
