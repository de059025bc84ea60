"""Results of commands on recorded runs and models."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import analysis
from bench.base import bound, clock, finite, in_own, say, verdict_word
from bench.cli.rendering.diagnose import next_run
from bench.cli.rendering.difference import difference
from bench.cli.rendering.drawing import plot
from bench.cli.rendering.printing import content, lines, number, table, unit_text
from bench.commands import (
    Compared,
    ComparedSamples,
    Differs,
    FiguresDrawn,
    Imported,
    NoiseFound,
    NotAnalysed,
    Replayed,
    Reported,
    UnitsReported,
)
from bench.record import NotesRecord

if TYPE_CHECKING:
    from rich.table import Table


_MOST_CHANGES = 20


def ladder(models: Iterable[tuple[str, float, float]], floor_dph: float, interval_s: float) -> Table:
    """Models (name, in-sample and held-out RMS [deg/h]) beside the noise floor of means over `interval_s`."""
    rows = []
    for name, inside, outside in models:
        ratio = outside / floor_dph if floor_dph else float("nan")
        rows.append((name, number(inside), number(outside), f"{ratio:.2f} x" if isfinite(ratio) else "-", ""))
    unit = f"[deg/h RMS, {interval_s:g} s means]"
    floor = ("noise floor", number(floor_dph), "", "", "")
    return table(("model", ">in-sample", ">held-out", ">over floor", unit), [*rows, floor])


def _compared(comparison: analysis.Comparison) -> Table:
    models = ((score.model.name, score.rms_dph, score.held_out.rms_dph) for score in comparison.scores)
    return ladder(models, comparison.floor_dph, comparison.interval_s)


@lines.register(Compared)
def _(result: Compared) -> Iterator[str | Table]:
    comparison = result.comparison
    yield _compared(comparison)
    notes = [text for text in (comparison.by_counts, comparison.constants, comparison.spikes) if text]
    least = min((score.held_out.rms_dph for score in comparison.scores), default=float("nan"))
    notes += [f"note: {text}" for text in analysis.bound_notes(comparison.floor_dph, least)]
    notes += [f"not fitted: {name}: {reason}" for name, reason in comparison.refused]
    notes += [f"warning: {text}" for text in comparison.warnings]
    yield from ["", *notes] if notes else []
    if isinstance(result, ComparedSamples):
        reasons = dict.fromkeys(score.fit.weights_reason for score in comparison.scores)
        yield from ["", *(f"weighted by count: {reason}" for reason in reasons)]
        yield ""
        means = ((name, inside, outside) for name, (inside, outside) in result.seconds.items())
        yield ladder(means, result.seconds_floor_dph, 1.0)


@content.register(Compared)
def _(result: Compared) -> dict[str, Any]:
    return result.comparison.to_json()


@content.register(ComparedSamples)
def _(result: ComparedSamples) -> dict[str, Any]:
    means = {
        name: {"rms_dph": finite(inside), "held_out_rms_dph": finite(outside)}
        for name, (inside, outside) in result.seconds.items()
    }
    seconds = {"floor_dph": finite(result.seconds_floor_dph), "models": means}
    return {**result.comparison.to_json(), "samples": result.samples, "seconds": seconds}


@lines.register(Reported)
def _(result: Reported) -> Iterator[str | Table]:
    analysis = result.analysis
    yield in_own(analysis.verdict.sentence)
    if analysis.comparison is not None:
        yield ""
        yield _compared(analysis.comparison)
    answer = analysis.diagnosed.answer
    if answer is not None:
        yield ""
        yield answer.sentence
        yield from next_run(answer, analysis.manifest.imported)
    if analysis.judgement is not None:
        yield ""
        yield from judged(analysis.judgement.to_json())
    yield from (f"warning: {text}" for text in analysis.warnings)
    yield ""
    yield f"run     {analysis.run.path}"
    yield f"report  {analysis.run.report}"
    yield from [f"bench: {result.error}"] if result.error is not None else []


@content.register(Reported)
def _(result: Reported) -> dict[str, Any]:
    analysis = result.analysis
    error = {} if result.error is None else {"error": str(result.error)}
    written = (NotesRecord.find(analysis.run.path) or NotesRecord()).model_dump(mode="json", include={"notes", "views"})
    made = {"report": str(analysis.run.report), "state": analysis.manifest.state, **written}
    return {**analysis.to_json(), **made, **error}


@lines.register(FiguresDrawn)
def _(result: FiguresDrawn) -> Iterator[str]:
    yield from (str(file) for file in result.files)
    yield from (f"warning: {name} is not drawn: {reason}" for name, reason in result.refused)


@content.register(FiguresDrawn)
def _(result: FiguresDrawn) -> dict[str, Any]:
    refused = [{"name": name, "reason": reason} for name, reason in result.refused]
    return {"run": str(result.run), "files": [str(file) for file in result.files], "refused": refused}


def judged(judgement: Mapping[str, Any]) -> Iterator[str]:
    """Verdict against limits: every result that did not pass, and the number of those that did."""
    yield say("judged.head", verdict=verdict_word(judgement["verdict"]), name=judgement["name"])
    yield from (f"  {verdict_word('INVALID'):<9} {text}" for text in judgement["refusals"])
    results = judgement["results"]
    for one in results:
        if one["verdict"] not in {"PASS", None}:
            value = one["reason"] if one["value"] is None else f"{one['value']:.4g}"
            spread = "" if None in (one["low"], one["high"]) else f" ({one['low']:.4g} to {one['high']:.4g})"
            allowed = f"{bound(one['lower'])} to {bound(one['upper'])}{unit_text(one['unit'])}"
            word, named = verdict_word(one["verdict"]), one["name"]
            yield say("judged.result", verdict=word, name=named, value=f"{value}{spread}", allowed=allowed)
    skipped = [one["name"] for one in results if one["verdict"] is None]
    rest = f"; not measured: {', '.join(skipped)}" if skipped else ""
    passed = sum(one["verdict"] == "PASS" for one in results)
    yield say("judged.count", passed=passed, all=len(results), rest=rest)
    yield ""


@content.register(NotAnalysed)
def _(result: NotAnalysed) -> dict[str, Any]:
    sentence = f"not analysed: {result.error}"
    return {"run": str(result.run), "verdict": result.verdict, "sentence": sentence, "rms_dph": None,
            "error": result.error}  # fmt: skip


@lines.register(UnitsReported)
def _(result: UnitsReported) -> Iterator[str]:
    width = max(len(unit.name) for unit in result.units)
    for unit in result.units:
        known = content(unit.result)
        word = f"{known['limits']['verdict']}, " if known.get("limits") else ""
        yield f"{unit.name:<{width}}  {word}{known['verdict']}: {in_own(known['sentence'])}"
        yield f"{'':<{width}}  {known.get('report') or known['run']}"
    yield from (f"bench: {text}" for text in sorted({str(unit.error) for unit in result.units if unit.error}))


@content.register(UnitsReported)
def _(result: UnitsReported) -> dict[str, Any]:
    return {
        "verdict": result.verdict,
        "units": [
            {"unit": unit.serial, **({} if unit.output == "rate" else {"output": unit.output}), **content(unit.result)}
            for unit in result.units
        ],
    }


@lines.register(Imported)
def _(result: Imported) -> Iterator[str]:
    yield result.plan.preview()
    if result.run is not None:
        yield ""
        yield f"run     {result.run}"


@content.register(Imported)
def _(result: Imported) -> dict[str, Any]:
    return {"run": None if result.run is None else str(result.run), **result.plan.to_json()}


_MEANINGS = {
    "angle_random_walk": "N  angle random walk",
    "bias_instability": "B  bias instability",
    "rate_random_walk": "K  rate random walk",
    "quantisation": "Q  quantisation",
    "rate_ramp": "R  rate ramp",
    "correlated_noise": "M  correlated noise",
}


@lines.register(NoiseFound)
def _(result: NoiseFound) -> Iterator[str | Table]:
    floor = result.floor
    longest = max((curve for _, curve in floor.curves), key=lambda curve: float(curve.tau_s[-1]))
    if floor.noise is not None:
        tau_s = np.geomspace(longest.tau_s[0], longest.tau_s[-1], 120)
        fitted = floor.noise.allan_deviation(tau_s)
        both = np.concatenate([longest.tau_s, tau_s]), np.concatenate([longest.deviation_dph, fitted])
        yield "Allan deviation of the longest stretch (dots) and of the noise that was found (line)"
        yield plot(*both, "s", "deg/h", height=12, logarithmic=True)
        yield ""
    rows = []
    for key, found in result.coefficients.items():
        below = key != "rate_ramp" and found.value == 0.0
        value = f"below {found.high:.2g}" if below else f"{found.value:.4g}"
        rows.append((_MEANINGS[key], value, f"{found.low:.4g} to {found.high:.4g}", found.unit))
    yield table(("coefficient (IEEE 952)", ">value", ">95 % interval", "unit"), rows)
    yield ""
    low, high = floor.interval_dph
    hours = f"in a run of {clock(floor.duration_s)}"
    yield f"noise floor of 30 s means {hours}: {number(floor.floor_dph)} deg/h RMS ({number(low)} to {number(high)})"
    spans = ", ".join(f"{name} ({(to_s - from_s) / 60:.0f} min)" for name, from_s, to_s in floor.stretches)
    yield f"read from {spans}"
    yield from (f"note: {note}" for note in floor.notes)
    if floor.estimate is not None and not floor.estimate.white_samples:
        yield "note: N is from means over rows: samples within a row are not there or do not scatter as white noise"
    if floor.noise is not None and floor.noise.correlated:
        yield (
            f"note: M is noise with a correlation time of {floor.noise.correlation_s:.2g} s, such as a filter "
            "leaves; N is that of averages over much longer times"
        )


@content.register(NoiseFound)
def _(result: NoiseFound) -> dict[str, Any]:
    floor = result.floor
    curves = [
        {"name": name, "tau_s": curve.tau_s.tolist(), "deviation_dph": curve.deviation_dph.tolist(),
         "low_dph": curve.low_dph.tolist(), "high_dph": curve.high_dph.tolist()}
        for name, curve in floor.curves
    ]  # fmt: skip
    stretches = [{"name": name, "from_s": a, "to_s": b} for name, a, b in floor.stretches]
    low, high = map(finite, floor.interval_dph)
    coefficients = {
        key: {"value": finite(c.value), "low": finite(c.low), "high": finite(c.high), "unit": c.unit}
        for key, c in result.coefficients.items()
    }
    return {
        "runs": list(result.names), **coefficients, "floor_dph": finite(floor.floor_dph),
        "correlation_s": floor.noise.correlation_s if floor.noise is not None and floor.noise.correlated else None,
        "floor_interval_dph": [low, high],
        "lines": [line._asdict() for line in floor.lines],
        "floor_duration_s": finite(floor.duration_s), "stretches": stretches, "allan": curves,
    }  # fmt: skip


@lines.register(Replayed)
def _(result: Replayed) -> Iterator[str]:
    for one in result.replays:
        source = "from its raw frames" if one.from_frames else "from data.parquet (an import has no frames)"
        what = "tables and results" if one.analysed else "tables (no analysis in the folder)"
        yield f"{one.run.path}: {'identical' if one.identical else 'DIFFERENT'}; {what} recomputed {source}"
        yield from (f"  changed since it was recorded: {change.file}" for change in one.tampered)
        yield from (f"  {change}" for change in one.differences[:_MOST_CHANGES])
        if len(one.differences) > _MOST_CHANGES:
            yield f"  and {len(one.differences) - _MOST_CHANGES} more differences; --json lists all"
        if one.failed:
            yield f"  not recomputed: {one.failed}"
        other = [f"{name} {then} -> {one.now[name]}" for name, then in one.then.items() if one.now[name] != then]
        yield f"  software: {', '.join(other) or 'same versions'}"


@content.register(Replayed)
def _(result: Replayed) -> dict[str, Any]:
    return {"identical": result.identical, "runs": [one.to_json() for one in result.replays]}


@lines.register(Differs)
def _(result: Differs) -> Iterator[str]:
    yield from difference(result.difference)


@content.register(Differs)
def _(result: Differs) -> dict[str, Any]:
    return dict(result.difference)
