"""How long to wait before something that failed is tried again."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BackOff:
    """Waits `first_s` [s] after the first failure, `factor` times longer after each further one, `most_s` [s] at most.

    The first value is short enough for a plug that was pulled by accident; the last one keeps a gateway that is busy
    rebooting from being hammered, and a bench from missing its return by more than half a minute.
    """

    first_s: float = 0.5
    most_s: float = 30.0
    factor: float = 2.0

    def wait_s(self, failures: int) -> float:
        """Time [s] to wait after this many failures in a row (1 or more)."""
        doublings = min(failures - 1, 64)  # beyond that the number would overflow, and `most_s` holds long before
        return float(min(self.first_s * self.factor**doublings, self.most_s))
