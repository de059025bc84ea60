"""What the analysis costs, counted, not timed: rows, calls, memory, points. More is a regression.

`costs` refuses a bound that would let the work be done twice, so every test here fails when it is. The work of a
simulated second is counted in test_main_job_work.py.
"""

from __future__ import annotations

import gc
import json
import re
import weakref
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench.acquisition.run.runner import run_job
from bench.analysis.effects.base import Scale, Series
from bench.analysis.effects.surface import Surface
from bench.analysis.fit.cells import Cells
from bench.analysis.fit.gram import ChebyshevRows, Gram
from bench.analysis.fit.normal import held_out_rms, left_out, solve
from bench.analysis.fit.products import Products
from bench.analysis.fit.smooth import Smoother, choose_intervals, solve_spline, spline_normal
from bench.analysis.fit.so_far import SoFar
from bench.analysis.fit.state import State
from bench.analysis.noise.allan import allan_deviation
from bench.commands import analysis
from bench.deliver.report.html import render
from drivers.gyro import GyroDecoder
from drivers.journal import JournalWriter, Kind, read_blocks
from drivers.sim.can_gyro import CanGyro
from tests.drivers.test_gyro import Wire
from tests.support.acquisition import job
from tests.support.report_runs import quick
from tests.support.run_folders import CYCLE, make_run, ramp_run
from tests.support.work import calls, costs, peak_bytes

HZ = 100.0
FOUR = ("temperature", "frequency", "drive", "quadrature")
ROWS = 400_000
Columns = dict[str, np.ndarray]


def record() -> tuple[np.ndarray, Columns, np.ndarray]:
    """Time, channels and bias of some cycles of temperature in an hour."""
    random = np.random.default_rng(0)
    time = np.arange(ROWS) / HZ
    swing = np.cos(2 * np.pi * time / time[-1])
    columns = {name: (k + 1) * swing ** (k + 1) + random.normal(0.0, 0.01, ROWS) for k, name in enumerate(FOUR)}
    columns["temperature"] = 22.5 - 62.5 * swing + random.normal(0.0, 0.003, ROWS)
    columns["applied_rate"] = 300.0 * np.sin(time)
    return time, columns, 12.0 + np.sin(columns["temperature"] / 20.0) + random.normal(0.0, 1.0, ROWS)


def series(columns: Columns, names: tuple[str, ...], order: int) -> tuple[Series, ...]:
    return tuple(Series(c, order, Scale(float(columns[c].min()), float(columns[c].max()))) for c in names)


def cells_of(columns: Columns, y: np.ndarray) -> Cells:
    return Cells(float(columns["temperature"].min()), float(columns["temperature"].max()), 96, 12.0)


def gram_of(columns: Columns, y: np.ndarray) -> Gram:
    sample = {c: columns[c][::97].copy() for c in FOUR}
    return Gram.of(FOUR, 13, ChebyshevRows(series(columns, FOUR, 3)), sample, y[::97].copy())


def products_of(columns: Columns, y: np.ndarray) -> Products:
    pair = series(columns, ("applied_rate", "temperature"), 5)
    return Products(pair[0], pair[1], Surface(5, series=pair).terms, 12.0)


KINDS: dict[str, Any] = {"spline": cells_of, "regression": gram_of, "surface": products_of}


