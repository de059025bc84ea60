"""Isothermal runs of units like this one: they tell how its noise drifts, where they scatter as its own run does.

What one isothermal run leaves open, slow noise may take: a slow cause of the size of the noise then has no evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.probes import UNLIKE_FREEDOM, unlike
from bench.analysis.diagnosis.still import Still
from bench.analysis.noise.likelihood import NoiseLattice, Record
from bench.analysis.noise.probability import chi2_tail
from bench.record import Dataset

_LEVEL = 0.001
_WHITER = 1.5  # times its own white noise: another kind of unit


def sister_records(
    own: Record, sisters: Sequence[Dataset], interval_s: float
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records of the sisters whose noise drifts like that of the unit's own isothermal run; a note on each other.

    Each keeps a white noise of its own, from the differences of neighbouring rows.
    Raises InputError: a sister's temperature does not stand still.
    """
    kept, notes = [], []
    for sister in sisters:
        record = Still.of(sister, interval_s).record
        whiter = float(np.mean(record.steps(interval_s) ** 2) / np.mean(own.steps(interval_s) ** 2))
        record = replace(record, white=whiter * (np.ones(len(record.y)) if record.white is None else record.white))
        statistic = unlike((own,), (record,), NoiseLattice((own, record), interval_s)).statistic
        p, size = chi2_tail(statistic, UNLIKE_FREEDOM), float(np.sqrt(whiter))
        if p >= _LEVEL and 1.0 / _WHITER <= size <= _WHITER:
            kept.append(record)
            continue
        how = f"drifts otherwise (p {p:.1g}) than" if p < _LEVEL else f"has {size:.2f} times the white noise of"
        notes.append(f"{sister.name} was left out: it {how} the unit's own isothermal run")
    return tuple(kept), tuple(notes)
