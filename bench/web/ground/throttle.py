"""How often an address may be wrong about a token."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable

TRIES = 8
"""So many wrong tokens at once, then one each `EACH_S`."""
EACH_S = 10.0
_ADDRESSES = 4096


class Throttle:
    """A leaking bucket for each address; the oldest are forgotten when there are very many."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._full_until_s: OrderedDict[str, float] = OrderedDict()

    def wait_s(self, address: str) -> int:
        """Seconds until this address may try again; 0: now."""
        over_s = self._full_until_s.get(address, 0.0) - self._clock() - (TRIES - 1) * EACH_S
        return max(math.ceil(over_s), 0)

    def wrong(self, address: str) -> None:
        """Take note of a wrong token."""
        now_s = self._clock()
        self._full_until_s[address] = max(self._full_until_s.get(address, 0.0), now_s) + EACH_S
        self._full_until_s.move_to_end(address)
        while len(self._full_until_s) > _ADDRESSES:
            self._full_until_s.popitem(last=False)
