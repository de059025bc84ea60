"""Waiting times before something that failed is tried again."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BackOff:
    """Waits `first_s` [s] after the first failure, `factor` times longer after each further one, `most_s` [s] at most.

    The first value suits a plug that was pulled by accident. The last one limits the load on a gateway that reboots,
    and the delay with which the bench notices its return.
    """

    first_s: float = 0.5
    most_s: float = 30.0
    factor: float = 2.0

    def wait_s(self, failures: int) -> float:
        """Time [s] to wait after this many failures in a row (1 or more)."""
        doublings = min(failures - 1, 64)  # more would overflow; `most_s` applies long before
        return float(min(self.first_s * self.factor**doublings, self.most_s))
