"""What a set of positions, rates and temperatures determines, by name: before a run from the plan, after it from U.

Before: the columns of a plan, without any output. A parameter is determined where no change of it can be made up for
by the others. After: a U larger than the parameter is in any unit says as much of what was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.analysis.imu.fitting import TriadFit, design, span
from bench.analysis.imu.triad import Term, Triad, TriadModel, terms
from bench.analysis.thresholds import LEAST_RANGE_DEGC
from bench.base import FloatArray, InputError

_RANK = 1e-7
"""Singular values below this share of the largest count as zero."""
_PART = 1e-3
"""Share of a direction that is not determined from which on a parameter belongs to it."""
LARGEST = {
    "scale factor": 10_000.0, "misalignment": 20.0, "g-sensitivity": 200.0, "second order": 2000.0,
    "third order": 5000.0, "fourth order": 5000.0, "fifth order": 5000.0,
}  # fmt: skip
"""U above which a parameter counts as not determined: more than it is in a bad unit, in its unit."""
LARGEST_BIAS = {"gyro": 2000.0, "accelerometer": 0.5}


@dataclass(frozen=True)
class Undetermined:
    """A parameter that the rows do not determine."""

    parameter: str
    why: str

    def __str__(self) -> str:
        return f"{self.parameter}: {self.why}"


def before(data: Triad, model: TriadModel) -> tuple[Undetermined, ...]:
    """What a plan cannot determine; outputs are not looked at."""
    return tuple(found for axis in range(3) for found in _axis(data, axis, model))


def after(fit: TriadFit, temperatures: Sequence[float]) -> tuple[Undetermined, ...]:
    """Parameters whose U at one of the temperatures is larger than the parameter is in any unit."""
    found: dict[str, Undetermined] = {}
    for estimate in fit.estimates(temperatures):
        limit = LARGEST.get(estimate.kind, LARGEST_BIAS[fit.kind])
        if not (0.0 <= estimate.U <= limit) and estimate.name not in found:
            where = f"at {estimate.temperature:g} degC U = {estimate.U:.3g} {estimate.unit}"
            found[estimate.name] = Undetermined(estimate.name, f"{where}, more than the {limit:g} of a bad unit")
    return tuple(found.values())


def refuse_undetermined(data: Triad, model: TriadModel) -> None:
    """InputError that names what the plan cannot determine and what would."""
    found = before(data, model)
    if found:
        raise InputError(
            f"these positions, rates and temperatures do not determine {'; '.join(str(one) for one in found)}"
        )


def _axis(data: Triad, axis: int, model: TriadModel) -> list[Undetermined]:
    own = tuple(terms(model, data.kind, axis, span(data, axis)))
    columns = design(data, axis, own, (), {})
    size = np.linalg.norm(columns, axis=0)
    loose = _loose(columns / np.where(size > 0.0, size, 1.0), size)
    ends = np.cumsum([0, *(term.curve.size for term in own)])
    share = np.array([loose[a:b].max(initial=0.0) for a, b in pairwise(ends)])
    named = [term for term, part in zip(own, share, strict=True) if part > _PART]
    return [Undetermined(term.name, _why(term, data, axis, named)) for term in named]


def _loose(columns: FloatArray, size: FloatArray) -> FloatArray:
    """How much of each coefficient lies in directions that the columns do not determine (p,), 0 to 1."""
    _, s, vt = np.linalg.svd(columns, full_matrices=True)
    s = np.concatenate([s, np.zeros(len(vt) - len(s))])
    loose = np.linalg.norm(vt[s <= _RANK * s[0]], axis=0)
    loose[size == 0.0] = 1.0
    return np.asarray(loose)


def _why(term: Term, data: Triad, axis: int, named: Sequence[Term]) -> str:
    low, high = span(data, axis)
    if high - low <= LEAST_RANGE_DEGC and term.curve.size > 1:
        return f"the temperature moves by {high - low:.2g} degC only; needs more temperatures or order 0"
    drive = term.drive(data, axis)
    if not np.any(drive):
        return "nothing drives it; needs an attitude or a rate along that axis"
    others = [other.name.split(": ")[1] for other in named if other is not term]
    if np.ptp(drive) < 1e-9 * np.max(np.abs(drive)) and term.kind != "bias":
        return f"what drives it never changes; it is one with {', '.join(others)}"
    return f"one with {', '.join(others)} here" if others else "too few temperatures for the order of its curve"
