"""The result of `bench imu` as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bench.base import finite
from bench.cli.rendering.printing import content, lines, table
from bench.commands import ImuCalibrated

if TYPE_CHECKING:
    from rich.table import Table


@lines.register(ImuCalibrated)
def _(result: ImuCalibrated) -> Iterator[str | Table]:
    all_of_them = sorted({estimate.temperature for estimate in result.parameters})
    shown = sorted({all_of_them[0], all_of_them[len(all_of_them) // 2], all_of_them[-1]})
    by_name: dict[str, dict[float, Any]] = {}
    for estimate in result.parameters:
        by_name.setdefault(estimate.name, {})[estimate.temperature] = estimate
    rows = [
        (name, own[shown[0]].unit, *(f"{own[t].value:.5g} ± {own[t].U:.2g}" for t in shown))
        for name, own in by_name.items()
    ]
    yield table(("parameter", "unit", *(f">{t:g} degC" for t in shown)), rows)
    yield ""
    low, high = result.range_degc
    yield f"{result.rows} rows from {low:.1f} to {high:.1f} degC, {result.left_out} left out; ± is U, k = 2"
    yield from (f"not determined: {text}" for text in result.undetermined)
    for finding in result.findings:
        likes = f" (looks like {', '.join(finding.look_alikes)})" if finding.look_alikes else ""
        yield f"{finding.cause}, {finding.where}: {finding.text}{likes}"
    if not result.findings:
        yield "nothing is wrong with outputs, fixture and place, and no axis lacks an effect"
    if result.out is not None:
        yield f"written to {result.out}"


@content.register(ImuCalibrated)
def _(result: ImuCalibrated) -> dict[str, Any]:
    return {
        "table": str(result.table),
        "out": None if result.out is None else str(result.out),
        "rows": result.rows,
        "left_out": result.left_out,
        "range_degc": [finite(value) for value in result.range_degc],
        "parameters": [
            {"name": e.name, "kind": e.kind, "unit": e.unit, "temperature_degc": e.temperature,
             "value": finite(e.value), "U": finite(e.U)}
            for e in result.parameters
        ],
        "undetermined": list(result.undetermined),
        "findings": [
            {"cause": f.cause, "where": f.where, "text": f.text, "look_alikes": list(f.look_alikes)}
            for f in result.findings
        ],
    }  # fmt: skip
