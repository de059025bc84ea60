"""A diagnosis for the workbench, made in the computing process: suspects with their figures, the next experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import (
    DescribedFormula,
    Diagnosis,
    Model,
    Proposal,
    SuspectedEffect,
    diagnose,
    next_experiment,
    rivals,
)
from bench.base import FloatArray, finite, listed, number
from bench.deliver import (
    columns,
    coordinate,
    coordinate_over,
    drawable_coordinates,
    misfit_figure,
    partial_residual,
    residual_map,
    summary_of,
    suspects_by_leg,
    unheld,
)
from bench.record import Dataset, slug, write_atomically
from bench.web.workbench import computing
from bench.web.workbench.asking import model_json
from bench.web.workbench.captions import Said, captioned, effects_said, floor_said, said, span
from bench.web.workbench.computing import Run, Runs

_SIDE_BY_SIDE = 3
"""Suspects whose evidence is drawn side by side, as in the report."""


def diagnosis(inputs: dict[str, Any]) -> dict[str, Any]:
    """The result of `bench diagnose`; with figures, and the next experiment's profile below `plans`, unless `brief`.

    Run folders are not changed.
    """
    runs, check, static, sisters = (
        computing.runs_of(inputs["runs"]), computing.runs_of(inputs["check"]), computing.static_of(inputs),
        computing.runs_of(inputs["sisters"]),
    )  # fmt: skip
    computing.refuse_mixed([*runs, *check, *([static] if static else [])])
    data, brief = [computing.dataset(run) for run in runs], inputs["brief"]
    found = _diagnosed(runs, check, static, sisters, computing.model_text(inputs["model"]))
    content = found.to_json()
    suspects = zip(content["suspects"], found.suspects, strict=True)
    content["suspects"] = [{**entry, **_pictured(data, found, suspect, brief)} for entry, suspect in suspects]
    formulas = zip(content["formulas"], found.formulas, strict=True)
    content["formulas"] = [{**entry, **drawn(data[0], found.model, formula, brief)} for entry, formula in formulas]
    content["figures"] = {} if brief else _figures(data, found)
    content["model_json"], content["improved"] = model_json(found.model), model_json(found.improved)
    still = None if static is None else computing.dataset(static)
    unseen = [computing.dataset(run) for run in check]
    proposal = None if brief else next_experiment(found, data, check=unseen, static=still)
    content["next_experiment"] = None if proposal is None else planned(proposal, Path(inputs["plans"]), data[0].name)
    return content


@lru_cache(maxsize=4)
def _diagnosed(runs: Runs, check: Runs, static: Run | None, sisters: Runs, model: str) -> Diagnosis:
    """A diagnosis, which is told first and drawn later."""
    return diagnose(
        [computing.dataset(run) for run in runs],
        computing.model_of(model),
        check=[computing.dataset(run) for run in check],
        static=None if static is None else computing.dataset(static),
        sisters=[computing.dataset(run) for run in sisters],
        floor_dph=computing.floor(runs, static).floor_dph,
    )


def _pictured(data: Sequence[Dataset], found: Diagnosis, suspect: SuspectedEffect, brief: bool) -> dict[str, Any]:
    """Content of a page about a suspect: its partial residual, its evidence, its model and what that has more."""
    known, effects = {effect.name for effect in found.model.effects}, model_json(suspect.model)["effects"]
    return {
        "why": why(found, suspect),
        "summary": summary_of(suspect.effect),
        "model": model_json(suspect.model),
        "add": [*(entry for entry in effects[:-1] if entry["effect"] not in known), effects[-1]],
        "partial": _partial(data[0], found, suspect) if suspect.shape and not brief else None,
        "family": suspect.model.effects[-1].family,
        "unheld": unheld(suspect.model, suspect.model.effects[-1:], data[0].channels),
    }


def drawn(data: Dataset, model: Model, formula: DescribedFormula, brief: bool = False) -> dict[str, Any]:
    """Content of a page about a formula for `model`: what adds it, with the effects beside it, and its picture."""
    added = formula.model.effects[-1]
    answer: dict[str, Any] = {
        "add": model_json(formula.model)["effects"][len(model.effects) :],
        "partial": None,
        "unheld": unheld(formula.model, (added,), data.channels),
    }
    if formula.residuals and formula.contribution and not brief:
        x, shape = coordinate(data, added), formula.contribution[0]
        caption = said("formula", formula=formula.formula, over={"label": x.title})
        table = columns({x.title: x.values, "data [deg/h]": formula.residuals[0] + shape, "formula [deg/h]": shape})
        plot = partial_residual(data, x, formula.residuals[0], shape, "formula")
        answer["partial"] = captioned(plot, [caption, *_diamonds(x.by_direction)], table)
    return answer


def _partial(data: Dataset, found: Diagnosis, suspect: SuspectedEffect) -> dict[str, Any] | None:
    """Partial residual over the suspect's coordinate: with the other effects found, or for a rival without them."""
    left, shape = _left(found, suspect), suspect.shape[0]
    if left is None or not np.any(np.isfinite(shape)):
        return None
    x = coordinate(data, suspect.model.effects[-1])
    plot = partial_residual(data, x, left, shape, suspect.effect)
    caption = said("partial", effect={"effect": suspect.effect}, over={"label": x.title}, span=span(shape))
    table = columns({x.title: x.values, "data [deg/h]": left + shape, f"{suspect.effect} [deg/h]": shape})
    return captioned(plot, [caption, *_diamonds(x.by_direction)], table)


