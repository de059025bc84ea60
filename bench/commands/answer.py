"""The answer of a command, and the tables that several of them print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Answer:
    """What a command has to say, and its exit code."""

    content: dict[str, Any]
    text: str
    exit_code: int = 0


def ladder(comparison: dict[str, Any]) -> str:
    """Models against the floor, as a table for a terminal."""
    floor, interval = comparison["floor_dph"], comparison["interval_s"]
    rows = [f"{'model':<28} {'in-sample':>10} {'held-out':>10} {'over floor':>10}   [deg/h RMS, {interval:g} s means]"]
    for model in comparison["models"]:
        inside, outside = model["rms_dph"], model["held_out_rms_dph"]
        ratio = "-" if outside is None or not floor else f"{outside / floor:.2f} x"
        rows.append(f"{model['name']:<28} {number(inside):>10} {number(outside):>10} {ratio:>10}")
    rows.append(f"{'noise floor':<28} {number(floor):>10}")
    return "\n".join(rows)


def limits_table(judged: dict[str, Any]) -> list[str]:
    """Verdict against limits as lines for a terminal: what did not pass, and how many did."""
    lines = [f"{judged['verdict']} against limits '{judged['name']}'"]
    lines += [f"  INVALID   {text}" for text in judged["refusals"]]
    told = [result for result in judged["results"] if result["verdict"] not in {"PASS", None}]
    for result in told:
        bounds = f"{_bound(result['lower'])} to {_bound(result['upper'])} {result['unit']}"
        value = result["reason"] if result["value"] is None else f"{result['value']:.4g}"
        spread = "" if None in (result["low"], result["high"]) else f" ({result['low']:.4g} to {result['high']:.4g})"
        lines.append(f"  {result['verdict']:<9} {result['name']} {value}{spread}, limits {bounds}")
    passed = sum(result["verdict"] == "PASS" for result in judged["results"])
    skipped = [result["name"] for result in judged["results"] if result["verdict"] is None]
    rest = f"; not measured: {', '.join(skipped)}" if skipped else ""
    return [*lines, f"  {passed} of {len(judged['results'])} pass{rest}"]


def _bound(value: float | None) -> str:
    return "…" if value is None else f"{value:g}"


def number(value: float | None) -> str:
    """Four decimals, or a dash where there is no number."""
    return "-" if value is None else f"{value:.4f}"
