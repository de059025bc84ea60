"""A copy of a live run's trace (`recording.trace`), fetched page by page and served to all browsers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_FACTS = ("generation", "every_s", "serials")


class Mirror:
    """One thread writes it, any thread reads it; the trace itself bounds the memory."""

    def __init__(self) -> None:
        self._shown: tuple[dict[str, Any], list[Any]] = ({"generation": -1, "every_s": 1.0, "serials": []}, [])
        self._made: tuple[dict[str, Any], list[Any]] | None = None
        self._open: Any = None
        self.behind = False
        """Whether more pages must be fetched."""

    @property
    def wanted(self) -> tuple[int, int]:
        """Index and generation from which to ask next."""
        facts, points = self._made or self._shown
        return len(points), facts["generation"]

    def take(self, page: Mapping[str, Any]) -> None:
        """Take in a page. A new generation is shown once it is complete, so that no curve lacks its end."""
        facts = {key: page[key] for key in _FACTS}
        points: list[Any] = page["points"]
        self.behind = page["next"] < page["count"]
        if page["first"] == 0 and facts["generation"] != self._shown[0]["generation"]:
            self._made = facts, list(points)
        elif self._made is not None:
            self._made[1].extend(points)
        else:
            self._shown = facts, self._shown[1]
            self._shown[1].extend(points)
        if self._made is not None and not self.behind:
            self._shown, self._made = self._made, None
        if self._made is None:
            self._open = page["open"]

    def since(self, index: int = 0, generation: int | None = None) -> dict[str, Any]:
        """The answer of `Trace.since` without pages: all points from `index` on, or all for another generation."""
        return self._page(index, generation, whole=True)

    def news(self, index: int, generation: int) -> dict[str, Any]:
        """The increment for a stream: points from `index` on; none, with the new index, after a halving."""
        return self._page(index, generation, whole=False)

    def _page(self, index: int, generation: int | None, *, whole: bool) -> dict[str, Any]:
        """Points from `index` on; for an index of another generation the `whole` trace, or none."""
        facts, points = self._shown
        count = len(points)
        ours = generation in (None, facts["generation"]) and 0 <= index <= count
        first = index if ours else 0 if whole else count
        return {
            **facts,
            "first": first,
            "next": count,
            "count": count,
            "points": points[first:count],
            "open": self._open,
        }
