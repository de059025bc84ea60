"""Computations of the workbench in the computing process: runs, fits, scores; all are cached.

The functions for requests take and return JSON. The keys of the cache are the hashes of the runs' data and the model's
text, so that a result for one page also serves the next one, an Undo or a zoom.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.analysis import Comparison, Fit, Floor, Model, beside_rotation, fit_model, model_from, noise_floor
from bench.analysis import compare as compare_models
from bench.base import BenchError, FloatArray, InputError, finite
from bench.deliver import described, ladder_words, model_ladder
from bench.record import DEFAULT_INTERVAL_S, Dataset, Manifest, load
from bench.web.workbench.asking import ModelJson, model_json
from bench.web.workbench.captions import captioned, floor_said, said, span

FINE_S = 1.0


class Run(NamedTuple):
    """A run by its id, its folder, the hash of its data, and which of several outputs is looked at."""

    id: str
    path: str
    content: str
    output: str | None = None


Runs = tuple[Run, ...]


def runs_of(entries: Sequence[Mapping[str, str]]) -> Runs:
    """Runs of a request."""
    return tuple(Run(entry["run"], entry["path"], entry["content"], entry.get("output")) for entry in entries)


def static_of(inputs: Mapping[str, Any]) -> Run | None:
    """The isothermal run of a request."""
    return runs_of([inputs["static"]])[0] if inputs.get("static") else None


def model_of(text: str) -> Model:
    """Model from its key: the JSON of a model file's content."""
    return model_from(json.loads(text))


def model_text(content: Mapping[str, Any]) -> str:
    """The key of a model."""
    return json.dumps(content, sort_keys=True)


@lru_cache(maxsize=48)
def dataset(run: Run, interval_s: float = DEFAULT_INTERVAL_S) -> Dataset:
    """Means of a run; InputError, with the run's id instead of its folder."""
    try:
        return load(run.path, interval_s, run.output)
    except InputError as error:
        raise InputError(named(str(error), run)) from None


def named(text: str, *runs: Run) -> str:
    """A message with ids instead of folders, because a page must not show the location of the store."""
    for run in runs:
        text = text.replace(run.path, run.id)
    return text


@lru_cache(maxsize=16)
def floor(runs: Runs, static: Run | None, interval_s: float = DEFAULT_INTERVAL_S, *, intervals: bool = False) -> Floor:
    """Noise floor of these runs, computed as in all commands; with the `intervals` of its parts where they are told."""
    still = dataset(static, FINE_S) if static else None
    return noise_floor([dataset(run, FINE_S) for run in runs], interval_s, still, intervals=intervals)


@lru_cache(maxsize=64)
def fitted(runs: Runs, model: str) -> Fit:
    """A fit to all these runs."""
    return fit_model(model_of(model), [dataset(run) for run in runs], covariance="none")


@lru_cache(maxsize=32)
def predicted(runs: Runs, model: str, run: Run, interval_s: float) -> FloatArray:
    """Modelled bias (n,) of one run's means over `interval_s` by a fit to `runs` [deg/h]."""
    return fitted(runs, model).predict(dataset(run, interval_s)).bias


@lru_cache(maxsize=64)
def scored(runs: Runs, check: Runs, static: Run | None, model: str) -> Comparison:
    """One model's errors in-sample, held out and by segment."""
    records, checks = [dataset(run) for run in runs], [dataset(run) for run in check]
    floor_dph = floor(runs, static).floor_dph
    return compare_models(records, [model_of(model)], floor_dph, checks or None, strict=False)


