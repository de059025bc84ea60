"""One pass over the samples beside alternatives, in memory and from a file, and the questions after it.

    python -m benchmarks fit                          # 2 h at 500 Hz: 3.6 million samples; 36 million from a file

The error is the largest difference from the fit in high precision at 997 rows, relative to the largest value of that
fit: columns and sums in extended precision (64 bits), solved with 50 digits. That of a smoothed fit, which has no
unique answer, is relative to the noise-free curve of the samples.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import fit_ours as ours
from benchmarks import fit_peers as peers
from benchmarks.fit_data import CELLS, FOUR, INTERVALS, Data, Predict, data, reference, sketch, truth, write_file
from benchmarks.rounds import Case, Method, Table, compared, forget_the_peak, measured, memory_mb, spawn

ROWS, QUICK_ROWS = 3_600_000, 200_000
FILE_ROWS, QUICK_FILE_ROWS = 36_000_000, 2_000_000
SMOOTH_ROWS = 100_000


def columns(folder: Path, rows: int = 0) -> Data:
    """The samples, or `rows` of them, evenly spread."""
    kept = {path.stem: np.load(path) for path in folder.glob("*.npy")}
    return thinned(kept, rows) if rows else kept


def thinned(d: Data, rows: int) -> Data:
    step = max(1, d["y"].size // rows)
    return {name: column[::step][:rows].copy() for name, column in d.items()}


def error(case: str, predict: Predict, d: Data, folder: Path) -> float:
    exact, at = np.fromfile(folder / f"{case}.ref"), thinned(columns(folder), 997)
    return float(np.max(np.abs(predict(at) - exact)) / np.max(np.abs(exact)))


def error_of_curve(predict: Predict, d: Data, folder: Path) -> float:
    exact, at = truth(d), thinned(d, 997)
    return float(np.max(np.abs(predict(at) - truth(at))) / np.max(np.abs(exact)))


def case_of(name: str, methods: dict[str, Method]) -> Case:
    return Case(columns, lambda d: thinned(d, 20_000), methods, partial(error, name))


SPLINE, REGRESSION, SURFACE, CUBIC = (
    "spline, 24 intervals",
    "regression, 13 coefficients",
    "surface, 21 coefficients",
    "cubic in temperature",
)
SMOOTH = f"smoothing spline, {SMOOTH_ROWS:,} samples; error from the true curve"


def solvers(names: tuple[str, ...], build: Any, *chosen: str) -> dict[str, Method]:
    """Peers that solve least squares on columns that were built and normalised before."""
    known = {
        "scipy gelsy, columns in Fortran order": Method(peers.dense(names, build, peers.gelsy)),
        "scipy gelsy, C order, defaults": Method(peers.dense(names, build, peers.gelsy_rows)),
        "normal equations by hand": Method(peers.dense(names, build, peers.normal_equations)),
        "numpy lstsq": Method(peers.dense(names, build, peers.numpy_lstsq)),
        "statsmodels OLS qr": Method(peers.dense(names, build, peers.statsmodels_qr), ("statsmodels",), once=True),
        "scikit-learn LinearRegression": Method(peers.dense(names, build, peers.sklearn_linear), ("sklearn",)),
    }
    return {name: known[name] for name in chosen or known}


CASES = {
    SPLINE: case_of(
        SPLINE,
        {
            "one pass": Method(ours.our_spline),
            "scipy make_lsq_spline norm-eq, sort": Method(peers.scipy_spline("norm-eq")),
            "scipy make_lsq_spline qr, sort": Method(peers.scipy_spline("qr")),
            "scipy LSQUnivariateSpline, unique": Method(peers.scipy_univariate),
            "scikit-learn SplineTransformer": Method(
                partial(peers.sklearn_spline, sparse=False), ("sklearn",), once=True
            ),
            "scikit-learn SplineTransformer, sparse": Method(partial(peers.sklearn_spline, sparse=True), ("sklearn",)),
            "pyGAM LinearGAM, 27 splines": Method(peers.pygam_spline, ("pygam",), once=True),
            "limit: read T and y once": Method(peers.memory_pass, limit=True),
        },
    ),
    REGRESSION: case_of(REGRESSION, {"one pass": Method(ours.our_regression), **solvers(FOUR, peers.powers_of)}),
    SURFACE: case_of(SURFACE, {"one pass": Method(ours.our_surface), **solvers(peers.PLANE, peers.plane_of)}),
    CUBIC: case_of(
        CUBIC,
        {
            "one pass": Method(lambda d: ours.our_regression(d, ("temperature",))),
            "numpy polyfit": Method(peers.polyfit),
            "numpy Polynomial.fit": Method(peers.polynomial_fit),
        },
    ),
    SMOOTH: Case(
        lambda folder: columns(folder, SMOOTH_ROWS),
        lambda d: thinned(d, 5000),
        {
            "one pass, 48 intervals, smoothing by GCV": Method(ours.our_smooth),
            "pyGAM gridsearch, 51 splines, GCV": Method(peers.pygam_smooth, ("pygam",), once=True),
            "csaps, a knot a sample, smoothing given": Method(peers.csaps_smooth, ("csaps",)),
            "scipy make_smoothing_spline, smoothing given": Method(peers.scipy_smooth),
        },
        error_of_curve,
        repeats=1,
    ),
}


# --- after the pass, and from a file


def after_the_pass(folder: Path) -> dict[str, float]:
    """CPU [ms] of each question after the pass; samples are not read again."""
    from bench.analysis.fit.normal import held_out_rms, left_out, solve
    from bench.analysis.fit.smooth import Smoother, choose_intervals, solve_spline, spline_normal

    d = columns(folder)
    state = ours.our_cells(d)
    cells, touched = state.sums, state.touched
    gram, four = ours.our_gram(FOUR, d)

    def groups() -> np.ndarray:
        return state.grouped(state.folds(20))

    def smooth(criterion: Any) -> Any:
        total = state.table.sum(axis=0)
        own = spline_normal(cells, groups(), 48, "natural")
        return lambda: Smoother.of(cells, total, 48, "natural").choose(criterion, own)

    branch = state.direction == 1
    questions: dict[str, Callable[[], Any]] = {
        "other number of intervals (48)": lambda: solve_spline(cells, state.table.sum(axis=0), 48),
        "natural ends": lambda: solve_spline(cells, state.table.sum(axis=0), 24, "natural"),
        "parabolic run-out": lambda: solve_spline(cells, state.table.sum(axis=0), 24, "parabolic"),
        "periodic ends": lambda: solve_spline(cells, state.table.sum(axis=0), 24, "periodic"),
        "heating only": lambda: solve_spline(cells, state.table[branch].sum(axis=0), 24),
        "number of intervals chosen among 9": lambda: choose_intervals(
            cells, groups(), (2, 3, 4, 6, 8, 12, 16, 24, 32), "natural"
        ),
        "held out: 20 groups of blocks": lambda: left_out(spline_normal(cells, groups(), 24, "natural")),
        "smoothing by GCV": smooth("gcv"),
        "smoothing by REML": smooth("reml"),
        "smoothing by blocks left out": smooth("blocks"),
        "regression again": lambda: solve(gram.normal(four.table.sum(axis=0))),
        "regression, 20 groups held out": lambda: held_out_rms(gram.normal(four.grouped(four.folds(20)))),
    }
    found = {}
    for name, ask in questions.items():
        ask()
        best = np.inf
        for _ in range(7):
            begun = time.process_time()
            ask()
            best = min(best, time.process_time() - begun)
        found[name] = 1e3 * best
    if state.touched != touched:
        raise RuntimeError("a question read samples again")
    return found


def from_file(path: Path, case: str) -> dict[str, Any]:
    """A fit from a Parquet file: CPU and wall with the reading, peak above what the interpreter and imports take."""
    from bench.analysis.effects.base import Scale, Series
    from bench.analysis.fit.cells import Cells
    from bench.analysis.fit.gram import ChebyshevRows, Gram
    from bench.analysis.fit.normal import solve
    from bench.analysis.fit.samples import Samples
    from bench.analysis.fit.smooth import solve_spline
    from bench.analysis.fit.state import State

    before = forget_the_peak()
    cpu, wall = time.process_time(), time.perf_counter()
    samples = Samples(path)
    names = FOUR if case.startswith("regression") else ("temperature",)
    state: Any = None
    for batch in samples.read(names):
        if state is None and case.startswith("spline"):
            state = State(Cells(*samples.range("temperature"), CELLS, float(np.nanmean(batch.y))))
        elif state is None:
            series = tuple(Series(c, 3, Scale(*samples.range(c))) for c in names)
            state = State(Gram.of(names, 13, ChebyshevRows(series), *sketch(path, names)))
        state.add(batch.time, batch.columns, batch.y, batch.segment)
    total = state.table.sum(axis=0)
    if case.startswith("spline"):
        solve_spline(state.sums, total, INTERVALS)
    else:
        solve(state.sums.normal(total))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {"rows": samples.rows, "passes": state.touched / samples.rows, "cpu_s": cpu, "wall_s": wall,
            "peak_mb": memory_mb("VmHWM") - before, "file_mb": path.stat().st_size / 1e6}  # fmt: skip


def tables(quick: bool) -> list[Table]:
    rows, file_rows = (QUICK_ROWS, QUICK_FILE_ROWS) if quick else (ROWS, FILE_ROWS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        d = data(rows)
        for channel, column in d.items():
            np.save(folder / channel, column)
        for case in (SPLINE, REGRESSION, SURFACE, CUBIC):
            reference(case, d, thinned(d, 997)).tofile(folder / f"{case}.ref")
        del d, column
        found = measured("benchmarks.one_pass", folder, CASES, 1 if quick else 2)
        asked = spawn("benchmarks.one_pass", "--after", str(folder))
        for channel in folder.glob("*.npy"):
            channel.unlink()
        path = folder / "data.parquet"
        write_file(path, file_rows)
        files = {case: spawn("benchmarks.one_pass", "--file", str(path), case) for case in (SPLINE, REGRESSION)}
    reading = (
        f"{rows:,} samples in memory; peers start from the same arrays and build, normalise and sort their inputs "
        "themselves, and the relative error is against the fit in 50 digits."
    )
    return [compared("Beside peers", reading, found), _after_table(asked), _file_table(files)]


def _after_table(asked: dict[str, Any]) -> Table:
    failed = [[str(asked["failed"])]] if "failed" in asked else []
    rows = failed or [[question, f"{ms:.2f}"] for question, ms in asked.items()]
    return Table(
        "Questions after the pass",
        "Each is answered from the sums of the pass, and no sample is read again (the benchmark fails if one is).",
        ("question", "CPU ms"),
        rows,
    )


def _file_table(files: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for case, one in files.items():
        if "failed" in one:
            rows.append([case, one["failed"]])
            continue
        times = (f"{one['cpu_s']:.2f}", f"{one['wall_s']:.2f}", f"{one['peak_mb']:.0f}")
        rows.append([case, f"{one['rows']:,}", f"{one['passes']:g}", f"{one['file_mb']:.0f}", *times])
    return Table(
        "From data.parquet, in constant memory",
        "Reading, decoding and fitting together; the peak is what comes on top of interpreter and imports.",
        ("fit", "samples", "passes", "file MB", "CPU s", "wall s", "peak MB"),
        rows,
    )


if __name__ == "__main__":
    what, where = sys.argv[1], Path(sys.argv[2])
    print(json.dumps(after_the_pass(where) if what == "--after" else from_file(where, sys.argv[3])))
