"""What the computing process does for the workbench: runs, fits, scores. Each is done once and kept while it lasts.

Everything here takes and gives JSON. Keys of what is kept are the hashes of the runs' data and the model's text: what
was computed for one page is there for the next, for an Undo, for a zoom.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.analysis import Comparison, Fit, Floor, Model, fit_model, model_from, noise_floor
from bench.analysis import compare as compare_models
from bench.base import BenchError, FloatArray, InputError, finite
from bench.deliver import described, ladder_words, model_ladder
from bench.record import DEFAULT_INTERVAL_S, Dataset, Manifest, load

FINE_S = 1.0


class Run(NamedTuple):
    """A run by its id, its folder, and the hash of its data."""

    id: str
    path: str
    content: str


Runs = tuple[Run, ...]


def runs_of(entries: Sequence[Mapping[str, str]]) -> Runs:
    """Runs of a request."""
    return tuple(Run(entry["run"], entry["path"], entry["content"]) for entry in entries)


def static_of(wanted: Mapping[str, Any]) -> Run | None:
    """The isothermal run of a request."""
    return runs_of([wanted["static"]])[0] if wanted.get("static") else None


def model_of(text: str) -> Model:
    """Model from the JSON of a model file's content, which is how models are keys."""
    return model_from(json.loads(text))


def model_text(content: Mapping[str, Any]) -> str:
    """The key of a model."""
    return json.dumps(content, sort_keys=True)


@lru_cache(maxsize=48)
def dataset(run: Run, interval_s: float = DEFAULT_INTERVAL_S) -> Dataset:
    """Means of a run; InputError, with the run's id in it instead of its folder."""
    try:
        return load(run.path, interval_s)
    except InputError as error:
        raise InputError(named(str(error), run)) from None


def named(text: str, *runs: Run) -> str:
    """A message with ids instead of folders: where the store lies is nobody's business who looks at a page."""
    for run in runs:
        text = text.replace(run.path, run.id)
    return text


@lru_cache(maxsize=16)
def floor(runs: Runs, static: Run | None, interval_s: float = DEFAULT_INTERVAL_S) -> Floor:
    """Noise floor of these runs, as all commands tell it."""
    still = dataset(static, FINE_S) if static else None
    return noise_floor([dataset(run, FINE_S) for run in runs], interval_s, still)


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


def analysis(wanted: dict[str, Any]) -> dict[str, Any]:
    """Models side by side: what `bench compare` answers, the rungs of the ladder in the order asked, and its figure."""
    runs, check, static = runs_of(wanted["runs"]), runs_of(wanted["check"]), static_of(wanted)
    refuse_mixed([*runs, *check, *([static] if static else [])])
    texts = [model_text(content) for content in wanted["models"]]
    parts = [scored(runs, check, static, text) for text in texts]
    scores = tuple(score for part in parts for score in part.scores)
    refused = tuple(entry for part in parts for entry in part.refused)
    if not scores:
        raise InputError(refused[0][1])
    whole = replace(parts[0], scores=scores, refused=refused)
    content = whole.to_json()
    for entry, score in zip(content["models"], scores, strict=True):
        entry["yaml"] = score.model.to_yaml()
    kept = ("name", "rms_dph", "held_out_rms_dph")
    content["rungs"] = [{key: entry[key] for key in kept} for entry in content["models"]]
    content["floor_reason"] = floor(runs, static).reason
    content["ladder"] = ladder(whole)
    content["run_ids"], content["check_ids"] = [run.id for run in runs], [run.id for run in check]
    return content


def ladder(found: Comparison) -> dict[str, Any]:
    """The figure of a comparison, its words and its table."""
    names = [score.model.name for score in found.scores]
    inside, outside = (
        np.array(values) for values in ([s.rms_dph for s in found.scores], [s.held_out.rms_dph for s in found.scores])
    )
    band = np.array([score.held_out.interval_dph for score in found.scores])
    plot = model_ladder(names, inside, outside, band, finite(found.floor_dph))
    rows = [[n, finite(i), finite(o)] for n, i, o in zip(names, inside.tolist(), outside.tolist(), strict=True)]
    words = ladder_words(names, inside, outside, found.floor_dph)
    table: list[list[Any]] = [["model", "in-sample RMS [deg/h]", "held-out RMS [deg/h]"], *rows]
    return described(plot, words, [*table, ["noise floor", None, finite(found.floor_dph)]])


def refuse_mixed(runs: Sequence[Run]) -> None:
    """InputError where runs are not of one unit: a fit over several would be of none."""
    units = sorted({_unit(run) for run in runs})
    if len(units) > 1:
        raise InputError(f"the runs are of different units ({', '.join(units)}): choose runs of one, or compare two")


@lru_cache(maxsize=256)
def _unit(run: Run) -> str:
    return Manifest.read(Path(run.path)).unit


def difference(wanted: dict[str, Any]) -> dict[str, Any]:
    """What `bench diff` answers, and the difference of the model curves as a figure."""
    from bench.archive import difference_of as differing
    from bench.deliver import difference as drawn

    a, b = runs_of([wanted["a"], wanted["b"]])
    try:
        content = differing(Path(a.path), Path(b.path))
    except BenchError as error:
        raise InputError(named(str(error), a, b)) from None
    content["a"]["run"], content["b"]["run"] = a.id, b.id
    content["curves"]["reason"] = named(content["curves"]["reason"], a, b)
    content["figure"] = drawn(content["curves"], a.id, b.id)
    return content
