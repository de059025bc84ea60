"""Sums a block of time: gaps, merging, growth, and blocks that are left out whole."""

import numpy as np
import pytest

from bench.analysis.effects.base import Scale
from bench.analysis.fit.cells import Cells
from bench.analysis.fit.normal import left_out
from bench.analysis.fit.smooth import solve_spline, spline_normal
from bench.analysis.fit.state import State
from tests.support.thermal_cycle import curve, in_cells, record


def test_gaps_are_left_out_and_nothing_stands_in_for_them():
    time, x, y = record()
    random = np.random.default_rng(1)
    x, y = x.copy(), y.copy()
    x[random.random(x.size) < 0.01] = np.nan
    y[20_000:30_000] = np.nan
    kept = np.isfinite(x) & np.isfinite(y)
    with_gaps, without = in_cells(time, x, y), in_cells(time[kept], x[kept], y[kept])
    np.testing.assert_allclose(with_gaps.table, without.table, rtol=1e-11, atol=1e-8)


def test_a_record_that_grows_has_the_sums_of_the_whole():
    time, x, y = record()
    grown = State(Cells(-41.0, 86.0, 96, 10.0))
    for start in range(0, time.size, 777):
        part = slice(start, start + 777)
        grown.add(time[part], {"temperature": x[part]}, y[part])
    np.testing.assert_allclose(grown.table, in_cells(time, x, y).table, rtol=1e-11, atol=1e-8)


def test_blocks_left_out_are_predicted_as_by_a_fit_without_their_rows():
    time, x, y = record()
    state = in_cells(time, x, y)
    label = state.folds(5)
    squares = left_out(spline_normal(state.sums, state.grouped(label), 8, "natural"))
    block = np.floor(time / state.block_s).astype(int)
    for fold in range(5):
        out = np.isin(block, np.flatnonzero(label == fold))
        part = in_cells(time[~out], x[~out], y[~out])
        solved = solve_spline(part.sums, part.table.sum(axis=0), 8)
        residual = y[out] - curve(solved, 8, "natural", Scale(-41.0, 86.0), x[out])
        assert squares[fold] == pytest.approx(np.sum(residual**2), rel=1e-9)


@pytest.mark.parametrize("block_s", [200.0, 1.1, 162.8407776008542])
def test_a_row_on_a_border_begins_the_next_block_however_the_record_is_cut(block_s):
    """Quotients round: 15 x 162.84.. / 162.84.. is less than 15."""
    time = np.sort(np.concatenate([np.arange(40) * block_s, (np.arange(40) + 0.5) * block_s]))
    x = np.linspace(-40.0, 85.0, time.size)
    whole, grown = in_cells(time, x, x, block_s=block_s), in_cells(time[:1], x[:1], x[:1], block_s=block_s)
    for at in range(1, time.size):
        grown.add(time[at : at + 1], {"temperature": x[at : at + 1]}, x[at : at + 1])
    rows = whole.table.reshape(-1, 96, 12)[:, :, 0].sum(axis=1)
    assert rows.tolist() == [2.0] * 40
    np.testing.assert_allclose(grown.table, whole.table, rtol=1e-12, atol=1e-9)
