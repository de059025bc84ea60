"""Measures the worst error of each embedded form against the model in double precision, over its validity box."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np

from bench.base import DPH_PER_DPS, IntArray
from bench.deliver.export.delivery import INPUTS, Delivery, Kind, Signal
from bench.deliver.export.evaluate import evaluate
from bench.deliver.export.exact import corrected
from bench.deliver.export.forms import FORMS
from bench.deliver.export.image import read, words_of

_GRID = {1: 2001, 2: 161, 3: 33}
_WALK = 20_000


@dataclass(frozen=True)
class Worst:
    """Worst errors of one form [deg/h, or 1e-6 m/s^2 of an accelerometer]: at all rates, near rest, in motion."""

    form: str
    everywhere: float
    near_rest: float
    moving: float
    words: int

    @property
    def worst(self) -> float:
        """The worst of all."""
        return max(self.everywhere, self.moving)


def worst_errors(delivery: Delivery, forms: Iterable[str] = FORMS) -> list[Worst]:
    """Worst errors of the forms, in the order of the forms."""
    points, walk = grid(delivery), wander(delivery)
    exact = corrected(delivery, points, settled=True), corrected(delivery, walk)
    raw = points[raw_id(delivery)]
    rest = np.abs(raw) <= np.abs(raw).min()
    unit = DPH_PER_DPS if delivery.output == 0 else 1e6
    rows = []
    for form in forms:
        words = words_of(delivery, form, 0, 0)
        image = read(words)
        still = unit * np.abs(evaluate(image, points, settled=True).value - exact[0])
        moving = unit * np.abs(evaluate(image, walk).value - exact[1])
        rows.append(Worst(form, float(still.max()), float(still[rest].max()), float(moving.max()), len(words)))
    return rows


def best_form(rows: Iterable[Worst]) -> Worst:
    """The form with the least worst error."""
    return min(rows, key=lambda row: row.worst)


def raw_id(delivery: Delivery) -> int:
    """Channel id of the raw output."""
    return INPUTS["rate" if delivery.output == 0 else "acceleration"].id


def boxes(delivery: Delivery) -> dict[int, Signal]:
    """Signals of the unit's channels by channel id."""
    return {signal.source: signal for signal in delivery.signals if signal.kind is Kind.CHANNEL}


def grid(delivery: Delivery) -> dict[int, IntArray]:
    """Counts of a dense grid over the box, edges included, at rest and at both ends of the raw output's full scale."""
    own = boxes(delivery)
    count = _GRID.get(len(own), 11)
    axes = {id_: np.linspace(s.low, s.high, count).round().astype(np.int64) for id_, s in own.items()}
    if raw_id(delivery) not in axes:
        full = round(delivery.full_scale / delivery.gain)
        # Odd counts: a float represents 300 million exactly, but few neighbouring integers.
        axes[raw_id(delivery)] = np.array([*(k * full // 7 - 11 * k for k in range(-7, 8))])
    else:
        low, high = axes[raw_id(delivery)][[0, -1]]
        axes[raw_id(delivery)] = np.unique([*axes[raw_id(delivery)], np.clip(0, low, high)])
    points = np.array(list(product(*axes.values())), dtype=np.int64).T
    return dict(zip(axes, points, strict=True))


def wander(delivery: Delivery, rows: int = _WALK, seed: int = 1) -> dict[int, IntArray]:
    """Counts of samples that move through the whole box and past its edges, so that loops open and filters lag."""
    rng, out = np.random.default_rng(seed), {}
    for id_, signal in sorted(boxes(delivery).items()):
        walk = np.cumsum(rng.normal(size=rows)) * 0.03
        folded = 2.1 * np.abs((walk % 2.0) - 1.0) - 1.05
        centre, half = 0.5 * (signal.low + signal.high), 0.5 * (signal.high - signal.low)
        out[id_] = (centre + half * folded).round().astype(np.int64)
    if raw_id(delivery) not in out:
        out[raw_id(delivery)] = rng.integers(-300_000_000, 300_000_000, rows)
    return out
