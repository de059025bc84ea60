"""What the effects that change the scale factor share: terms by powers, the lowest of which is its offset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np

from bench.analysis.effects.base import Effect, Scale, Theta, check_choice, check_whole
from bench.base import DPH_PER_DPS, FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class ScaleFactorTerms(Effect):
    """Terms up to the power `order`; `constant` false leaves out that of the power `first`."""

    letter: ClassVar[str]
    units: ClassVar[tuple[str, ...]]
    """By power."""
    first: ClassVar[int]

    order: int = 2
    constant: bool = True

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, self.first + 1, len(self.units) - 1)
        check_choice(self.name, "constant", self.constant, (True, False))

    def prepare(self, records: Sequence[Dataset]) -> Self:
        """Checks that the table turned."""
        Scale.of(records, "applied_rate")
        return self

    @property
    def shared(self) -> str:
        """The constant of the scale factor."""
        return "scale factor" if self.constant else ""

    def without_shared(self) -> Effect:
        """Without the constant."""
        return replace(self, constant=False)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Bias per coefficient (n, k) [deg/h]."""
        terms = (record.mean_of(partial(self.term, power), *self.needs) for power in self._powers)
        return np.column_stack([1e-6 * DPH_PER_DPS * each for each in terms])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """One a power."""
        return tuple((f"{self.letter}{power}", self.units[power]) for power in self._powers)

    @property
    def _powers(self) -> range:
        return range(self.first if self.constant else self.first + 1, self.order + 1)

    @staticmethod
    def term(power: int, channels: Mapping[str, FloatArray]) -> FloatArray:
        """The term of this power (n,), times a million over its coefficient [deg/s]."""
        raise NotImplementedError
