"""The one-pass fits of the bench on arrays, each as a function that predicts."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.fit_data import CELLS, FOUR, INTERVALS, Data, Predict, ends


def state_of(sums: Any, d: Data) -> Any:
    from bench.analysis.fit.state import State

    state = State(sums)
    state.add(d["time"], d, d["y"])
    return state


def our_cells(d: Data) -> Any:
    from bench.analysis.fit.cells import Cells

    return state_of(Cells(*ends(d["temperature"]), CELLS, float(d["y"][:1000].mean())), d)


def our_spline(d: Data) -> Predict:
    from bench.analysis.effects.base import Scale
    from bench.analysis.effects.spline import Spline
    from bench.analysis.fit.smooth import solve_spline

    state = our_cells(d)
    solved = solve_spline(state.sums, state.table.sum(axis=0), INTERVALS, "free")
    return curve(Spline(INTERVALS, "free", Scale(state.sums.low, state.sums.high)), solved.beta)


def our_smooth(d: Data) -> Predict:
    """48 intervals, smoothing chosen by GCV."""
    from bench.analysis.effects.base import Scale
    from bench.analysis.effects.spline import Spline
    from bench.analysis.fit.smooth import Smoother

    state = our_cells(d)
    chosen = Smoother.of(state.sums, state.table.sum(axis=0), 2 * INTERVALS, "natural").choose("gcv")
    spline = Spline(2 * INTERVALS, "natural", Scale(state.sums.low, state.sums.high))
    return curve(spline, chosen.solved.beta)


def curve(spline: Any, beta: np.ndarray) -> Predict:
    from bench.record.dataset import Dataset

    def predict(at: Data) -> np.ndarray:
        n = at["y"].size
        rows = Dataset("at", np.arange(float(n)), {"temperature": at["temperature"]}, np.zeros(n, dtype=np.int64))
        return beta[0] + spline.columns(rows, {}) @ beta[1:]

    return predict


def our_gram(channels: tuple[str, ...], d: Data) -> tuple[Any, Any]:
    from bench.analysis.effects.base import Scale, Series
    from bench.analysis.fit.gram import SAMPLE, ChebyshevRows, Gram

    series = tuple(Series(c, 3, Scale(*ends(d[c]))) for c in channels)
    step = max(1, d["y"].size // SAMPLE)
    sample = {c: np.ascontiguousarray(d[c][::step]) for c in channels}
    gram = Gram.of(channels, 1 + 3 * len(channels), ChebyshevRows(series), sample, d["y"][::step].copy())
    return gram, state_of(gram, d)


def our_regression(d: Data, channels: tuple[str, ...] = FOUR) -> Predict:
    from bench.analysis.fit.normal import solve

    gram, state = our_gram(channels, d)
    solved = solve(gram.normal(state.table.sum(axis=0)))

    def predict(at: Data) -> np.ndarray:
        out = np.empty((gram.width, at["y"].size))
        gram.design(at, out)
        return solved.beta @ out

    return predict


def our_surface(d: Data) -> Predict:
    from bench.analysis.effects.base import Scale, Series
    from bench.analysis.effects.surface import Surface
    from bench.analysis.fit.normal import solve
    from bench.analysis.fit.products import Products

    pair = tuple(Series(c, 5, Scale(*ends(d[c]))) for c in ("applied_rate", "temperature"))
    terms = Surface(5, series=pair).terms
    products = Products(*pair, terms, float(d["y"][:1000].mean()))
    solved = solve(products.normal(state_of(products, d).table.sum(axis=0)))

    def predict(at: Data) -> np.ndarray:
        x, z = (np.polynomial.chebyshev.chebvander(one.scale.unit(at[one.channel]), 5) for one in pair)
        return sum(b * x[:, i] * z[:, j] for b, (i, j) in zip(solved.beta, terms, strict=True))

    return predict
