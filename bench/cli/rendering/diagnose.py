"""Results of commands that look for what a model lacks: diagnoses, effects, units with a hidden effect."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import TYPE_CHECKING, Any

from bench import analysis
from bench.base import ends
from bench.cli.rendering.drawing import plot
from bench.cli.rendering.printing import content, lines, number, table
from bench.commands import (
    Decided,
    Diagnosed,
    EffectAdded,
    Effects,
    EffectShown,
    Improved,
    MysteryMade,
    Revealed,
)

if TYPE_CHECKING:
    from rich.table import Table

_SURE = 1e-9
"""Below this a probability rests on tails that no noise is known to have."""


@lines.register(Diagnosed)
def _(result: Diagnosed) -> Iterator[str | Table]:
    diagnosis = result.diagnosis
    yield diagnosis.sentence
    yield ""
    inside, outside, floor = map(number, (diagnosis.rms_dph, diagnosis.held_out_rms_dph, diagnosis.floor_dph))
    errors = f"in-sample {inside}, held-out {outside} ({diagnosis.held_out_by}), rows weighted by their samples"
    yield f"{errors}; noise floor {floor} deg/h RMS"
    yield ""
    yield from where_it_fails(diagnosis)
    yield from _suspects(diagnosis)
    yield from _formulas(diagnosis)
    yield from (shown.words for shown in (diagnosis.kernel, diagnosis.surface) if shown is not None)
    yield from _smallest(diagnosis)
    yield from (f"Not testable here: {', '.join(names)}: {why}" for why, names in _by_reason(diagnosis).items())
    yield from (
        f"note: {note}" for note in (diagnosis.noise_finding, analysis.made_from(diagnosis), *diagnosis.notes) if note
    )
    if result.following:
        yield ""
        yield "Add it and see the error fall"
        yield from (f"  {command}" for command in result.following)
    if diagnosis.next_experiment:
        yield ""
        yield from next_run(diagnosis, result.imported)


@content.register(Diagnosed)
def _(result: Diagnosed) -> dict[str, Any]:
    return result.diagnosis.to_json()


@lines.register(Decided)
def _(result: Decided) -> Iterator[str | Table]:
    for turn, one in enumerate(result.rounds, start=1):
        yield f"run {turn}: {one.profile}" + (f" -> {one.run}" if one.run else ", not made")
        yield f"  {one.why}"
    if result.rounds:
        yield ""
    yield from lines(Diagnosed(result.diagnosis))
    yield ""
    yield result.reason


@content.register(Decided)
def _(result: Decided) -> dict[str, Any]:
    rounds = [
        {"profile": str(one.profile), "use": one.use, "why": one.why, "run": None if one.run is None else str(one.run)}
        for one in result.rounds
    ]
    return {"decided": result.decided, "reason": result.reason, "rounds": rounds,
            "diagnosis": result.diagnosis.to_json()}  # fmt: skip


def next_run(diagnosis: analysis.Diagnosis, imported: bool) -> Iterator[str]:
    """The run that a diagnosis proposes, if any; of a log that was imported another bench made the run."""
    proposed = diagnosis.next_experiment
    if proposed:
        if proposed["decides"]:
            elsewhere = f"run {proposed['profile']} in the chamber that this log is from, and import what it records"
            yield f"next: {elsewhere if imported else 'bench run ' + proposed['profile']}"
            if len(proposed["separates"]) > 1:
                yield f"tells apart: {'; '.join(proposed['separates'])}"
        yield str(proposed["why"])


def where_it_fails(diagnosis: analysis.Diagnosis) -> Iterator[str | Table]:
    """The places: what is systematic there, the RMS beside the floor, and how often chance would show it."""
    if diagnosis.where:
        yield "Where it fails"
        rows = []
        for p in diagnosis.where:
            ratio = f"{p.floor_ratio:.2f} x floor" if isfinite(p.floor_ratio) else f"{p.rms_dph:.4g} deg/h RMS"
            odds = f"p = {p.p:.1e}" if p.p >= _SURE else f"p < {_SURE:g}"
            size = f"{number(p.misfit_dph)} deg/h systematic"
            rows.append((p.channel, f"{' to '.join(ends(p.low, p.high))} {p.unit}", size, f"{ratio}, {odds}", p.note))
        yield table(("", "", "", "", ""), rows, indent=2)
        yield ""


def _suspects(diagnosis: analysis.Diagnosis) -> Iterator[str | Table]:
    if diagnosis.suspects:
        rows = []
        for suspect in diagnosis.suspects:
            removes = f"{100 * suspect.removes:.0f} %" if isfinite(suspect.removes) else "-"
            held_out, alike = number(suspect.held_out_rms_dph), ", ".join(suspect.look_alikes)
            mark = "*" if suspect.found else " "
            rows.append((f"{mark} {suspect.effect}", f"{suspect.evidence:.1f}", held_out, removes, alike))
        yield table(("Suspects", ">evidence", ">held-out", ">removes", "look-alikes"), rows)
        yield "; ".join(
            [f"  evidence above {diagnosis.threshold:.1f} is significant", *([diagnosis.mark] * any(diagnosis.found))]
        )
        yield from [f"  {reason}"] if (reason := analysis.ranking_reason(diagnosis)) else []
        yield ""


def _formulas(diagnosis: analysis.Diagnosis) -> Iterator[str | Table]:
    if diagnosis.formulas:
        rows = [(f"  {f.formula}", f"{f.evidence:.1f}", number(f.held_out_rms_dph)) for f in diagnosis.formulas]
        yield table(("Formulas", ">evidence", ">held-out"), rows)
        yield ""


def _smallest(diagnosis: analysis.Diagnosis) -> Iterator[str]:
    from bench.analysis import UNSEEN

    seen = [f"{item.effect} {item.rms_dph:.3f}" for item in diagnosis.smallest_detectable if item.seen]
    blind = [item.effect for item in diagnosis.smallest_detectable if not item.seen]
    if seen:
        yield f"This run would have shown [deg/h RMS]: {', '.join(seen)}"
    if blind:
        yield f"{', '.join(blind)}: {UNSEEN}"


def _by_reason(diagnosis: analysis.Diagnosis) -> dict[str, list[str]]:
    """Effects that the runs cannot show, by reason; with the name of the run only if there are several."""
    reasons: dict[str, list[str]] = {}
    runs = diagnosis.runs
    for name, why in diagnosis.not_excited.items():
        short = why if len(runs) > 1 else why.removeprefix(f"{runs[0]} has ").removeprefix(runs[0])
        reasons.setdefault(short.removeprefix(": "), []).append(name)
    return reasons


@lines.register(Improved)
def _(result: Improved) -> Iterator[str | Table]:
    yield table(("", "", ""), [(step.action, step.effect, step.sentence) for step in result.improvement.steps])
    yield ""
    yield f"model: {result.improvement.model.name}"
    yield from [f"wrote {result.out}"] if result.out is not None else []


@content.register(Improved)
def _(result: Improved) -> dict[str, Any]:
    return result.improvement.to_json()


@lines.register(EffectAdded)
def _(result: EffectAdded) -> Iterator[str]:
    yield f"wrote {result.model}: {' + '.join(result.effects)}"


@lines.register(Effects)
def _(result: Effects) -> Iterator[str | Table]:
    yield table(("", ""), [(entry.name, entry.summary) for entry in result.effects])
    yield ""
    yield "bench effects show NAME explains one"


@content.register(Effects)
def _(result: Effects) -> dict[str, Any]:
    return {
        "effects": [
            {"effect": e.name, "family": e.family, "summary": e.summary, "needs": list(e.needs), "options": e.options}
            for e in result.effects
        ]
    }


@lines.register(EffectShown)
def _(result: EffectShown) -> Iterator[str]:

    drawn = result.signature
    yield result.doc
    yield ""
    yield "On an example run, peak scaled to 1 deg/h:"
    yield plot(drawn.time_s / 3600.0, drawn.contribution, "h", "deg/h")
    yield plot(drawn.temperature, drawn.contribution, "degC", "deg/h")


@content.register(EffectShown)
def _(result: EffectShown) -> dict[str, Any]:
    entry, drawn = result.entry, result.signature
    shape = {key: getattr(drawn, key).tolist() for key in ("time_s", "temperature", "contribution")}
    known = {"effect": entry.name, "family": entry.family, **entry.sections, "look_alikes": list(entry.look_alikes)}
    return known | shape


@lines.register(MysteryMade)
def _(result: MysteryMade) -> Iterator[str]:
    run, check = result.run, result.check
    yield f"""Unit MYSTERY-{result.seed} has hidden effects. Find them:

  bench diagnose {run} --check {check} --static {result.static} --model spline
  bench add EFFECT --model spline --out mine.yaml
  bench compare {run} --check {check} --model spline --model mine.yaml
  bench reveal {result.folder} --model mine.yaml"""


@content.register(MysteryMade)
def _(result: MysteryMade) -> dict[str, Any]:
    return {"seed": result.seed, "run": str(result.run), "check": str(result.check), "static": str(result.static)}


@lines.register(Revealed)
def _(result: Revealed) -> Iterator[str]:
    score = result.score
    for item in score.hidden:
        known = item["effect"] or "not included"
        yield f"hidden   {item['mechanism']} (strength {item['strength']} x noise; library: {known})"
    for word in ("right", "wrong", "missed"):
        yield f"{word:<8} {', '.join(getattr(score, word)) or '-'}"
    yield (
        f"held-out {score.held_out_rms_dph:.4f} deg/h RMS; the true model {score.true_model_rms_dph:.4f}, "
        f"perfect knowledge {score.floor_dph:.4f}"
    )


@content.register(Revealed)
def _(result: Revealed) -> dict[str, Any]:
    return result.score.to_json()
