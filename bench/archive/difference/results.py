"""Differences in the results of two runs: quantities, coefficients with their uncertainty, model curves."""

from __future__ import annotations

from math import hypot, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import Source, source_of
from bench.base import BoolArray, FloatArray, InputError, finite
from bench.record import CalibrationRecord, Coefficient, StoredModel, StoredQuantity

BEYOND_CHANCE = 3.0
"""Coefficients count as different beyond this number of standard deviations of their difference."""
EXACT_SHARE = 0.005
"""Numbers without an uncertainty count as different beyond this share of the larger …"""
_ROUGH = {"condition": 0.5}
"""… except these, which must differ more …"""
_NO_RESULT = {"extrapolated_percent"}
"""… and these, which change with every record."""
BINS = 25

Entry = dict[str, Any]


def quantities(a: CalibrationRecord, b: CalibrationRecord) -> list[Entry]:
    """Quantities of calibration.json whose 95 % intervals do not overlap, the largest difference first."""
    one, other = ({entry.name: entry for entry in side.quantities or ()} for side in (a, b))
    found: list[Entry] = []
    for name in dict.fromkeys([*one, *other]).keys() - _NO_RESULT:
        x, y = one.get(name), other.get(name)
        apart = _apart(x, y)
        if apart > 0.0:
            known = x or y or StoredQuantity(name=name)
            entry: Entry = {"quantity": name, "unit": known.unit, "meaning": known.meaning}
            found.append({**entry, "a": _told(x), "b": _told(y), "apart": finite(apart)})
    far = {str(entry["quantity"]): np.inf if entry["apart"] is None else entry["apart"] for entry in found}
    return sorted(found, key=lambda entry: (-far[entry["quantity"]], entry["quantity"]))


def _apart(x: StoredQuantity | None, y: StoredQuantity | None) -> float:
    """Difference in half-widths of the intervals; infinite without intervals, or where only one run has the number."""
    if x is None or y is None or x.value is None or y.value is None:
        known = [side for side in (x, y) if side is not None and side.value is not None]
        return np.inf if known else 0.0
    one, other = x.value, y.value
    difference = abs(one - other)
    width = sum(side.high - side.low for side in (x, y) if side.high is not None and side.low is not None)
    if not width:
        return np.inf if difference > _ROUGH.get(x.name, EXACT_SHARE) * max(abs(one), abs(other)) else 0.0
    return difference / (0.5 * width) if difference > 0.5 * width else 0.0


def _told(side: StoredQuantity | None) -> Entry | None:
    return None if side is None else side.model_dump(include={"value", "low", "high", "reason"})


def coefficients(a: CalibrationRecord, b: CalibrationRecord) -> Entry:
    """Coefficients and parameters that differ beyond chance, by z-score, or the reason why they cannot be compared."""
    one, other = a.calibration, b.calibration
    if not one or not other:
        reason = (
            "neither A nor B has a calibration"
            if not one and not other
            else f"{'B' if one else 'A'} has no calibration"
        )
        return {"comparable": False, "reason": reason, "differ": [], "agree": 0}
    if (text := _unlike(one.model, other.model)) is not None:
        return {"comparable": False, "reason": text, "differ": [], "agree": 0}
    sides = [{c.key: c for c in (*side.coefficients, *side.parameters)} for side in (one, other)]
    found = [_coefficient(key, sides[0][key], sides[1][key]) for key in sides[0] if key in sides[1]]
    differ = [entry for entry in found if entry["z"] is None or abs(entry["z"]) > BEYOND_CHANCE]
    differ = [entry for entry in differ if entry["a"] != entry["b"]]
    differ.sort(key=lambda entry: -abs(np.inf if entry["z"] is None else entry["z"]))
    return {"comparable": True, "reason": "", "differ": differ, "agree": len(found) - len(differ)}


def _unlike(a: StoredModel, b: StoredModel) -> str | None:
    """The reason why the coefficients of two models are not comparable; None where they are."""
    effects = [[(entry.effect, entry.options) for entry in model.effects] for model in (a, b)]
    if effects[0] != effects[1] or a.rows != b.rows:
        return f"the models differ: {a.name} and {b.name}"
    for x, y in zip(a.effects, b.effects, strict=True):
        knots = [np.array(side.state.get("knots", ()), dtype=float) for side in (x, y)]
        if knots[0].shape != knots[1].shape or not np.allclose(knots[0], knots[1], rtol=0.0, atol=1e-9):
            return f"the pieces of '{x.effect}' have different knots; compare the curves"
    return None


def _coefficient(key: str, a: Coefficient, b: Coefficient) -> Entry:
    z = None
    if a.value is not None and b.value is not None and a.std is not None and b.std is not None:
        std = hypot(a.std, b.std)
        z = finite((b.value - a.value) / std) if std > 0.0 else None
    return {"key": key, "unit": a.unit, "a": a.value, "b": b.value, "a_std": a.std, "b_std": b.std, "z": z}


def curves(a: Path, b: Path, floor_dph: float) -> Entry:
    """Difference B less A of both models [deg/h] over temperature, on rows of both runs within both validity ranges."""
    try:
        sources = source_of(a), source_of(b)
        parts = [_on(record, *sources) for record in sources]
    except InputError as error:
        return {"reason": str(error)}
    temperature, difference = (np.concatenate([part[i] for part in parts]) for i in range(2))
    if not difference.size:
        return {"reason": "no row of either run lies within the ranges of both models"}
    offset = float(difference.mean())
    edges = np.linspace(temperature.min(), temperature.max(), BINS + 1)
    bins = np.clip(np.searchsorted(edges, temperature, side="right") - 1, 0, BINS - 1)
    means = [(b, float(difference[bins == b].mean())) for b in np.unique(bins).tolist()]
    worst, largest = max(means, key=lambda pair: abs(pair[1]))
    rms = float(np.sqrt(np.mean(difference**2)))
    return {
        "reason": "",
        "rows": int(difference.size),
        "from_degc": float(edges[0]),
        "to_degc": float(edges[-1]),
        "rms_dph": rms,
        "max_dph": abs(largest),
        "max_at_degc": [float(edges[worst]), float(edges[worst + 1])],
        "offset_dph": offset,
        "shape_rms_dph": float(np.std(difference)),
        "floor_dph": finite(floor_dph),
        "over_floor": finite(rms / floor_dph) if isfinite(floor_dph) and floor_dph > 0 else None,
        "curve": [{"degc": float(0.5 * (edges[b] + edges[b + 1])), "difference_dph": mean} for b, mean in means],
    }


def _on(record: Source, a: Source, b: Source) -> tuple[FloatArray, FloatArray]:
    """Temperature and difference of both models on the rows of one run."""
    one, other = a.fit.predict(record.dataset), b.fit.predict(record.dataset)
    difference = other.bias - one.bias
    temperature = record.dataset.channel("temperature")
    rows: BoolArray = ~one.out_of_range & ~other.out_of_range & np.isfinite(difference) & np.isfinite(temperature)
    return temperature[rows], difference[rows]