def analysis(inputs: dict[str, Any]) -> dict[str, Any]:
    """Models side by side: the result of `bench compare`, the rungs of the ladder in the given order, its figure."""
    runs, check, static = runs_of(inputs["runs"]), runs_of(inputs["check"]), static_of(inputs)
    refuse_mixed([*runs, *check, *([static] if static else [])])
    texts = [model_text(content) for content in inputs["models"]]
    models = tuple(map(model_of, texts))
    beside = beside_rotation(models, dataset(runs[0])) if inputs.get("turning") else models
    if turned := beside != models:
        texts = [model_text(ModelJson.model_validate(model_json(model)).content()) for model in beside]
    parts = [scored(runs, check, static, text) for text in texts]
    scores = tuple(score for part in parts for score in part.scores)
    refused = tuple(entry for part in parts for entry in part.refused)
    if not scores:
        raise InputError(refused[0][1])
    whole = replace(parts[0], scores=scores, refused=refused)
    content = whole.to_json()
    for entry, score in zip(content["models"], scores, strict=True):
        entry["yaml"] = score.model.to_yaml()
        entry["model"] = model_json(score.model)
        pairs = zip(score.model.keys, score.model.effects, strict=True)
        units = {f"{key}.{one.name}": one.unit for key, effect in pairs for one in effect.parameters}
        entry["parameters"] = [{**one, "unit": units[one["key"]]} for one in entry["parameters"]]
    content["turned"] = turned
    kept = ("name", "rms_dph", "held_out_rms_dph")
    content["rungs"] = [{key: entry[key] for key in kept} for entry in content["models"]]
    content["floor_reason"] = floor(runs, static).reason
    content["ladder"] = ladder(whole)
    content["run_ids"], content["check_ids"] = [run.id for run in runs], [run.id for run in check]
    return content


def ladder(comparison: Comparison) -> dict[str, Any]:
    """The figure of a comparison, its description and its table."""
    scores, floor_dph = comparison.scores, comparison.floor_dph
    names = [score.model.name for score in scores]
    inside, outside = (
        np.array(values) for values in ([s.rms_dph for s in scores], [s.held_out.rms_dph for s in scores])
    )
    band = np.array([score.held_out.interval_dph for score in scores])
    plot = model_ladder(names, inside, outside, band, finite(floor_dph))
    rows = [[n, finite(i), finite(o)] for n, i, o in zip(names, inside.tolist(), outside.tolist(), strict=True)]
    words = ladder_words(names, inside, outside, floor_dph)
    table: list[list[Any]] = [["model", "in-sample RMS [deg/h]", "held-out RMS [deg/h]"], *rows]
    return described(plot, words, [*table, ["noise floor", None, finite(floor_dph)]])


def refuse_mixed(runs: Sequence[Run]) -> None:
    """InputError unless all runs are of one unit: a fit to several units would be meaningless."""
    units = sorted({_unit(run) for run in runs})
    if len(units) > 1:
        raise InputError(f"the runs are of different units ({', '.join(units)}): choose runs of one, or compare two")


@lru_cache(maxsize=256)
def _unit(run: Run) -> str:
    return Manifest.read(Path(run.path)).unit


def difference(inputs: dict[str, Any]) -> dict[str, Any]:
    """The result of `bench diff`, and the difference of the model curves as a figure."""
    from bench.archive import difference_of as differing

    a, b = runs_of([inputs["a"], inputs["b"]])
    try:
        content = differing(Path(a.path), Path(b.path))
    except BenchError as error:
        raise InputError(named(str(error), a, b)) from None
    content["a"]["run"], content["b"]["run"] = a.id, b.id
    content["curves"]["reason"] = named(content["curves"]["reason"], a, b)
    content["figure"] = None if content["curves"]["reason"] else _difference_figure(content["curves"], a.id, b.id)
    return content


def _difference_figure(curves: Mapping[str, Any], a: str, b: str) -> dict[str, Any]:
    from bench.deliver import difference as drawn

    degc = span(np.array([point["degc"] for point in curves["curve"]]))
    sizes = {"rms": curves["rms_dph"], "offset": curves["offset_dph"]}
    parts = [said("difference", a=a, b=b, temperature=degc, **sizes), floor_said(curves["floor_dph"] or float("nan"))]
    return captioned(drawn(curves), parts)
