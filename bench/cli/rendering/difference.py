"""`bench diff` as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bench.cli.rendering.printing import unit_text

_MOST = 12


def difference(found: Mapping[str, Any]) -> Iterator[str]:
    """Differences between two runs: measured values first, then conditions and settings."""
    for side in ("a", "b"):
        run = found[side]
        yield f"{side.upper()}  {run['unit']}, {run['profile']}, {run['created']}: {run['run']}"
    yield ""
    yield from _curves(found["curves"])
    yield from _some("Quantities", [_quantity(entry) for entry in found["quantities"]])
    yield from _coefficients(found["coefficients"])
    yield from _some("Segments", [_segment(entry) for entry in found["segments"]])
    yield from _some("Losses", [f"{e['counter']}: {e['a']} | {e['b']}" for e in found["losses"]])
    for key in ("facts", "profile", "station", "versions"):
        yield from _some(key.capitalize(), [f"{e['where']}: {_text(e['a'])} | {_text(e['b'])}" for e in found[key]])
    same = [key for key in ("profile", "station", "versions", "segments", "losses", "quantities") if not found[key]]
    if same:
        yield f"The same: {', '.join(same)}"


def _curves(found: Mapping[str, Any]) -> Iterator[str]:
    if found["reason"]:
        yield f"Models not compared: {found['reason']}"
        return
    low, high = found["max_at_degc"]
    floor = "unknown" if found["floor_dph"] is None else f"{found['floor_dph']:.4f}"
    yield (
        f"Models over {found['from_degc']:.0f} to {found['to_degc']:.0f} degC, B minus A [deg/h]: RMS "
        f"{found['rms_dph']:.4f}, largest {found['max_dph']:.4f} at {low:.0f} to {high:.0f} degC; noise floor {floor}"
    )
    yield f"  constant part {found['offset_dph']:+.4f}; the shapes differ by {found['shape_rms_dph']:.4f} RMS"


def _coefficients(found: Mapping[str, Any]) -> Iterator[str]:
    if not found["comparable"]:
        yield f"Coefficients not compared: {found['reason']}"
        return
    rows = []
    for entry in found["differ"]:
        z = "unknown" if entry["z"] is None else f"{entry['z']:+.1f}"
        rows.append(f"{entry['key']}: {entry['a']:.6g} | {entry['b']:.6g} {entry['unit'] or ''}, z = {z}")
    from bench.archive import BEYOND_CHANCE

    yield from _some("Coefficients", rows)
    yield f"  {found['agree']} coefficients agree within {BEYOND_CHANCE:g} standard deviations"


def _quantity(entry: Mapping[str, Any]) -> str:
    sides = [
        "-" if side is None or side["value"] is None
        else f"{side['value']:.4g}" + ("" if None in (side["low"], side["high"]) or side["low"] == side["high"]
                                       else f" ({side['low']:.4g} to {side['high']:.4g})")
        for side in (entry["a"], entry["b"])
    ]  # fmt: skip
    unit = unit_text(entry["unit"])
    return f"{entry['quantity']}: {sides[0]} | {sides[1]}{unit}"


def _segment(entry: Mapping[str, Any]) -> str:
    sides = [
        "not executed" if side is None else f"{side['outcome']} in {side['duration_s'] / 60:.1f} min"
        for side in (entry["a"], entry["b"])
    ]
    return f"{entry['segment']}: {sides[0]} | {sides[1]}"


def _some(title: str, rows: list[str]) -> Iterator[str]:
    if rows:
        yield f"{title} (A | B)"
        yield from (f"  {row}" for row in rows[:_MOST])
        if len(rows) > _MOST:
            yield f"  and {len(rows) - _MOST} more; --json lists all"


def _text(value: Any) -> str:
    text = "-" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
