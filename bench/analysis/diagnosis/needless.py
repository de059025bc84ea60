"""Effects of a model that check runs do not bear out: without them the error there does not rise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.held_out import unseen
from bench.analysis.diagnosis.proof import prove
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.catalogue import catalogue
from bench.analysis.fit.fitting import Fit, fit_model
from bench.base import InputError, number
from bench.record import Dataset


def needless(fit: Fit, layout: Layout, check: Sequence[Dataset]) -> Iterator[str]:
    """A note for each effect of a fitted model, beside its curve, that lowers the error on the check runs by less than
    a proof needs. What acts in no check run is not judged.
    """
    tried = {entry.name for entry in catalogue() if entry.suspect}
    effects = fit.model.effects
    for index, (key, effect) in enumerate(zip(fit.model.keys, effects, strict=True)):
        if not check or effect.name not in tried or len(effects) == 1:
            continue
        model = replace(fit.model, effects=(*effects[:index], *effects[index + 1 :]))
        ready, theta = fit.bound.effects[index], fit.bound.theta[key]
        try:
            if not (effect.moves_abscissa or any(np.ptp(ready.columns(run, theta), axis=0).any() for run in check)):
                continue
            less = fit_model(model, layout.rows.records, covariance="none", weights="count")
        except InputError:
            continue
        rows, values = replace(layout.rows, model=less.model), np.array(list(less.theta.values()))
        proof = prove(unseen(rows, values, check).left, unseen(layout.rows, layout.theta, check).left)
        if proof.falls is False:
            change = f"from {number(proof.after_dph)} to {number(proof.before_dph)} deg/h"
            yield f"the check run does not bear out {key} of the model: without it the error there changes {change}"