class Seen:
    """Sums that count the rows they are given, whatever their caller says."""

    def __init__(self, inner: Any) -> None:
        self.inner, self.needs, self.size, self.rows = inner, inner.needs, inner.size, 0

    def sums(self, columns: Any, y: np.ndarray) -> np.ndarray:
        self.rows += y.size
        return self.inner.sums(columns, y)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pass_sums_each_row_once_and_a_gap_has_one_block_of_time_looked_at_again(kind):
    time, columns, y = record()
    seen = Seen(KINDS[kind](columns, y))
    State(seen).add(time, columns, y)
    assert seen.rows == ROWS
    y[ROWS // 2] = np.nan
    seen.rows, state = 0, State(seen)
    state.add(time, columns, y)
    costs(seen.rows, ROWS + state.block_s * HZ)


@pytest.mark.parametrize(("kind", "per_thousand_rows"), [("spline", 30.0), ("regression", 4.6), ("surface", 4.6)])
def test_a_pass_makes_a_few_calls_for_a_thousand_rows(kind, per_thousand_rows):
    """A stretch of 8192 rows is a few dot products a border of cells, or a product with a vector a column."""
    time, columns, y = record()
    sums = KINDS[kind](columns, y)
    costs(1e3 * calls(lambda: State(sums).add(time, columns, y)) / ROWS, per_thousand_rows)


@pytest.mark.parametrize(("kind", "bound"), [("spline", 1.5e6), ("regression", 1.7e6), ("surface", 2.8e6)])
def test_a_pass_holds_the_columns_of_one_stretch_and_no_more(kind, bound):
    """The columns of all rows would be 42 MB for 13 coefficients, 67 MB for 21."""
    time, columns, y = record()
    sums = KINDS[kind](columns, y)
    costs(peak_bytes(lambda: State(sums).add(time, columns, y)), bound)


@pytest.fixture(scope="module")
def passed() -> tuple[State, State]:
    """Sums of a spline and of a regression, and nothing else: no sample is left that could be read again."""
    time, columns, y = record()
    cells, gram = State(cells_of(columns, y)), State(gram_of(columns, y))
    for state in (cells, gram):
        state.add(time, columns, y)
    gone = [weakref.ref(column) for column in (time, y, *columns.values())]
    del time, columns, y
    gc.collect()
    assert [one() for one in gone] == [None] * len(gone)
    return cells, gram


def smoothed(state: Any, criterion: str) -> Any:
    own = spline_normal(state.sums, state.grouped(state.folds(20)), 48, "natural") if criterion == "blocks" else None
    return Smoother.of(state.sums, state.table.sum(axis=0), 48, "natural").choose(criterion, own)


INTERVALS = (2, 3, 4, 6, 8, 12, 16, 24, 32)
QUESTIONS: dict[str, tuple[Callable[[Any, Any], Any], int]] = {
    "intervals": (lambda c, g: solve_spline(c.sums, c.table.sum(axis=0), 48), 520),
    "ends": (lambda c, g: solve_spline(c.sums, c.table.sum(axis=0), 24, "natural"), 520),
    "heating": (lambda c, g: solve_spline(c.sums, c.table[c.direction == 1].sum(axis=0), 24), 550),
    "number of intervals": (lambda c, g: choose_intervals(c.sums, c.grouped(c.folds(20)), INTERVALS, "natural"), 3100),
    "held-out blocks": (lambda c, g: left_out(spline_normal(c.sums, c.grouped(c.folds(20)), 24, "natural")), 400),
    "smoothing, GCV": (lambda c, g: smoothed(c, "gcv"), 1200),
    "smoothing, REML": (lambda c, g: smoothed(c, "reml"), 2000),
    "smoothing, blocks left out": (lambda c, g: smoothed(c, "blocks"), 4200),
    "regression": (lambda c, g: solve(g.sums.normal(g.table.sum(axis=0))), 480),
    "regression, held-out blocks": (lambda c, g: held_out_rms(g.sums.normal(g.grouped(g.folds(20)))), 400),
}
"""Question, and its calls: some small matrices."""


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_after_the_pass_is_answered_without_the_samples(passed, question):
    ask, most = QUESTIONS[question]
    costs(calls(lambda: ask(*passed)), most)


def test_a_fit_to_every_sample_decodes_each_value_once_for_all_models_blocks_and_segments(tmp_path, monkeypatch):
    """Six columns: time, rate, three of the regression, temperature; and the segment."""
    run = make_run(tmp_path / "run", **ramp_run(CYCLE, rate_hz=8.0))
    decoded, original = Counter(), pq.ParquetFile.iter_batches

    def counted(self, **given):
        for batch in original(self, **given):
            decoded["values"] += batch.num_rows * batch.num_columns
            yield batch

    monkeypatch.setattr(pq.ParquetFile, "iter_batches", counted)
    analysis.compare_every_sample([run], ["polynomial", "regression", "spline"], [])
    assert decoded["values"] == 7 * pq.read_metadata(run / "data.parquet").num_rows


def test_a_second_of_a_live_run_is_a_few_calls_and_an_answer_some_hundreds():
    so_far, t_s = SoFar(-40.0, 85.0), iter(range(10**9))

    def ten_minutes() -> None:
        for second in (next(t_s) for _ in range(640)):
            so_far.add(float(second), 20.0 + second / 1000.0, 1.0)

    costs(calls(ten_minutes) / 640, 10.0)
    costs(calls(so_far.report), 1400)


def blocks_of(samples: int, count: int) -> list[np.ndarray]:
    """Blocks of a unit with so many rate samples each, and slow messages between them."""
    wire = Wire()
    unit = CanGyro(wire, 0, 77, coefficient_set=1)
    slow = samples // 10
    same = {name: np.full(slow, value) for name, value in (("frequency", 14e3), ("drive", 1.2), ("quadrature", 0.01))}
    for block in range(count):
        rate_dph, temperature = np.arange(samples) * 0.0036, 20.0 + 0.005 * np.arange(slow) % 50
        unit.send(
            block * samples / 500,
            SimpleNamespace(rate_dph=rate_dph, temperature=temperature, supply=5.0, **same),
        )
    return wire.blocks


@pytest.mark.parametrize("samples", [500, 5000, 50_000])
def test_a_block_is_decoded_by_the_same_few_calls_however_many_frames_it_holds(samples):
    """A few more for each second, whose frames are counted."""
    decoder, blocks = GyroDecoder("vibratory", 0), iter(blocks_of(samples, 4))
    decoder.decode(next(blocks))
    costs(calls(lambda: decoder.decode(next(blocks))), 460)
    assert decoder.losses.lost == decoder.losses.corrupt == 0


def test_a_block_of_a_journal_is_read_by_a_few_calls(tmp_path):
    journal = JournalWriter(tmp_path / "can0.gtbj")
    for frames in blocks_of(500, 100):
        journal.append(Kind.FRAMES, frames.tobytes(), len(frames), 0.0)
    journal.close()
    read = calls(lambda: [block.frames() for block in read_blocks(tmp_path / "can0.gtbj")])
    costs(read / 100, 22.0)


def test_a_frame_is_decoded_twice_in_its_life_for_the_guards_and_for_the_tables(tmp_path, monkeypatch):
    decoded, original = Counter(), GyroDecoder.decode
    monkeypatch.setattr(
        GyroDecoder, "decode", lambda self, frames: decoded.update(frames=len(frames)) or original(self, frames)
    )
    run = run_job(job(tmp_path)).run
    captured = sum(block.count for block in read_blocks(run.journal / "can0.gtbj") if block.kind is Kind.FRAMES)
    assert captured > 10_000
    assert decoded["frames"] == 2 * captured


def test_an_allan_deviation_holds_the_angle_once_and_works_in_pieces_of_it():
    """One difference of the whole angle for each averaging time would be another record; its copies would be more."""
    rate = np.random.default_rng(0).normal(size=ROWS)
    costs(calls(lambda: allan_deviation(rate, 1.0 / HZ)), 5600)
    costs(peak_bytes(lambda: allan_deviation(rate, 1.0 / HZ)) / rate.nbytes, 1.6)


@pytest.mark.parametrize("rate_hz", [2.0, 8.0])
def test_a_report_reads_the_means_and_draws_a_bounded_number_of_points(tmp_path, monkeypatch, rate_hz):
    """The means are read once; of the samples, two edges are looked up and no column is decoded."""
    run = make_run(tmp_path / "run", **ramp_run(CYCLE, rate_hz=rate_hz))
    read, table, batches = Counter(), pq.ParquetFile.read, pq.ParquetFile.iter_batches
    monkeypatch.setattr(pq.ParquetFile, "read", lambda self, **how: read.update(["tables"]) or table(self, **how))
    monkeypatch.setattr(pq.ParquetFile, "iter_batches", lambda self, **how: read.update(["batches"]) or batches(self))
    page = render(quick(run, "spline"))
    assert read == {"tables": 1}
    drawn = [len(trace.get("x") or ()) for figure in figures(page) for trace in figure["data"]]
    costs(sum(drawn), 7500)


def figures(page: str) -> list[dict[str, Any]]:
    return [json.loads(body) for body in re.findall(r'<script[^>]*>(\{"data".*?)</script>', page, re.DOTALL)]


@pytest.mark.slow
def test_a_bound_that_would_not_notice_work_done_twice_is_refused():
    def once() -> None:
        sorted(range(3), key=abs)

    def twice() -> None:
        once()
        once()

    assert (calls(once), calls(twice)) == (2, 5)
    costs(calls(once), 1.5 * calls(once))
    with pytest.raises(AssertionError, match="done again"):
        costs(calls(twice), 1.5 * calls(once))
    with pytest.raises(AssertionError, match="lower the bound"):
        costs(calls(once), 3 * calls(once))
    assert peak_bytes(lambda: np.zeros(10**6)) == pytest.approx(8e6, rel=0.01)
