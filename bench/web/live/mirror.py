"""A copy of a live run's trace (`recording.trace`), fetched page by page for any number of browsers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_FACTS = ("generation", "every_s", "serials")


class Mirror:
    """Written by one thread, read by any; memory is bounded by the trace itself."""

    def __init__(self) -> None:
        self._shown: tuple[dict[str, Any], list[Any]] = ({"generation": -1, "every_s": 1.0, "serials": []}, [])
        self._made: tuple[dict[str, Any], list[Any]] | None = None
        self._open: Any = None
        self.behind = False
        """Whether there is more to fetch."""

    @property
    def wanted(self) -> tuple[int, int]:
        """Since which index, of which generation, to ask next."""
        facts, points = self._made or self._shown
        return len(points), facts["generation"]

    def take(self, page: Mapping[str, Any]) -> None:
        """Take in a page. A new generation is shown when it is whole, so that nobody sees a curve without its end."""
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
        """What `Trace.since` answers, without pages: all points from `index` on, or from the first one."""
        return self._page(index, generation, whole=True)

    def news(self, index: int, generation: int) -> dict[str, Any]:
        """For who is told everything: points from `index` on; none, but where it stands, after a halving."""
        return self._page(index, generation, whole=False)

    def _page(self, index: int, generation: int | None, *, whole: bool) -> dict[str, Any]:
        """Points from `index` on; where that is a place in another trace, the `whole` one, or none."""
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
