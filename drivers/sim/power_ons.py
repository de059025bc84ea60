"""How often a simulated unit was powered: a count that it keeps with its memory, so that it outlives the process."""

from __future__ import annotations

import os
from pathlib import Path

from drivers.errors import ConfigError
from drivers.system import hold


class PowerOns:
    """The count of power-ons of one unit, in a file beside its EEPROM, or in memory for None."""

    def __init__(self, path: Path | None = None, count: int = 0) -> None:
        """`count` is the number of the power-on that lasts now; 0: the unit is not powered yet."""
        self._path, self.count = path, count

    def next(self) -> int:
        """Power the unit once more; number of this power-on, 1 for the first. ConfigError for a file that is none."""
        if self._path is None:
            self.count += 1
            return self.count
        self._path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        with os.fdopen(handle, "r+b", buffering=0) as file:
            hold(file, wait=True)  # two benches may power the same simulated unit
            stored = file.read().strip()
            if stored and not stored.isdigit():
                text = f"{self._path}: must hold how often the unit was powered, a whole number, not {stored[:20]!r}"
                raise ConfigError(f"{text}; delete it to count from 1 again")
            self.count = int(stored or b"0") + 1
            file.seek(0)
            file.write(b"%d\n" % self.count)  # never shorter than before
            file.flush()
            os.fsync(file.fileno())
        return self.count
