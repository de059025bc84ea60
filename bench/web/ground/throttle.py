"""Limits the number of wrong tokens from an address."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from cachetools import LRUCache

TRIES = 8
"""Number of wrong tokens that may come at once; afterwards one per `EACH_S`."""
EACH_S = 10.0
_ADDRESSES = 4096


class Throttle:
    """A leaking bucket for each address; addresses that were not seen for longest are forgotten first."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._full_until_s: LRUCache[str, float] = LRUCache(_ADDRESSES)

    def wait_s(self, address: str) -> int:
        """Seconds until this address may try again; 0: now."""
        over_s = self._full_until_s.get(address, 0.0) - self._clock() - (TRIES - 1) * EACH_S
        return max(math.ceil(over_s), 0)

    def wrong(self, address: str) -> None:
        """Count a wrong token."""
        now_s = self._clock()
        self._full_until_s[address] = max(self._full_until_s.get(address, 0.0), now_s) + EACH_S
