"""What a unit says about its own samples: status signals, and the values of them with which a sample may be used.

A DBC describes them beside the signals, with two attributes of type STRING:

* `BenchValid`: raw values with which samples are valid, such as "1" or "0..2,5"; every other value makes them invalid
* `BenchRaw`: raw values with which the unit sends its raw rate; with every other one it corrects its rate itself

Signals of the usual names need no attribute: `RateValid`, `LoopLocked`, `RateSaturated`, `Status`, `State`,
`CompensationActive`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.errors import ConfigError
from drivers.wire import ByteArray, Message, Signal

BoolArray = npt.NDArray[np.bool_]

VALID, RAW = "BenchValid", "BenchRaw"
_USUALLY_VALID = {"RateValid": "1", "LoopLocked": "1", "RateSaturated": "0", "Status": "0..2", "State": "0,5,127"}
"""`Status` as in `vibratory.dbc`: 1 and 2 concern the unit's own correction; `State`: CiA 301, 4 is "stopped"."""
_USUALLY_RAW = {"CompensationActive": "0"}
_WORD = np.dtype("<u8")
_HOW = 'raw values and ranges such as "0" or "0..2,5"'


class States:
    """The status signals of one message.

    ConfigError where an attribute of the DBC cannot be understood.
    """

    def __init__(self, message: Message) -> None:
        self._valid = _watched(message, VALID, _USUALLY_VALID)
        self._raw = _watched(message, RAW, _USUALLY_RAW)
        signals = [signal for signal, _ in (*self._valid, *self._raw)]
        self.watched, self.tells_correction = bool(signals), bool(self._raw)
        mask = 0
        for signal in signals:
            mask |= signal.bits((1 << signal.length) - 1) << 8 * signal.first
        self._mask = np.frombuffer(mask.to_bytes(max(message.width, 8), "little"), dtype=np.uint8)
        self._known: dict[bytes, tuple[tuple[str, ...], bool]] = {}

    def read(self, data: ByteArray) -> tuple[Mapping[str, BoolArray], BoolArray | None]:
        """Which payloads (n, width) are not valid, by reason, and which carry a corrected rate; None: none does."""
        faults: dict[str, BoolArray] = {}
        corrected: BoolArray | None = None
        if not self.watched or not len(data):
            return faults, corrected
        words: npt.NDArray[Any]
        if len(self._mask) == 8:
            words = data.view(_WORD)[:, 0] & self._mask.view(_WORD)[0]
        else:
            words = (data & self._mask).view(f"V{len(self._mask)}")[:, 0]
        patterns = words[:1] if (words == words[0]).all() else np.unique(words)
        for pattern in patterns:
            reasons, corrects = self._judged(pattern.tobytes())
            if reasons or corrects:
                here: BoolArray = words == pattern
                for why in reasons:
                    faults[why] = faults[why] | here if why in faults else here
                if corrects:
                    corrected = here if corrected is None else corrected | here
        return faults, corrected

    def sound(self) -> dict[str, int]:
        """Raw values of the status signals with which samples are valid and raw."""
        return {signal.name: allowed[0].start for signal, allowed in (*self._valid, *self._raw)}

    def _judged(self, pattern: bytes) -> tuple[tuple[str, ...], bool]:
        if pattern not in self._known:
            data = np.frombuffer(pattern, dtype=np.uint8).reshape(1, -1)
            wrong = tuple(
                _said(signal, value)
                for signal, allowed in self._valid
                if not _within(value := int(signal.unpack(data)[0]), allowed)
            )
            corrects = any(not _within(int(signal.unpack(data)[0]), allowed) for signal, allowed in self._raw)
            self._known[pattern] = wrong, corrects
        return self._known[pattern]


def _watched(message: Message, attribute: str, usual: Mapping[str, str]) -> list[tuple[Signal, list[range]]]:
    found = []
    for name, signal in message.signals.items():
        text = signal.attributes.get(attribute, usual.get(name))
        if text is not None and not signal.is_float:
            found.append((signal, _ranges(text, f"{message.name}.{name}: {attribute}")))
    return found


def _ranges(text: str, where: str) -> list[range]:
    """The values that an attribute lists."""
    found = []
    for part in text.split(","):
        ends = part.split("..")
        try:
            first, last = int(ends[0]), int(ends[-1])
        except ValueError:
            first, last = 1, 0
        if len(ends) > 2 or last < first:
            raise ConfigError(f"{where} is '{text}'; it must list {_HOW}")
        found.append(range(first, last + 1))
    if any(after.start < before.stop for before, after in pairwise(sorted(found, key=lambda one: one.start))):
        raise ConfigError(f"{where} is '{text}': a value is listed twice")
    return found


def _within(value: int, allowed: list[range]) -> bool:
    return any(value in one for one in allowed)


def _said(signal: Signal, value: int) -> str:
    meaning = signal.names.get(value)
    return f"{signal.name} = {value}" + (f" ({meaning})" if meaning else "")
