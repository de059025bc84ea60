"""Results of commands that deliver a calibration to its unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from bench import analysis, deliver
from bench.base import in_own, say, verdict_word
from bench.cli.rendering.printing import content, lines, number, table, unit_text
from bench.commands import (
    Calibrated,
    CalibratedAll,
    CertificateChecked,
    Certified,
    Exported,
    Flashed,
    MeasuredExported,
    Verified,
)

if TYPE_CHECKING:
    from rich.table import Table

_NEXT = {
    "held": 'a person must decide: the same command with --release "name: reason" continues, --new begins a new job',
    "failed": "the same command repeats this step and continues",
    "ended": "this job has ended; the same command with --new calibrates the unit again",
}


@lines.register(Exported)
def _(result: Exported) -> Iterator[str | Table]:
    delivered, package = result.delivered, result.delivered.package
    image = package.image
    yield f"{delivered.source.fit.model.name}, unit {package.unit}: worst errors against double precision"
    rows = [
        (row.form, f"{row.everywhere:.2g}", f"{row.near_rest:.2g}", f"{row.moving:.2g}", row.words, "")
        for row in package.worst
    ]
    yield table(("form", ">whole box", ">near rest", ">in motion", ">words", "[deg/h]"), rows)
    yield ""
    why = " (least error)" if deliver.best_form(package.worst).form == image.form else ""
    yield (
        f"form {image.form}{why}, {4 * len(package.words)} bytes, serial {image.serial}, calibration {image.label}, "
        f"CRC 0x{package.words[-1]:08X}"
    )
    yield f"delivered and fitted model differ by {delivered.apart_dph:.2g} deg/h on the run's rows"
    yield from (f"forced: {text}" for text in delivered.source.objections)
    yield from map(str, result.files)


@content.register(Exported)
def _(result: Exported) -> dict[str, Any]:
    delivered, package = result.delivered, result.delivered.package
    image = package.image
    return {
        "run": str(result.run),
        "format": result.format,
        "files": [str(path) for path in result.files],
        "model": delivered.source.fit.model.name,
        "form": image.form,
        "unit": package.unit,
        "serial": image.serial,
        "calibration_id": image.calibration_id,
        "crc": package.words[-1],
        "words": len(package.words),
        "worst_error_dph": next(row.worst for row in package.worst if row.form == image.form),
        "model_apart_dph": delivered.apart_dph,
        "forms": [asdict(row) for row in package.worst],
        "objections": list(delivered.source.objections),
    }


@lines.register(MeasuredExported)
def _(result: MeasuredExported) -> Iterator[str]:
    yield from map(str, result.files)


@content.register(MeasuredExported)
def _(result: MeasuredExported) -> dict[str, Any]:
    return {"run": str(result.run), "format": result.format, "files": [str(path) for path in result.files]}


@lines.register(Certified)
def _(result: Certified) -> Iterator[str]:
    facts = result.facts
    left, spread = facts["as_left"], facts["uncertainty"]
    yield f"Certificate {facts['number']}{' (simulated: not valid as a certificate)' if facts['simulated'] else ''}"
    yield f"as found {facts['as_found']['rms_dph']:.4g} deg/h RMS, as left {left['rms_dph']:.4g} deg/h ({left['what']})"
    expanded, k = spread["expanded_dph"], spread["coverage_factor"]
    yield f"U = {expanded:.2g} deg/h (k = {k:.3g}), {spread['scope']}"
    yield f"conformity: {facts['verdict'] or 'no limits given'}"
    if facts["verification"] is not None:
        yield _covered(facts["verification"])
    if facts["draft"] is not None:
        yield f"DRAFT: {'; '.join(facts['draft'])}"
    if facts["signer"] is not None:
        yield f"signed by {facts['signer']['subject']}"
    elif facts["draft"] is None:
        yield "warning: not signed: there is no key of the laboratory; --sign-key and --sign-certificate name one"
    yield ""
    yield f"pdf   {result.pdf}"
    yield f"xml   {result.xml}"
    yield f"json  {result.json}"


def _covered(known: Mapping[str, Any]) -> str:
    (low, high), (first, last) = known["covered_degc"], known["validity_degc"]
    covers = f"{known['covered_percent']:.0f} % of {first:.1f} to {last:.1f} degC ({low:.1f} to {high:.1f} degC)"
    return f"verification: {known['verdict'] or 'without a verdict'}, covers {covers}"


@content.register(Certified)
def _(result: Certified) -> dict[str, Any]:
    keys = ("number", "verdict", "issued", "as_found", "as_left", "simulated", "draft")
    known = {key: result.facts[key] for key in keys if key in result.facts}
    return {"run": str(result.run), "pdf": str(result.pdf), "json": str(result.json), "xml": str(result.xml), **known}


@lines.register(CertificateChecked)
def _(result: CertificateChecked) -> Iterator[str]:
    checked = result.checked
    yield f"{'sound' if checked.sound else 'NOT SOUND'}: certificate {checked.number or 'without a number'}"
    if result.state is not None:
        yield f"it {result.state}"
    for part in checked.parts:
        signer = f", signed by {part.signer}" if part.signer else ""
        yield f"{part.what}: {part.fault or 'as it was issued' + signer}"


@content.register(CertificateChecked)
def _(result: CertificateChecked) -> dict[str, Any]:
    checked = result.checked
    known = {"file": str(checked.file), "number": checked.number, "sound": checked.sound, "state": result.state}
    return {**known, "parts": [asdict(part) for part in checked.parts]}


@lines.register(Flashed)
def _(result: Flashed) -> Iterator[str]:
    record = result.record
    if result.already_there:
        yield f"unit {record['unit']}: calibration {result.calibration_id} is already in force; nothing was written"
        return
    old = record["old"]["calibration_id"] if record.get("old") else "none"
    bank = f" in bank {record['bank']}" if record.get("bank") else ""
    told = f", CRC {record['crc']}, coefficient set {record['coefficient_set']}" if bank else ""
    back = "back in force" if record.get("action") == "previous" else "in force"
    yield (
        f"unit {record['unit']}: calibration {result.calibration_id} ({record['model'] or 'image'}, {record['form']}, "
        f"{record['new']['words']} words) {back}{bank}, before: {old}"
    )
    yield f"read back and compared word by word{told}"
    yield f"record  {record['record']}"


@content.register(Flashed)
def _(result: Flashed) -> dict[str, Any]:
    return dict(result.record)


@lines.register(Verified)
def _(result: Verified) -> Iterator[str | Table]:
    if result.error is not None:
        yield f"bench: {result.error}"
        return
    verification = result.verification
    change = verification.change
    before, after = change.before or analysis.State(None, None), change.after
    interval_s = next(one.interval_s for one in (after.rest, after.turning) if one)
    gain = f", {change.words}" if change.words else ""
    ratio = f"the output of the unit is {verification.over_floor:.2f} times its noise floor"
    yield f"{verification.verdict.value}: {ratio}{gain}"
    yield ""
    low, high = change.within_degc
    rows = [
        (where if name == "rms" else "", name, *(number(getattr(one, f"{name}_dph", None)) for one in pair))
        for where, *pair in (("at rest", before.rest, after.rest), ("turning", before.turning, after.turning))
        for name in ("rms", "mean", "scatter", "peak", "span")
        if any(pair)
    ]
    rows.append(("", "noise floor", "", number(verification.floor.floor_dph)))
    yield table((f"[deg/h, {interval_s:g} s means]", "", ">before", ">after"), rows)
    yield f"both between {low:.1f} and {high:.1f} degC"
    limited = verification.judged.get("limits") or {}
    yield from (f"refused: {text}" for text in verification.judged.get("refusals") or limited.get("refusals") or ())
    yield ""
    yield f"data    {verification.done.counted}"
    if verification.done_before is not None:
        yield f"        calibration run: {verification.done_before.counted}"
    yield f"run     {verification.run.path}"
    for one in limited.get("results", ()):
        yield f"{one['verdict'] or '-':<9} {one['name']} = {number(one['value'])}{unit_text(one['unit'])}"


@content.register(Verified)
def _(result: Verified) -> dict[str, Any]:
    error = {} if result.error is None else {"error": str(result.error)}
    return {**result.verification.to_json(), "run": str(result.verification.run.path), **error}


@lines.register(Calibrated)
def _(result: Calibrated) -> Iterator[str | Table]:
    job = result.job
    known = job.content
    named = {"unit": known["unit"], "plan": known["plan"], "sentence": in_own(known["sentence"])}
    yield say("job.head", verdict=verdict_word(known["verdict"] or "NOT DONE"), **named)
    yield ""
    steps = {name: job.step(name) for name in result.steps}
    rows = [(name, step.get("state", "not reached"), step.get("sentence", "")) for name, step in steps.items()]
    yield table(("", "", ""), rows)
    yield ""
    yield from [_NEXT[job.state]] if job.state in _NEXT else []
    yield f"job     {job.folder}"


@lines.register(CalibratedAll)
def _(result: CalibratedAll) -> Iterator[str | Table]:
    for i, unit in enumerate(result.units):
        yield from ["", ""] if i else []
        yield from lines(unit)


@content.register(CalibratedAll)
def _(result: CalibratedAll) -> dict[str, Any]:
    return {"units": [content(unit) for unit in result.units]}


@content.register(Calibrated)
def _(result: Calibrated) -> dict[str, Any]:
    job = result.job
    run, verification = result.run_of("run"), result.run_of("verify")
    pdf = job.facts("certificate").get("pdf")
    return {
        **{key: job.content[key] for key in ("unit", "plan", "state", "verdict", "sentence", "releases")},
        "job": str(job.folder),
        "run": None if run is None else str(run),
        "verification": None if verification is None else {**job.facts("verify"), "run": str(verification)},
        "certificate": None if pdf is None else str(job.folder / pdf),
        "steps": [{"name": name, **job.step(name)} for name in result.steps if job.step(name)],
        **({"error": job.content["sentence"]} if job.state == "failed" else {}),
    }
