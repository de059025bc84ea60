"""What an engineer must know before trusting the numbers of a run: one line each, the gravest first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bench.analysis.diagnosis.compare import ladder, plain_name
from bench.analysis.diagnosis.scores import Comparison, Score
from bench.analysis.judging.completeness import DAMAGED_BYTES, LOST, Completeness
from bench.analysis.judging.joints import Joint
from bench.analysis.noise.floor import Floor
from bench.analysis.thresholds import LEAST_BRANCH_S, MOST_EXTRAPOLATED, OVERFIT_RATIO
from bench.base import clock, number

_SHOWN_GAPS = 3


_COMMON = frozenset(model.name for model in ladder()[:3])
"""Baselines: the user did not ask for them, so no warning is due where one could not be fitted."""


def refused_models(comparison: Comparison) -> tuple[tuple[str, str], ...]:
    """Name of each model that the data cannot determine, and why."""
    return tuple((name, reason.removeprefix(f"model '{name}' ")) for name, reason in comparison.refused)


def cautions(
    done: Completeness,
    floor: Floor | None,
    comparison: Comparison | None,
    best: Score | None,
    gaps: Sequence[Joint] = (),
) -> tuple[str, ...]:
    """Warnings of a run, none for one that is as it should be; `gaps` are those between its parts."""
    return (*(gap.sentence for gap in gaps), *_of_data(done), *_of_floor(floor), *_of_models(comparison, best))


def short_branches(done: Completeness) -> Iterator[str]:
    """One line for each direction that is too short to compare the two."""
    for name, seconds in (("heating", done.heating_s), ("cooling", done.cooling_s)):
        if done.samples and seconds < LEAST_BRANCH_S:
            yield f"only {clock(seconds)} of {name}: a difference between heating and cooling cannot be seen"


def unproven(best: Score) -> Iterator[str]:
    """Why the error of a model on unseen data is missing or does not count."""
    name, held_out = best.model.name, best.held_out
    if not np.isfinite(held_out.rms_dph):
        yield f"'{name}' has no error on unseen data: {held_out.reason}"
    if held_out.out_of_range > MOST_EXTRAPOLATED:
        yield f"{held_out.out_of_range:.0%} of the unseen data lie outside the range that '{name}' was fitted to"


def _of_data(done: Completeness) -> Iterator[str]:
    for segment in done.failed:
        yield f"segment '{segment.name}' failed: {segment.reason or segment.outcome}"
    for entry in done.left_out:
        what = "readings" if entry.channel == "chamber_temperature" else "samples"
        span = f"{clock(entry.from_s)} to {clock(entry.to_s)}"
        yield f"{entry.why}: {entry.samples} {what} between {span} are no measurements and were left out"
    for key in LOST:
        if key == "invalid" and done.left_out:
            continue
        if done.losses.get(key):
            what = "bytes of the journal damaged" if key == DAMAGED_BYTES else f"frames {key}"
            yield f"{done.losses[key]} {what}: they are gaps in the data"
    if done.capture is not None and done.capture.behind_spells:
        most_s, spells = done.capture.most_behind_s, done.capture.behind_spells
        yield f"the capture was behind its bus {spells} times, at most {number(most_s)} s: the host was overloaded"
    if done.gaps_s:
        shown = ", ".join(f"{clock(a)} to {clock(b)}" for a, b in done.gaps_s[:_SHOWN_GAPS])
        more = f" and {len(done.gaps_s) - _SHOWN_GAPS} more" if len(done.gaps_s) > _SHOWN_GAPS else ""
        yield f"no sample at {shown}{more}; nothing was filled in"
    yield from done.lacking()
    yield from short_branches(done)


def _of_floor(floor: Floor | None) -> Iterator[str]:
    if floor is not None and floor.reason:
        yield f"noise floor not known: {floor.reason}"


def _of_models(comparison: Comparison | None, best: Score | None) -> Iterator[str]:
    if comparison is not None:
        for model, reason in refused_models(comparison):
            if plain_name(model) not in _COMMON:
                yield f"model '{model}' was refused: {reason}"
        yield from comparison.left_out
    if best is None:
        return
    yield from unproven(best)
    if best.held_out.rms_dph > OVERFIT_RATIO * best.rms_dph:
        ratio = number(best.held_out.rms_dph / best.rms_dph, 2)
        yield f"the error of '{best.model.name}' is {ratio} × larger on unseen data than on the data it was fitted to"
    told = comparison.left_out if comparison is not None else ()
    yield from (text for text in best.fit.warnings if text not in told)
