"""The result of `bench imu` as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bench.base import finite
from bench.cli.rendering.printing import content, lines, number, table, unit_text
from bench.commands import ImuCalibrated, ImuCertified, ImuExported, ImuVerified

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
    yield from (f"written to {path}" for path in result.files)


@content.register(ImuCalibrated)
def _(result: ImuCalibrated) -> dict[str, Any]:
    return {
        "table": str(result.table),
        "out": None if result.out is None else str(result.out),
        "files": [str(path) for path in result.files],
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


@lines.register(ImuVerified)
def _(result: ImuVerified) -> Iterator[str | Table]:
    found = result.verification
    low, high = found.range_degc
    yield f"{found.verdict}: {found.rows} rows of {found.stays} stays with other attitudes or rates than fitted"
    yield ""
    rows = [
        (a.name, a.unit, number(a.raw_rms), number(a.rms), f"{number(a.interval[0])} to {number(a.interval[1])}",
         number(a.mean), number(a.scatter), number(a.peak), number(a.floor), f"{a.over_floor:.2f}", number(a.stated))
        for a in found.axes
    ]  # fmt: skip
    yield table(
        ("", "", ">raw RMS", ">RMS left", ">95 %", ">mean", ">scatter", ">peak", ">floor", ">over floor", ">stated"),
        rows,
    )
    yield ""
    yield f"from {low:.1f} to {high:.1f} degC; left out: {found.fitted_rows} rows as fitted, {found.rows_beyond} beyond"
    yield "floor: noise of neighbouring rows, and attitudes that are as exact as the calibration found them"
    yield "stated: the floor, the uncertainty of the parameters, and how the calibration saw a bias wander"
    moved = [axis for axis in found.axes if 2.0 * axis.mean**2 > axis.rms**2 and axis.over_floor > 1.0]
    yield from (f"{a.name}: most of its error is its mean, {number(a.mean)} {a.unit}: its bias moved" for a in moved)
    if found.rule is not None:
        yield f"rule: {found.rule}"
    for one in found.limits.results if found.limits else ():
        yield f"{one.verdict or '-':<9} {one.name} = {number(one.value)}{unit_text(one.unit)}"
    yield from (f"written to {path}" for path in result.files)


@content.register(ImuVerified)
def _(result: ImuVerified) -> dict[str, Any]:
    return {
        "table": str(result.table),
        "calibration": str(result.calibration),
        "files": [str(path) for path in result.files],
        **result.verification.content(),
    }


@lines.register(ImuExported)
def _(result: ImuExported) -> Iterator[str | Table]:
    package = result.delivered.package
    unit = f"inertial unit {package.record.unit or 'without a serial number'}"
    if package.refusal:
        yield f"{unit}: {package.refusal}"
    else:
        image = package.image
        yield (
            f"{unit}: {4 * len(package.words)} bytes, "
            f"serial {image.serial}, calibration {image.label}, CRC 0x{package.words[-1]:08X}"
        )
    yield from (f"not in this format: {text}" for text in result.delivered.made.lost)
    yield from (f"forced: {text}" for text in result.delivered.objections)
    yield from map(str, result.files)


@content.register(ImuExported)
def _(result: ImuExported) -> dict[str, Any]:
    package = result.delivered.package
    return {
        "run": str(result.run),
        "format": result.format,
        "files": [str(path) for path in result.files],
        "unit": package.record.unit,
        "serial": package.serial,
        "calibration_id": package.calibration_id,
        "crc": None if package.refusal else package.words[-1],
        "words": None if package.refusal else len(package.words),
        "lost": list(result.delivered.made.lost),
        "objections": list(result.delivered.objections),
    }


@lines.register(ImuCertified)
def _(result: ImuCertified) -> Iterator[str]:
    facts = result.facts
    yield f"Certificate {facts['number']}{' (simulated: not valid as a certificate)' if facts['simulated'] else ''}"
    names = {one["name"] for one in facts["parameters"]}
    yield f"{len(names)} parameters with U, k = 2; verification: {facts['verdict'] or 'none: it certifies no range'}"
    if facts["draft"] is not None:
        yield f"DRAFT: {'; '.join(facts['draft'])}"
    elif facts["signer"] is None:
        yield "warning: not signed: there is no key of the laboratory; --sign-key and --sign-certificate name one"
    else:
        yield f"signed by {facts['signer']['subject']}"
    yield ""
    yield from (f"{name:<6}{path}" for name, path in (("pdf", result.pdf), ("xml", result.xml), ("json", result.json)))
