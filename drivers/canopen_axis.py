"""An axis of a fixture with a CiA 402 drive in profile position mode; see `drivers.canopen_drive`.

Its zero is that of the drive: an absolute encoder, or a reference run that was made before the bench is started.
"""

from __future__ import annotations

from drivers import cia402
from drivers.canopen_drive import CanopenDrive
from drivers.errors import LimitError, ReadBackError

REACHED_DEG = 0.05
"""Largest distance from the commanded position at which the axis has arrived [deg]."""


class CanopenAxis(CanopenDrive):
    """One axis that goes to positions; `limits.rate_dps` is the speed at which it goes."""

    MODE, MODE_NAME, NAME = cia402.PROFILE_POSITION, "profile position", "fixture axis"

    def enable(self) -> None:
        """Switch the axis on where it stands, with its present position as target."""
        self._set_mode()
        self._set(cia402.TARGET_POSITION, self._get(cia402.POSITION))
        self._set(cia402.PROFILE_SPEED, self._counts(self.limits.rate_dps))
        for index in (cia402.ACCELERATION, cia402.DECELERATION):
            self._set(index, self._counts(self.limits.accel_dps2))
        self._switch_on()

    def go(self, position_deg: float) -> None:
        """Start towards a position [deg] by the drive's own profile; does not wait until the axis has arrived.

        LimitError where the drive's 32 bits do not hold it; nothing is sent then.
        """
        if not abs(self._counts(position_deg)) < 1 << 31:
            raise LimitError(
                f"{self}: position {position_deg:g} deg does not fit the drive's 32 bits; nothing was sent"
            )
        self._commanded_deg = position_deg
        self._set(cia402.TARGET_POSITION, self._counts(position_deg))
        self._command(cia402.NEW_SET_POINT)
        self._await(lambda: self._has(cia402.SET_POINT_TAKEN), 2.0, "new set point taken")
        self._command(cia402.ENABLE_OPERATION)  # so that the next set point is a new one

    @property
    def arrived(self) -> bool:
        """Whether the drive says that it has reached the target.

        ReadBackError where its encoder then reads another position.
        """
        if not self._has(cia402.TARGET_REACHED):
            return False
        if abs(off := self.position() - self._commanded_deg) > REACHED_DEG:
            text = f"{self}: target reached, but its encoder reads {self.position():.3f} deg, {off:+.3f} deg off"
            raise ReadBackError(f"{text}; look at its gear and counts_per_degree")
        return True

    def longest_s(self, position_deg: float) -> float:
        """Time in which it must have got there [s]: twice that of the profile, and 10 s."""
        way = abs(position_deg - self.position())
        return 2.0 * (way / self.limits.rate_dps + self.limits.rate_dps / self.limits.accel_dps2) + 10.0

    def _has(self, bit: int) -> bool:
        return bool(self._get(cia402.STATUS) & bit)
