"""Results of commands on many units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import archive, record
from bench.base import counted, in_print, number
from bench.cli.options import Registered
from bench.cli.rendering.printing import content, lines, table
from bench.commands import (
    CertificatesListed,
    EquipmentListed,
    FleetDiagnosed,
    FleetJudged,
    GaugeJudged,
    LotAudited,
    LotCalibrated,
    LotChecked,
    LotCompleted,
    LotPlanned,
    Noted,
    Recalled,
    Refitted,
    RegisteredRuns,
    RegistryEntry,
    RegistryRebuilt,
    Scrubbed,
)

if TYPE_CHECKING:
    from rich.table import Table


_RUN = {"unit": "unit", "created": "created", "profile": "profile", "state": "state", "verdict": "verdict",
        "judged": "limits", "path": "run"}  # fmt: skip
_CERTIFICATE = ("unit", "number", "issued", "verdict", "state", "reason")
_EQUIPMENT = ("name", "serial", "kind", "calibrated_on", "due_on", "state")
_QUANTITY = ("quantity", ">mean", ">lower", ">upper", ">Cpk", ">Ppk", ">outside")


@lines.register(Registered)
def _(result: Registered) -> Iterator[str | Table]:
    yield from lines(result.result)
    yield from [f"warning: {result.warning}"] if result.warning else []


@content.register(Registered)
def _(result: Registered) -> dict[str, Any]:
    failed = {"registered": False, "warning": result.warning}
    return {**content(result.result), "registry": failed if result.warning else {"registered": True}}


@lines.register(RegisteredRuns)
def _(result: RegisteredRuns) -> Iterator[str | Table]:
    rows = [[row[key] for key in _RUN] for row in result.rows]
    yield table(tuple(_RUN.values()), rows) if rows else "no runs"


@content.register(RegisteredRuns)
def _(result: RegisteredRuns) -> dict[str, Any]:
    return {"registry": result.registry, "runs": list(result.rows)}


@lines.register(RegistryEntry)
def _(result: RegistryEntry) -> Iterator[str]:
    for i, (title, found) in enumerate(result.tables.items()):
        yield from [""] if i else []
        yield f"{title}:"
        for row in found if isinstance(found, list) else [found]:
            yield from (f"  {line}" for line in _described(archive.plain(row)))


def _described(row: Mapping[str, Any]) -> Iterator[str]:
    if set(row) == {"run", "name", "unit", "value"}:
        yield f"{row['name']:<32} {row['value']:.6g} {row['unit'] or ''}".rstrip()
    else:
        yield from (f"{key:<22} {value}" for key, value in row.items() if value is not None)


@content.register(RegistryEntry)
def _(result: RegistryEntry) -> dict[str, Any]:
    return dict(result.tables)


@lines.register(RegistryRebuilt)
def _(result: RegistryRebuilt) -> Iterator[str]:
    done = result.rebuilt
    verb = "differs from the run folders" if result.only_compared else "corrected"
    yield from (f"{verb}: {line}" for line in done.differences)
    yield from (f"cannot be read: {line}" for line in done.unreadable)
    counted = ", ".join(f"{count} {name}" for name, count in done.counts.items() if name != "archives")
    yield f"{result.registry}: {counted}"
    differ = result.only_compared and done.differences
    same = f"{len(done.differences)} rows differ" if differ else "equal to the run folders"
    yield f"{same}; digest of all rows {done.digest}"


@content.register(RegistryRebuilt)
def _(result: RegistryRebuilt) -> dict[str, Any]:
    done = result.rebuilt
    return {"registry": result.registry, "archive": done.archive, "rows": done.counts,
            "differences": list(done.differences), "unreadable": list(done.unreadable),
            "digest": done.digest}  # fmt: skip


@lines.register(Scrubbed)
def _(result: Scrubbed) -> Iterator[str]:
    yield from result.faults
    keys = ", ".join(f"{key[:16]}…" for key in result.keys) or "no key"
    outcome = f"{len(result.faults)} faults" if result.faults else "every file is what the bench wrote"
    yield f"{result.archive}: {result.folders} folders, signed by {keys}: {outcome}"


@lines.register(Noted)
def _(result: Noted) -> Iterator[str]:
    entry = result.entry
    if entry["kind"] == "lot":
        yield f"{counted(len(entry['units']), 'unit')} assigned to lot {entry['lot']}"
    elif entry["kind"] == "withdrawal":
        yield f"certificate {entry['number']} is withdrawn: {entry['reason']}"
    elif entry["kind"] == "operator":
        yield f"operator {entry['name']}"
    else:
        yield f"{entry['name']} {entry['serial']} ({entry['type']}), due {entry['due_on'] or 'never'}"


@content.register(Noted)
def _(result: Noted) -> dict[str, Any]:
    return {"ledger": str(result.ledger), **result.entry}


@lines.register(CertificatesListed)
def _(result: CertificatesListed) -> Iterator[str | Table]:
    rows = [[row[key] or "" for key in _CERTIFICATE] for row in result.certificates]
    yield table(_CERTIFICATE, rows) if rows else "no certificates"


@content.register(CertificatesListed)
def _(result: CertificatesListed) -> dict[str, Any]:
    return {"registry": result.registry, "certificates": [dict(row) for row in result.certificates]}


@lines.register(Recalled)
def _(result: Recalled) -> Iterator[str | Table]:
    rows = [[row["run"], row["unit"], row["created"], ", ".join(row["certificates"])] for row in result.recalled]
    yield table(("run", "unit", "created", "certificates"), rows) if rows else f"no run rests on {result.equipment}"
    if result.unknown:
        yield f"{result.unknown} runs do not say what equipment they were made with (`bench run --equipment`)"
    if result.elsewhere:
        yield f"{result.elsewhere} runs are not in this folder: ask where they are"


@content.register(Recalled)
def _(result: Recalled) -> dict[str, Any]:
    return {
        "equipment": result.equipment,
        "since": None if result.since is None else result.since.isoformat(),
        "runs": [dict(row) for row in result.recalled],
        "unknown": result.unknown,
        "elsewhere": result.elsewhere,
    }


@lines.register(EquipmentListed)
def _(result: EquipmentListed) -> Iterator[str | Table]:
    rows = [[row[key] for key in _EQUIPMENT] for row in result.equipment]
    yield table(_EQUIPMENT, rows) if rows else "no equipment"


def _left_out(found: Sequence[str]) -> Iterator[str]:
    if found:
        yield f"runs left out: {', '.join(found)}"


@lines.register(FleetJudged)
def _(result: FleetJudged) -> Iterator[str | Table]:
    from bench.archive import sentence

    statistics, passes = result.statistics, result.statistics.passes
    yield f"{counted(len(statistics.fleet.newest), 'unit')}. {sentence(statistics)}"
    yield from _left_out(statistics.fleet.left_out)
    if passes.judged:
        low, high = (100 * end for end in passes.interval)
        share = 100 * passes.first / passes.judged
        yield f"first-pass yield {share:.1f} % ({low:.1f} to {high:.1f}), {passes.first} of {passes.judged}"
    rows = [
        (one.name, *map(number, (able.mean, one.lower, one.upper, able.cpk, able.ppk)), able.outside)
        for one in statistics.measured
        if (able := one.capability) is not None
    ]
    if rows:
        yield ""
        yield table(_QUANTITY, rows)
    yield from (f"wrote   {path}" for path in (result.html, result.csv) if path is not None)


@content.register(FleetJudged)
def _(result: FleetJudged) -> dict[str, Any]:
    files = {key: None if path is None else str(path) for key, path in (("html", result.html), ("csv", result.csv))}
    return {**result.statistics.to_json(), **files}


_MOST_LOTS = 12
"""Columns of a table in a terminal."""
_WORDS = {"adequate": "nothing missing", "undecided": "undecided", "unknown_effect": "unknown effect"}


@lines.register(FleetDiagnosed)
def _(result: FleetDiagnosed) -> Iterator[str | Table]:
    found = result.diagnosis
    lots, total = archive.by_lot(found.told), len(found.told)
    made = f", {found.made} of them now in {result.seconds:.1f} s ({result.engine})" if found.made else ""
    yield f"{counted(total, 'unit')} of {counted(len(lots), 'lot')} diagnosed with {result.model}{made}"
    yield from _left_out(found.left_out)
    every = sum((lot.lacks for lot in lots.values()), Counter[str]())
    shown = sorted(lots, key=lambda name: (-lots[name].lacks.total(), name))[:_MOST_LOTS]
    rows = [
        (f"lacks {effect}", count, *(lots[name].lacks[effect] for name in shown))
        for effect, count in every.most_common()
    ]
    for word, text in _WORDS.items():
        counts = [lots[name].verdicts[word] for name in lots]
        rows.append((text, sum(counts), *(lots[name].verdicts[word] for name in shown)))
    yield ""
    yield table(
        ("units", ">all", *(f">{name}" for name in shown)), [*rows, ("all", total, *(lots[n].units for n in shown))]
    )
    yield from [f"and {len(lots) - len(shown)} further lots, with --json"] if len(lots) > len(shown) else []
    for one in archive.in_common(found.told):
        yield (
            f"lot {one.lot} has {one.effect} in common: {one.lacking} of {one.units} units, "
            f"elsewhere {one.elsewhere} of {one.of_elsewhere} (p {number(one.p, 2)})"
        )
    yield from (f"not diagnosed: {line}" for line in found.failed[:10])
    yield from [f"and {len(found.failed) - 10} more"] if len(found.failed) > 10 else []


@content.register(FleetDiagnosed)
def _(result: FleetDiagnosed) -> dict[str, Any]:
    found = result.diagnosis
    return {
        "model": result.model, "units": len(found.told), "made": found.made, "failed": found.failed,
        "left_out": list(found.left_out), "engine": result.engine, "seconds": result.seconds,
        "lots": {
            name: {"units": lot.units, "verdicts": dict(lot.verdicts), "lacks": dict(lot.lacks)}
            for name, lot in archive.by_lot(found.told).items()
        },
        "in_common": [asdict(one) for one in archive.in_common(found.told)],
    }  # fmt: skip


_GAUGE = ("", ">sigma", ">95 %", ">REML", ">% of all", ">% of tolerance")


@lines.register(GaugeJudged)
def _(result: GaugeJudged) -> Iterator[str | Table]:
    found, unit = result.gauge, f" [{in_print(result.unit)}]" if result.unit else ""
    many = counted(found.units, "unit"), counted(len(found.stations), "station"), counted(found.runs, "run")
    yield f"{many[0]} at {many[1]}, {many[2]}: {result.quantity}{unit}"
    yield from _left_out(result.left_out)
    rows = []
    for one in found.components:
        between = "" if one.low is None else f"{number(one.low, 3)} to {number(one.high, 3)}"
        share = "" if one.of_tolerance is None else f"{100 * one.of_tolerance:.1f}"
        rows.append((one.name, number(one.sigma), between, number(one.reml_sigma), f"{100 * one.of_study:.1f}", share))
    yield table(_GAUGE, rows)
    if not found.sources:
        yield "not every unit was measured equally often at every station: by REML, without analysis of variance"
    for line in found.sources:
        beside = "" if line.f is None else f", F {number(line.f)}, p {number(line.p, 2)}"
        yield f"  {line.name}: {line.freedom} degrees of freedom, squares {number(line.squares)}{beside}"
    word = "acceptable" if found.acceptable else "not acceptable (more than 30 %)"
    whole = "spread" if found.components[4].of_tolerance is None else "tolerance"
    yield f"the gauge takes {100 * found.share:.1f} % of the {whole}: {word}; {found.categories} categories of units"


@content.register(GaugeJudged)
def _(result: GaugeJudged) -> dict[str, Any]:
    return {
        "quantity": result.quantity,
        "unit": result.unit,
        "left_out": list(result.left_out),
        **asdict(result.gauge),
        "share": result.gauge.share,
        "acceptable": result.gauge.acceptable,
    }


@lines.register(Refitted)
def _(result: Refitted) -> Iterator[str]:
    yield (
        f"{counted(result.units, 'unit')} refitted with {result.model} in {result.seconds:.1f} s "
        f"({result.units_per_s:.0f} per second, {result.engine})"
    )
    yield f"RMS [deg/h]: median {number(result.rms_dph['median'])}, 95 % below {number(result.rms_dph['p95'])}"
    yield f"weighted by {result.weights['by']}: {result.weights['reason']}"
    yield from [f"failed: {counted(result.failed, 'unit')}"] if result.failed else []
    yield from (f"  {line}" for line in result.failures)
    yield from (f"no moments: {line}" for line in result.without_moments)
    yield from _left_out(result.left_out)
    yield f"records {result.records}"


_LOSSES = {
    "own_rms_dph": "its own calibration",
    "lot_rms_dph": "the lot's, fitted without it",
    "levelled_rms_dph": "the lot's and a constant of its own",
}


def _loss(record: record.LotRecord) -> dict[str, dict[str, float]]:
    values = {name: [getattr(unit, name) for unit in record.units] for name in _LOSSES}
    return {
        name: dict(zip(("median", "p95"), np.quantile(own, (0.5, 0.95)), strict=True)) for name, own in values.items()
    }


@lines.register(LotCalibrated)
def _(result: LotCalibrated) -> Iterator[str | Table]:
    record = result.record
    yield f"{record.model} for lot {record.lot}, from {counted(len(record.units), 'unit')}"
    rows = [(_LOSSES[name], number(one["median"]), number(one["p95"])) for name, one in _loss(record).items()]
    yield table(("error of a unit [deg/h RMS]", ">median", ">95 %"), rows)
    yield ""
    yield f"run     {result.run}"


@content.register(LotCalibrated)
def _(result: LotCalibrated) -> dict[str, Any]:
    keep = {"unit", *_LOSSES}
    units = [unit.model_dump(include=keep) for unit in result.record.units]
    return {"run": str(result.run), "lot": result.record.lot, "model": result.record.model,
            "loss": _loss(result.record), "units": units}  # fmt: skip


@lines.register(LotChecked)
def _(result: LotChecked) -> Iterator[str | Table]:
    rows = [
        (unit, "like" if one.like else "UNLIKE", number(one.level, 2), number(one.shape, 2),
         f"{one.sigmas:.1f} sd at {one.worst_degc:.0f} degC")
        for unit, one in result.units.items()
    ]  # fmt: skip
    yield f"lot {result.lot}"
    yield table(("unit", "", ">level, of its limit", ">shape, of its limit", "farthest"), rows)


@content.register(LotChecked)
def _(result: LotChecked) -> dict[str, Any]:
    units = [{"unit": unit, "like": one.like, **asdict(one)} for unit, one in result.units.items()]
    return {"run": str(result.run), "lot": result.lot, "units": units}


@lines.register(LotCompleted)
def _(result: LotCompleted) -> Iterator[str]:
    error, low, high = (number(value) for value in (result.error_dph, result.low_dph, result.high_dph))
    yield f"{error} deg/h RMS expected over the whole run of lot {result.lot} (95 %: {low} to {high})"
    yield f"run     {result.run}"


@lines.register(LotPlanned)
def _(result: LotPlanned) -> Iterator[str]:
    saved = result.whole_hours - result.hours
    yield f"wrote   {result.profile}"
    yield (
        f"{result.hours:.2f} h instead of {result.whole_hours:.2f} h: {saved:.2f} chamber hours saved a unit "
        f"({100 * saved / result.whole_hours:.0f} %)"
    )
    yield (
        f"expected error {number(result.error_dph, 3)} deg/h RMS over the lot's whole run, 95 %: "
        f"{number(result.low_dph, 3)} to {number(result.high_dph, 3)}; target {result.target_dph:g}"
    )


@lines.register(LotAudited)
def _(result: LotAudited) -> Iterator[str]:
    yield ", ".join(f"{count} {word}" for word, count in result.outcomes.items())
    yield f"{100 * result.saved:.1f} % of the time of whole runs was saved"
    if result.held_from is None or result.held_to is None:
        yield "no audit yet: nothing shows whether the stated errors hold"
        return
    share = f"95 %: {100 * result.held_from:.0f} to {100 * result.held_to:.0f} %"
    yield f"{result.held} of {result.audits} audits lie in their stated 95 % interval ({share})"
    yield f"{result.over} audits are above the limit"