def _diamonds(drawn: bool) -> list[Said]:
    """What the means of heating and cooling are, where they are drawn."""
    return [said("diamonds")] if drawn else []


def _left(found: Diagnosis, suspect: SuspectedEffect) -> FloatArray | None:
    """Residual of the first run with the suspect [deg/h]; for a rival that was not found, of the model with only it."""
    if suspect.found:
        return found.unexplained_residuals[0] if found.unexplained_residuals else None
    # A rival was tested with the original model: its contribution is subtracted from that residual.
    return found.residuals[0] - suspect.shape[0] if found.residuals else None


def why(found: Diagnosis, suspect: SuspectedEffect) -> str:
    """The evidence for a suspect as text."""
    threshold = number(found.threshold, 2)
    beyond = "significant" if suspect.evidence > found.threshold else "not significant"
    if suspect.found and suspect.evidence <= found.threshold:
        beyond = "significant with the check run"
    parts = [f"Evidence {number(suspect.evidence)}, {beyond} (threshold {threshold})"]
    if suspect.scored:
        before, after = number(suspect.held_out_before_dph), number(suspect.held_out_rms_dph)
        parts.append(f"error on unseen data {before} → {after} deg/h with it")
    elif suspect.reason:
        parts.append(f"not scored on unseen data: {suspect.reason}")
    strongest = max(suspect.legs, key=lambda leg: leg[1], default=("", 0.0))
    if strongest[1] > 0:
        parts.append(f"most of it from '{strongest[0]}'")
    text = "; ".join(parts) + "."
    alike = f" These data cannot distinguish it from {listed(suspect.look_alikes)}." if suspect.look_alikes else ""
    return text + alike


def _figures(data: Sequence[Dataset], found: Diagnosis) -> dict[str, Any]:
    """Map before and after, evidence by leg, where it fails; if available."""
    floor_dph = finite(found.floor_dph)
    figures: dict[str, Any] = {}
    if found.residuals:
        after = found.unexplained_residuals[0] if found.found and found.unexplained_residuals else None
        plot = residual_map(data[0], found.residuals[0], after, floor_dph)
        added = [] if after is None else [said("map_added", effects=effects_said([s.effect for s in found.found]))]
        parts = [said("map", model=found.model.name), *added, floor_said(found.floor_dph)]
        figures["map"] = captioned(plot, parts)
    if found.suspects and found.suspects[0].evidence > found.threshold:
        shown = [*found.found, *rivals(found, found.suspects[0])][:_SIDE_BY_SIDE]
        caption = said("legs", effects=effects_said([s.effect for s in shown]))
        figures["legs"] = captioned(suspects_by_leg(shown), [caption])
    if (worst := _misfit(data[0], found)) is not None:
        figures["misfit"] = worst
    return figures


def _misfit(data: Dataset, found: Diagnosis) -> dict[str, Any] | None:
    """The residual over the channel where the model fails most."""
    places = [place for place in found.where if place.channel in drawable_coordinates(data)]
    if not places or not found.residuals:
        return None
    place = places[0]
    plot = misfit_figure(data, found.residuals[0], place)
    caption = said(
        "misfit", model=found.model.name, over={"label": coordinate_over(data, place.channel).title}, low=place.low,
        high=place.high, unit={"unit": place.unit}, misfit=place.misfit_dph,
    )  # fmt: skip
    return captioned(plot, [caption])


def planned(proposal: Proposal, plans: Path, run: str) -> dict[str, Any]:
    """The proposal, its profile written as a plan that can be started, and the curve of its set point."""
    from bench.acquisition import load_profile
    from bench.web.plans.catalog import curve

    plans.mkdir(parents=True, exist_ok=True)
    plan = slug(f"{proposal.profile_name}_after_{run}")[:120]
    path = plans / f"{plan}.yaml"
    write_atomically(path, proposal.profile_yaml.encode())
    content: Mapping[str, Any] = proposal.to_json(plan)
    known = {"plan": plan, "name": proposal.profile_name, "yaml": proposal.profile_yaml}
    return {**content, **known, "curve": curve(load_profile(path))}
