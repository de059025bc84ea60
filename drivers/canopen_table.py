"""A rate table with a CiA 402 drive in profile velocity mode; see `drivers.canopen_drive`."""

from __future__ import annotations

from drivers import cia402
from drivers.canopen_drive import CanopenDrive
from drivers.errors import IdentityError
from drivers.rate_table import STOPPED_DPS

PROBE_DPS, PROBE_S = 1.0, 2.0


class CanopenTable(CanopenDrive):
    """One axis that turns. See `drivers.rate_table.RateTable`."""

    MODE, MODE_NAME, NAME = cia402.PROFILE_VELOCITY, "profile velocity", "rate table"

    def enable(self) -> None:
        """Go through the state machine to `operation enabled`, target rate 0 first; a fault is never cleared.

        Then verify the unit of velocity at a slow rate: it is a setting of the drive that no object reports.
        """
        self._set_mode()
        self.set_rate(0.0)
        self._switch_on()
        self._verify_unit()

    def _verify_unit(self) -> None:
        """IdentityError when the position does not change at the commanded velocity."""
        commanded = min(PROBE_DPS, self.limits.rate_dps)
        self.set_rate(commanded)
        self._wait(1.0)
        from_s, start = self._clock.now(), self.position()
        self._wait(PROBE_S)
        measured = (self.position() - start) / (self._clock.now() - from_s)
        self.stop()
        if abs(measured - commanded) > 0.1 * commanded:
            text = f"commanded {commanded:g} deg/s, its position moves by {measured:.4g} deg/s"
            raise IdentityError(f"{self}: {text}; set the drive's velocity to counts per second, correct the gear")

    def set_rate(self, rate_dps: float, accel_dps2: float | None = None) -> None:
        """Set the acceleration, then the target rate; each is read back."""
        accel = self._accel(accel_dps2)
        self.limits.check(rate_dps, accel)
        for index in (cia402.ACCELERATION, cia402.DECELERATION):
            self._set(index, self._counts(accel))
        self._set(cia402.TARGET_VELOCITY, self._counts(rate_dps))
        self.commanded_dps = rate_dps

    def stop(self) -> None:
        """Go to rate 0 with the usual acceleration; ReadBackError when the table does not come to a standstill."""
        limit_s = abs(self.rate()) / self.limits.accel_dps2 + 5.0
        self.set_rate(0.0)
        self._await(lambda: abs(self.rate()) < STOPPED_DPS, limit_s, "standing")
