"""The HTML report of a whole inertial unit's calibration, made of its record alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from bench.base import in_print, listed, moment, number, with_uncertainty
from bench.deliver.report import imu_figures
from bench.deliver.report.html import SIMULATED, Headline, html_page
from bench.deliver.report.markup import Row, Section, facts, figure, heading, lead, mono, paragraph, table
from bench.record import ImuRecord, ImuTriad, ImuValue, ImuVerificationRecord, put, shapes

REPORT = "report.html"


@dataclass(frozen=True)
class _Word:
    tone: str
    headline: str
    sentence: str


def write_imu_report(folder: Path) -> Path:
    """Write report.html beside the record, atomically; its path."""
    text = render_imu(ImuRecord.read(folder), ImuVerificationRecord.find(folder))
    put(folder, {REPORT: text.encode()}, [ImuRecord.FILE, ImuVerificationRecord.FILE])
    return folder / REPORT


def render_imu(record: ImuRecord, verified: ImuVerificationRecord | None = None) -> str:
    """The report as HTML text."""
    sections = [_wrong(record), *([_verification(verified)] if verified else []),
                *(_parameters(record, triad) for triad in record.triads),
                _values(record), _residuals(record), _noise(record), _facts(record)]  # fmt: skip
    low, high = record.range_degc
    return html_page(
        sections,
        title=f"Calibration of inertial unit {record.unit or 'without a serial number'}",
        subtitle=f"{moment(record.created)}, {low:.1f} to {high:.1f} °C",
        banner=SIMULATED if record.simulated else "",
        verdict=_verdict(record, verified),
        numbers=[_worst(record.parameters, "gyro", "bias"), _worst(record.parameters, "accelerometer", "bias"),
                 _worst(record.parameters, "gyro", "scale factor")],
        warnings=(),
        source=ImuRecord.FILE,
    )  # fmt: skip


def _verdict(record: ImuRecord, verified: ImuVerificationRecord | None) -> _Word:
    parts = []
    if verified is not None and not verified.verdict.within:
        parts.append(f"the verification is {verified.verdict}")
    if record.findings:
        causes = list(dict.fromkeys(f"{f.cause.replace('_', ' ')} ({f.where})" for f in record.findings))
        parts.append(f"found: {listed(causes)}")
    if record.undetermined:
        parts.append(f"not determined: {len(record.undetermined)} of the parameters")
    if parts:
        return _Word("bad", "Do not use as it stands", f"{'; '.join(parts)}.")
    text = "Nothing is wrong with outputs, fixture and place; no axis lacks an effect."
    if verified is None:
        return _Word("warn", "In order, not verified", f"{text} No other positions and rates were measured.")
    return _Word("good", "In order", f"{text} Other positions and rates: {verified.verdict}.")


def _worst(values: tuple[ImuValue, ...], triad: str, kind: str) -> Headline:
    own = [value for value in values if value.name.startswith(triad) and value.kind == kind]
    worst, largest = max(own, key=lambda v: v.U), max(own, key=lambda v: abs(v.value))
    size = f"{number(abs(largest.value))} {in_print(largest.unit)}"
    more = f"{worst.name} at {worst.temperature_degc:g} °C; largest value {size}"
    return Headline(f"U of the {triad}s' {kind}, worst", number(worst.U), in_print(worst.unit), more)


def _wrong(record: ImuRecord) -> Section:
    if not record.findings and not record.undetermined:
        html = paragraph("Nothing was found, and every parameter is determined.")
    else:
        rows = [
            Row((f.cause.replace("_", " "), f.where, f.text, ", ".join(f.look_alikes) or "–"), "bad")
            for f in record.findings
        ]
        html = table("Findings", ("cause", "where", "what the rows show", "looks like"), rows) if rows else Markup()
        lost = [text.split(": ", 2) for text in record.undetermined]
        if lost:
            html += table("Not determined", ("parameter", "why"), [(": ".join(one[:-1]), one[-1]) for one in lost])
    return Section("wrong", "What is wrong", html)


def _verification(found: ImuVerificationRecord) -> Section:
    low, high = found.range_degc
    html = lead(f"{found.verdict}: {found.rows} rows of {found.stays} stays with other attitudes or rates than fitted.")
    rows = [
        (a.name, in_print(a.unit), number(a.raw_rms), number(a.rms), " to ".join(map(number, a.interval)),
         number(a.mean), number(a.scatter), number(a.peak), number(a.floor), f"{a.over_floor:.2f}", number(a.stated))
        for a in found.axes
    ]  # fmt: skip
    head = ("output", "unit", "raw, RMS", "corrected, RMS", "95 %", "mean", "scatter", "peak", "floor", "over floor",
            "stated")  # fmt: skip
    html += table(f"Errors from {low:.1f} to {high:.1f} °C", head, rows, range(2, 11))
    html += paragraph(
        f"Left out: {found.fitted_rows} rows that were fitted, {found.rows_beyond} beyond the calibrated temperatures. "
        "Nothing was fitted to these rows. The floor is the noise of neighbouring rows of a stay, and attitudes that "
        "are as exact as the calibration found them. Stated is what the calibration says of such rows: the floor, the "
        "uncertainty of its parameters, and how it saw a bias wander."
    )
    if found.rule is not None:
        html += paragraph(f"Rule: {found.rule}.")
    if found.limits is not None:
        limited = [
            Row((q.meaning, number(q.value), number(q.lower), number(q.upper), in_print(q.unit or ""), q.verdict or "–",
                 q.why), "bad" if q.verdict == "FAIL" else "")
            for q in found.limits.results
        ]  # fmt: skip
        titles = ("quantity", "value", "lower", "upper", "unit", "verdict", "why this limit")
        html += table(f"Limits “{found.limits.name}”", titles, limited, (1, 2, 3))
    return Section("verification", "Verification", html)


def _parameters(record: ImuRecord, triad: ImuTriad) -> Section:
    html = paragraph(
        f"The bands are U (k = 2, 95 %); below each curve is U alone. Columns are the outputs of the {triad.kind}s, "
        "colours the axis of the input that a parameter multiplies."
    )
    for kind, unit, plot in imu_figures.over_temperature(record, triad):
        name = f"{triad.kind}-{kind.replace(' ', '-')}"
        html += heading(f"{kind.capitalize()} [{in_print(unit)}]")
        html += figure(name, plot, f"{kind.capitalize()} of the {triad.kind}s over the temperature of each axis.",
                       f"{kind} of {triad.kind} x, y and z over temperature with its uncertainty")  # fmt: skip
    return Section(triad.kind, f"{triad.kind.capitalize()}s over temperature", html)


def _values(record: ImuRecord) -> Section:
    temperatures = sorted({value.temperature_degc for value in record.parameters})
    by_name: dict[str, dict[float, ImuValue]] = {}
    for value in record.parameters:
        by_name.setdefault(value.name, {})[value.temperature_degc] = value
    head = ("parameter", "unit", *(f"{t:g} °C" for t in temperatures))
    numeric = range(2, len(head))
    html = paragraph("Value ± U, k = 2.")
    for triad in record.triads:
        rows = [
            (name.removeprefix(f"{triad.kind} "), in_print(own[temperatures[0]].unit),
             *(" ± ".join(with_uncertainty(own[t].value, own[t].U)) for t in temperatures))
            for name, own in by_name.items() if name.startswith(triad.kind)
        ]  # fmt: skip
        html += table(f"{triad.kind.capitalize()}s", head, rows, numeric)
    return Section("values", "All parameters", html)


def _residuals(record: ImuRecord) -> Section:
    rows = [
        (f"{triad.kind} {axis.axis}", in_print(triad.unit), number(float(np.sqrt(np.mean(np.square(axis.residual))))),
         number(float(np.max(np.abs(axis.residual)))))
        for triad in record.triads for axis in triad.axes
    ]  # fmt: skip
    html = table("What the fit left in its own rows", ("output", "unit", "RMS", "peak"), rows, (2, 3))
    for triad in record.triads:
        html += figure(f"residual-{triad.kind}", imu_figures.residuals(record, triad),
                       f"Rows of the {triad.kind}s, over time and over the temperature of each axis.",
                       f"residuals of the {triad.kind}s over time and temperature")  # fmt: skip
    return Section("residual", "Residuals", html)


def _noise(record: ImuRecord) -> Section:
    rows = []
    for triad in record.triads:
        for axis in triad.axes:
            own = axis.variances
            exact = np.degrees(np.sqrt(own.get("visit", 0.0) + own.get("attitude", 0.0))) * 3600.0
            rows.append((f"{triad.kind} {axis.axis}", in_print(triad.unit), number(axis.noise_density),
                         *(number(float(np.sqrt(own.get(name, 0.0)))) for name in ("white", "flicker", "walk")),
                         number(float(exact))))  # fmt: skip
    head = ("output", "unit", "density of samples [/√Hz]", f"white, of {record.interval_s:g} s rows", "flicker B",
            "walk K [/√h]", "attitudes [arcsec]")  # fmt: skip
    html = paragraph("Found in the samples at rest, and in the rows beside the parameters; U contains all of it.")
    return Section("noise", "Noise and attitudes", html + table("Standard deviations", head, rows, range(2, 7)))


def _facts(record: ImuRecord) -> Section:
    orders = shapes(record.plan.get("orders", {}))
    rates = sorted({position.rate_dps for position in record.positions})
    pairs = [
        ("latitude", f"{record.latitude_deg:g}°"),
        ("gravity", f"{record.gravity:.6f} m/s², standard uncertainty {record.gravity_ppm:g} ppm"),
        ("rates of the table", ", ".join(f"{rate:g}" for rate in rates) + " deg/s"),
        ("their scale", f"standard uncertainty {record.rate_ppm:g} ppm"),
        ("attitudes", len({position.up for position in record.positions})),
        ("rows", f"{len(record.time_s)} of {record.interval_s:g} s, {record.left_out} left out"),
        ("orders of the curves", orders),
        ("thermometers", ", ".join(f"{a.output}: {a.thermometer}" for t in record.triads for a in t.axes)),
        *((source.file, mono(source.sha256)) for source in record.sources),
        *((name, version) for name, version in record.software.items()),
    ]  # fmt: skip
    return Section("facts", "What it was made from", facts(pairs, "Place, plan and files"))
