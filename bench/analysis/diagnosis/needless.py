"""Effects of a model that check runs do not bear out: without them the error there does not rise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.held_out import acts, unseen
from bench.analysis.diagnosis.proof import LeftOut, prove
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.catalogue import suspected
from bench.analysis.fit.fitting import Fit, fit_model
from bench.base import InputError, number
from bench.record import Dataset


def needless(fit: Fit, layout: Layout, check: Sequence[Dataset], left: LeftOut) -> Iterator[str]:
    """A note for each effect of a fitted model, beside its curve, that lowers the error on the check runs by less than
    a proof needs; `left` is what the whole model leaves there. What acts in no check run is not judged.
    """
    effects = fit.model.effects
    if not check or len(effects) == 1:
        return
    tried = suspected()
    for index, (key, effect) in enumerate(zip(fit.model.keys, effects, strict=True)):
        if effect.name not in tried:
            continue
        model = replace(fit.model, effects=(*effects[:index], *effects[index + 1 :]))
        try:
            if not acts(fit.bound.effects[index], fit.bound.theta[key], check):
                continue
            less = fit_model(model, layout.rows.records, covariance="none", weights="count")
        except InputError:
            continue
        rows, values = replace(layout.rows, model=less.model), np.array(list(less.theta.values()))
        proof = prove(unseen(rows, values, check).left, left)
        if proof.falls is False:
            change = f"from {number(proof.after_dph)} to {number(proof.before_dph)} deg/h"
            yield f"the check run does not bear out {key} of the model: without it the error there changes {change}"
