"""Models compared on every sample of their runs, from sums of one pass: the object of `bench compare`.

Held out are groups of whole blocks of time, and segments. The floor is that of single samples: the floor of 1 s means
beside the scatter of the samples inside the seconds, which no model of the temperature can explain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis.diagnosis.compare import interval_of, segment_name
from bench.analysis.diagnosis.scores import Comparison, HeldOut, Score, SegmentScore
from bench.analysis.effects.model import Model
from bench.analysis.fit.disturbances import left_out_words, undisturbed
from bench.analysis.fit.every_sample import FOLDS, Pass, SampledRun, read
from bench.analysis.fit.fitting import refuse_unfit
from bench.analysis.fit.normal import left_out
from bench.analysis.fit.solve import one_blas_thread
from bench.base import BoolArray, FloatArray, InputError, IntArray
from bench.record import Dataset, refuse_mixed


def compare_every_sample(
    records: Sequence[SampledRun], models: Sequence[Model], floor_dph: float, *, strict: bool = True, lot: bool = False
) -> Comparison:
    """Score models on all samples of runs of one unit; `floor_dph` is the floor of their 1 s means [deg/h].

    A model that cannot be fitted raises its InputError, or is refused where not `strict`.
    """
    refuse_unfit(record.means for record in records)
    if not lot:
        refuse_mixed(record.means for record in records)
    floor = sample_floor([record.seconds for record in records], floor_dph)
    scores, refused = [], []
    with one_blas_thread():
        for model, one in zip(models, read(models, records), strict=True):
            try:
                if isinstance(one, InputError):
                    raise one
                scores.append(_score(one, records, floor))
            except InputError as error:
                if strict:
                    raise
                refused.append((model.name, str(error)))
    runs = tuple(record.means.name for record in records)
    interval_s = scores[0].fit.interval_s if scores else np.nan
    left_out = left_out_words([undisturbed(record.means) for record in records])
    return Comparison(runs, (), floor, interval_s, tuple(scores), tuple(refused), left_out)


def sample_floor(seconds: Sequence[Dataset], floor_dph: float) -> float:
    """Floor [deg/h] of single samples, out of that of 1 s means and the variances inside the seconds."""
    return float(np.sqrt(floor_dph**2 + _inside(seconds)))


def of_seconds(rms_dph: float, seconds: Sequence[Dataset]) -> float:
    """RMS of the 1 s means of residuals whose samples have this RMS [deg/h]: a model hardly moves inside a second."""
    return float(np.sqrt(max(rms_dph**2 - _inside(seconds), 0.0)))


def _inside(seconds: Sequence[Dataset]) -> float:
    """Mean square [deg^2/h^2] of the samples about the mean of their second; NaN where none has two."""
    variance = np.concatenate([one.variances.get("rate", np.full(len(one), np.nan)) for one in seconds])
    count = np.concatenate([one.count("rate") for one in seconds])
    present = np.isfinite(variance) & (count > 1)
    if not present.any():
        return np.nan
    return float(np.sum(variance[present] * (count[present] - 1)) / np.sum(count[present]))


def _score(one: Pass, records: Sequence[SampledRun], floor_dph: float) -> Score:
    fit, done = one.fit(records), one.solved()
    state = one.state
    inner = done.inner
    # Of all blocks, also those of the branch that was not fitted.
    folds = one.normal(state.grouped(state.folds(FOLDS)))
    squares = folds.error(inner)
    by_blocks = _left_out(one, state.folds(FOLDS), "blocks")
    return Score(
        model=one.model,
        fit=fit,
        rms_dph=_rms(squares, folds.rows),
        interval_dph=interval_of(squares, folds.rows),
        held_out=by_blocks,
        by_blocks=by_blocks,
        by_segments=_left_out(one, 100_000 * state.run + state.segment, "segments"),
        segments=tuple(_segments(one, records, inner, floor_dph)),
    )


def _left_out(one: Pass, label: IntArray, by: str) -> HeldOut:
    """Every group of blocks predicted by the fit to the rows of all others; no sample is read again."""
    if np.unique(label).size < 2:
        return HeldOut(by, reason=f"the data are one piece: nothing can be left out by {by}")
    groups = one.normal(one.state.grouped(label))
    squares = left_out(groups, fitted=None if one.rows.all() else one.normal(_branch(one, label, one.rows)))
    if not np.all(np.isfinite(squares)):
        lost = int(np.flatnonzero(~np.isfinite(squares))[0])
        return HeldOut(by, reason=f"without {by.removesuffix('s')} {lost + 1} the model is not determined")
    return HeldOut(by, _rms(squares, groups.rows), interval_of(squares, groups.rows), out_of_range=np.nan)


def _branch(one: Pass, label: IntArray, keep: BoolArray) -> FloatArray:
    """Sums of the groups with the blocks of the model's branch alone; a group may have none."""
    share = (label == np.unique(label)[:, None]) & keep
    sums: FloatArray = share.astype(np.float64) @ one.state.table
    return sums


def _segments(one: Pass, records: Sequence[SampledRun], inner: FloatArray, floor_dph: float) -> list[SegmentScore]:
    scores = []
    for run, record in enumerate(records):
        for index in np.unique(one.state.segment[one.state.run == run]).tolist():
            chosen = (one.state.run == run) & (one.state.segment == index)
            form = one.normal(one.state.table[chosen].sum(axis=0))
            rms = _rms(form.error(inner), form.rows)
            scores.append(SegmentScore(record.means.name, segment_name(record.means, index), rms, rms / floor_dph))
    return scores


def _rms(squares: FloatArray, rows: FloatArray) -> float:
    return float(np.sqrt(np.sum(squares) / np.sum(rows)))
