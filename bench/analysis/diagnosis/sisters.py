"""Isothermal runs of units like this one: they tell how its noise drifts, where they scatter as its own run does.

What one isothermal run leaves open, slow noise may take: a slow cause of the size of the noise then has no evidence.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.analysis.diagnosis.probes import UNLIKE_FREEDOM, unlike
from bench.analysis.diagnosis.suspects import isothermal
from bench.analysis.noise.likelihood import NoiseLattice, Record
from bench.analysis.noise.probability import chi2_tail
from bench.record import Dataset

_LEVEL = 0.001


def sister_records(
    own: Record, sisters: Sequence[Dataset], interval_s: float
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records of the sisters whose noise is not unlike that of the unit's own isothermal run; a note on each other.

    Raises InputError: a sister's temperature does not stand still.
    """
    kept, notes = [], []
    for sister in sisters:
        record = isothermal(sister, interval_s)
        statistic, ratio = unlike((own,), (record,), NoiseLattice((own, record), interval_s))
        p = chi2_tail(statistic, UNLIKE_FREEDOM)
        if p >= _LEVEL:
            kept.append(record)
            continue
        white = f"white noise {1.0 / ratio:.2f} times that of the unit's own isothermal run"
        notes.append(f"{sister.name} was left out: it scatters otherwise (p {p:.1g}, {white})")
    return tuple(kept), tuple(notes)
