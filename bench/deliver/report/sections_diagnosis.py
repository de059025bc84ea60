"""Section about the diagnosis: missing effects, their evidence, next steps, and what the run could not show."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from bench.analysis import (
    TIE,
    UNSEEN,
    Analysis,
    Detectable,
    Diagnosis,
    Place,
    Rung,
    SuspectedEffect,
    Value,
    effect_names,
    load_model,
    made_from,
    ranking_reason,
    rivals,
)
from bench.base import CHANNELS, capital, ends, finite, in_print, listed, number
from bench.deliver.report import figures_diagnosis
from bench.deliver.report.described import summary_of
from bench.deliver.report.markup import Row, Section, commands, figure, glossary, heading, lead, paragraph, table, wide
from bench.deliver.report.sections_left import left
from bench.record import Dataset

TITLE = "Missing effects"
_ENOUGH = 3
"""Suspects whose evidence is drawn side by side."""
_SURE = 1e-9
_OWN_UNITS = {"dT_dt": ("dT/dt", "°C/min"), "time": ("time", "s")}


def missing(analysis: Analysis) -> Section | None:
    """The diagnosis; None without a model to diagnose."""
    found, data = analysis.diagnosed, analysis.dataset
    if data is None or (found.answer is None and not found.reason):
        return None
    if found.answer is None:
        return Section("missing", TITLE, lead("No diagnosis") + paragraph(f"{_capital(found.reason)}."))
    answer = found.answer
    parts = (
        _sentence(answer),
        _advice(analysis, answer),
        _suspects(answer),
        _formulas(data, answer),
        left(answer),
        _ladder(answer, found.rungs),
        _map(data, answer),
        *(_partial(data, answer, suspect) for suspect in answer.found),
        _misfit(data, answer),
        _legs(answer),
        _places(answer),
        _unseen(answer),
        *(paragraph(f"{_capital(note)}.") for note in _notes(answer)),
    )
    return Section("missing", TITLE, Markup().join(parts))


def _sentence(answer: Diagnosis) -> Markup:
    first, _, rest = in_print(answer.sentence).replace("+-", "±").partition(". ")
    return lead(f"{first.removesuffix('.')}.") + (paragraph(rest) if rest else Markup())


def _advice(analysis: Analysis, answer: Diagnosis) -> Markup:
    """The next steps, as commands to copy."""
    parts = Markup()
    if answer.next_experiment:
        why, profile = answer.next_experiment["why"], answer.next_experiment["profile"]
        apart = answer.next_experiment["separates"]
        decides = f"This run would tell apart {listed(apart)}" if len(apart) > 1 else "This run would decide"
        if not answer.next_experiment.get("decides", True):
            parts += paragraph(f"Undecidable: {why}.")
        elif analysis.manifest.imported:
            parts += paragraph(f"{decides}: {why}. Its profile: {profile}.")
        else:
            parts += paragraph(f"{decides}: {why}.") + commands([f"bench run {profile}"])
    model = _source(analysis, answer.model.name)
    lines = answer.following([str(analysis.run.path)], ["ANOTHER_RUN"], model, "better.yaml")
    if lines:
        words = "Add it and check the error on a run that was not used for the fit:"
        parts += paragraph(words) + commands(lines)
    return parts


def _source(analysis: Analysis, name: str) -> str:
    """Argument of `--model`: the name of a shipped model, or the model file in the run folder."""
    files = [] if name in effect_names() else sorted(analysis.run.path.glob("model*.yaml"))
    return next((str(path) for path in files if load_model(path).name == name), name)


def _suspects(answer: Diagnosis) -> Markup:
    if not answer.suspects:
        return Markup()
    head = ("effect", "evidence", "by chance", "held-out before → after [deg/h]",
            "removes", "parameters", "look-alikes")  # fmt: skip
    rows = [_suspect(suspect) for suspect in answer.suspects]
    least = f"evidence above {number(answer.threshold, 2)} is significant"
    caption = f"The strongest suspects, none of them confirmed: {least}."
    if answer.found:
        caption = f"Suspects, bold if part of the explanation: {least}; a lead of {TIE:g} over another suspect counts."
        caption += f" {_capital(reason)}." if (reason := ranking_reason(answer)) else ""
    return table(caption, head, rows, (1, 2, 3, 4)) + glossary(_meanings(answer))


def _formulas(data: Dataset, answer: Diagnosis) -> Markup:
    """What the catalogue does not hold: formulas that fit, and the picture of the best."""
    if not answer.formulas:
        return Markup()
    best = answer.formulas[0]
    head = ("formula", "what it is", "evidence", "held-out before → after [deg/h]", "acts [°C]", "as good")
    rows = [
        Row((wide(one.formula), wide("; ".join(filter(None, (one.words, one.like, one.caution)))),
             number(one.evidence) + (f" + {number(one.borne)}" if one.borne else ""),
             f"{number(one.held_out_before_dph)} → {number(one.held_out_rms_dph)}",
             f"{number(one.acts[0])} to {number(one.acts[1])}", wide("; ".join(one.equivalent) or "–")),
            "best" if one is best else "")
        for one in answer.formulas
    ]  # fmt: skip
    caption = "Formulas of measured channels, best first; the evidence also pays for the number of formulas tried."
    if best.borne:
        caption += " After the +: what the check run adds to it."
    parts = heading("A formula for what the catalogue does not hold") + table(caption, head, rows, (2, 3))
    if best.residuals and best.contribution:
        x = figures_diagnosis.coordinate(data, best.model.effects[-1])
        plot = figures_diagnosis.partial_residual(data, x, best.residuals[0], best.contribution[0], "formula")
        words = f"The formula alone, over {x.title}: the data ({_dots(x)}) and the formula."
        parts += figure("fig-missing-formula", plot, words, words)
    return parts


def _meanings(answer: Diagnosis) -> Iterator[tuple[str, str]]:
    """Summaries of the effects found and of their look-alikes."""
    alike = {name for suspect in answer.found for name in suspect.look_alikes}
    for suspect in answer.suspects:
        if suspect.found or suspect.effect in alike:
            yield suspect.effect, summary_of(suspect.effect)


def _suspect(suspect: SuspectedEffect) -> Row:
    fall = f"{number(suspect.held_out_before_dph)} → {number(suspect.held_out_rms_dph)}"
    parameters = "; ".join(_parameter(name, value) for name, value in suspect.parameters.items())
    cells = (
        suspect.effect, number(suspect.evidence), _chance(suspect.chance),
        suspect.reason or fall, _percent(suspect.removes), wide(parameters or "–"),
        wide(", ".join(suspect.look_alikes) or "–"),
    )  # fmt: skip
    return Row(cells, "best" if suspect.found else "")


def _parameter(name: str, value: Value) -> str:
    label = re.sub(r"_[^_]+$", "", name) if "_" in name else name
    if value.at_bound:
        return f"{label} = {number(value.value)} {in_print(value.unit)} (on its bound: not determined)"
    return f"{label} = {in_print(value.words)}".replace("+-", "±").replace("...", "…")


def _chance(chance: float) -> str:
    if not np.isfinite(chance):
        return "–"
    return "never observed" if chance == 0 else _percent(chance)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "–"


def _ladder(answer: Diagnosis, rungs: tuple[Rung, ...]) -> Markup:
    """Error of the model with each effect added."""
    if len(rungs) < 2:
        return Markup()
    plot = figures_diagnosis.improvement_ladder(rungs, finite(answer.floor_dph))
    unseen = "check runs" if answer.check else "blocks left out in turn"
    caption = (
        f"Error with each missing effect added; filled: on data not used for the fit ({unseen}). A rival with an equal "
        "error is equally good by this measure: the evidence selects the effect, and another run confirms it."
    )
    alt = "; ".join(f"{r.name}: {number(r.in_sample_dph)} in-sample, {number(r.held_out_dph)} held-out" for r in rungs)
    head = ("model", "in-sample RMS [deg/h]", "held-out RMS [deg/h]")
    rows = [(r.name, number(r.in_sample_dph), number(r.held_out_dph)) for r in rungs]
    drawn = figure("fig-missing-ladder", plot, caption, f"Error of each model [deg/h]. {alt}")
    return heading("Error with each effect added") + drawn + table("Models with effects added", head, rows, (1, 2))


def _map(data: Dataset, answer: Diagnosis) -> Markup:
    """Residual over temperature and its rate of change."""
    if not answer.residuals:
        return Markup()
    after = answer.unexplained_residuals[0] if answer.found and answer.unexplained_residuals else None
    plot = figures_diagnosis.residual_map(data, answer.residuals[0], after, finite(answer.floor_dph))
    names = listed([suspect.effect for suspect in answer.found])
    where = f"left {answer.model.name}, right with {names} added" if after is not None else answer.model.name
    words = (
        f"Mean residual by temperature and its rate of change: {where}. A sign that changes between heating and "
        "cooling indicates an effect with memory or of the temperature rate; a pale map indicates no missing effect."
    )
    return heading("Residual by temperature and rate") + figure("fig-missing-map", plot, words, words)


def _dots(x: figures_diagnosis.Coordinate) -> str:
    return "dots, diamonds are means" if x.by_direction else "dots"


def _partial(data: Dataset, answer: Diagnosis, suspect: SuspectedEffect) -> Markup:
    """An effect that was found, over the channel that it depends on."""
    if not answer.unexplained_residuals or not suspect.shape:
        return Markup()
    x = figures_diagnosis.coordinate(data, suspect.model.effects[-1])
    plot = figures_diagnosis.partial_residual(
        data, x, answer.unexplained_residuals[0], suspect.shape[0], suspect.effect
    )
    words = f"{suspect.effect} alone, over {x.title}: the data ({_dots(x)}) and the fitted effect."
    return figure(f"fig-missing-{suspect.effect}", plot, words, words)


def _misfit(data: Dataset, answer: Diagnosis) -> Markup:
    """The unexplained residual over the channel that shows it best."""
    left = answer.unexplained_residuals or answer.residuals
    place = next((p for p in answer.unexplained if p.channel in figures_diagnosis.drawable_coordinates(data)), None)
    if answer.verdict != "unknown_effect" or place is None or not left:
        return Markup()
    plot = figures_diagnosis.misfit_figure(data, left[0], place)
    words = f"Unexplained residual over {_channel(place.channel)[0]}: dots, their mean (line), worst range shaded."
    return heading("The unexplained residual") + figure("fig-missing-unknown", plot, words, words)


def _legs(answer: Diagnosis) -> Markup:
    """Evidence for each suspect by leg of the profile."""
    if not answer.suspects or answer.suspects[0].evidence <= answer.threshold:
        return Markup()
    shown = [*answer.found, *rivals(answer, answer.suspects[0])][:_ENOUGH]
    plot = figures_diagnosis.suspects_by_leg(shown)
    words = (
        "Evidence by leg. The bar of a lag doubles with the ramp rate, that of a hysteresis does not; check a suspect "
        "whose evidence comes from one leg only."
    )
    alt = f"Evidence that each segment gives for {', '.join(s.effect for s in shown)}."
    return heading("Evidence by leg") + figure("fig-missing-legs", plot, words, alt)


def _places(answer: Diagnosis) -> Markup:
    """Where the model fails, before and after the effects found."""
    head = ("where", "from", "to", "systematic [deg/h]", "RMS × floor", "by chance", "")
    parts = Markup()
    for caption, shown in (
        (f"Where {answer.model.name} fails", answer.where),
        ("Where it still fails with the effects found", answer.unexplained if answer.found else ()),
    ):
        if shown:
            parts += table(caption, head, [_place(place) for place in shown], (1, 2, 3, 4))
    return heading("Where it fails") + parts if parts else parts


def _place(place: Place) -> tuple[object, ...]:
    name, unit = _channel(place.channel)
    note = in_print(place.note).replace("+-", "±")
    where = f"{name} [{unit}]" if unit else name
    return (
        where,
        *ends(place.low, place.high),
        number(place.misfit_dph, 2),
        number(place.floor_ratio, 2),
        _odds(place.p),
        note,
    )


def _odds(p: float) -> str:
    """A probability as text."""
    if p < _SURE:
        return "less than 1 in a billion"
    return f"1 in {float(f'{1 / max(p, _SURE):.1g}'):,.0f}"


def _channel(name: str) -> tuple[str, str]:
    if name in _OWN_UNITS:
        return _OWN_UNITS[name]
    return name.replace("_", " "), in_print(CHANNELS[name].unit) if name in CHANNELS else ""


def _unseen(answer: Diagnosis) -> Markup:
    """The effects that this run would have shown, and those that it could not."""
    limits = sorted(answer.smallest_detectable, key=lambda limit: limit.rms_dph)
    seen = [limit for limit in limits if limit.seen]
    parts = heading("What this run could not have shown")
    if seen:
        plot = figures_diagnosis.detectable(seen, finite(answer.floor_dph))
        words = "Smallest effect that this run would have shown (RMS over the run)."
        alt = "; ".join(f"{limit.effect}: {number(limit.rms_dph)} deg/h" for limit in seen)
        parts += figure("fig-missing-detectable", plot, words, f"Smallest detectable effects. {alt}")
        head = ("effect", "RMS [deg/h]", "amplitude", "unit", "at")
        parts += Markup("<details><summary>As amplitudes</summary>{}</details>\n").format(
            table("Smallest detectable amplitudes", head, map(_limit, seen), (1, 2))
        )
    blind = [(name, _capital(why)) for name, why in answer.not_excited.items()]
    blind += [(limit.effect, _capital(UNSEEN)) for limit in limits if not limit.seen]
    if blind:
        parts += table("Not tested by this run", ("effect", "why"), [(name, why) for name, why in dict(blind).items()])
    return parts if seen or blind else Markup()


def _limit(limit: Detectable) -> tuple[object, ...]:
    at = ", ".join(f"{name} {number(value)}" for name, value in limit.parameters.items())
    return (limit.effect, number(limit.rms_dph), number(limit.amplitude), in_print(limit.unit), at or "–")


def _notes(answer: Diagnosis) -> Iterator[str]:
    yield made_from(answer)
    if answer.noise_finding and answer.verdict != "adequate":
        yield answer.noise_finding
    yield from answer.notes


def _capital(text: str) -> str:
    return capital(text.removesuffix("."))
