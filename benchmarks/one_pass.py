"""One pass over the samples beside what a user would call instead: CPU, wall, peak memory, error, in one run.

    python -m benchmarks.one_pass                     # 2 h at 500 Hz: 3.6 million samples
    python -m benchmarks.one_pass --file-rows 36000000 # the same fits from a Parquet file, in constant memory

Every method runs in a process of its own with one thread, warmed up on a few rows, in rounds that alternate between the
methods; the least CPU time of all rounds counts. Peers build their columns and sort as their user must. The error is
the largest difference from the fit in many digits at 997 rows, relative to the largest value of that fit: columns and
sums in extended precision (64 bits), solved with 50 digits.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.update({name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")})

import numpy as np

HZ, INTERVALS, CELLS = 500.0, 24, 96
RATE = 6e6
"""Range of the raw rate, a 24-bit count."""
FOUR = ("temperature", "frequency", "drive", "quadrature")
OURS = "one pass"

Data = dict[str, np.ndarray]
Predict = Callable[[Data], np.ndarray]


def data(rows: int, seed: int = 0, first: int = 0, of: int = 0) -> Data:
    """Samples of -40 .. 85 degC and back; `first` and `of` for a part of a longer record."""
    random = np.random.default_rng((seed, first))
    whole = of or rows
    t = (first + np.arange(rows)) / HZ
    phase = 2 * np.pi * t / (whole / HZ)
    temperature = 22.5 - 62.5 * np.cos(phase) + random.normal(0.0, 0.003, rows)
    y = 12.0 + 3.0 * np.sin(temperature / 20.0) + 0.02 * temperature + random.normal(0.0, 1.0, rows)
    return {
        "time": t,
        "temperature": temperature,
        "frequency": 9800.0 - 0.06 * (temperature - 22.5) + 1e-5 * temperature**2 + random.normal(0.0, 0.02, rows),
        "drive": 1.0 + 1e-3 * np.sin(phase * 17.0) + random.normal(0.0, 2e-4, rows),
        "quadrature": 0.05 * np.sin(phase * 5.0) + random.normal(0.0, 1e-3, rows),
        "applied_rate": RATE * np.sin(phase * 240.0),
        "y": y,
    }


def unit(x: np.ndarray, low: float, high: float) -> np.ndarray:
    return (x - (low + high) / 2) / ((high - low) / 2)


def ends(x: np.ndarray) -> tuple[float, float]:
    return float(x.min()), float(x.max())


# --- ours


def state_of(sums: Any, d: Data) -> Any:
    from bench.fit.state import State

    state = State(sums)
    state.add(d["time"], d, d["y"])
    return state


def our_cells(d: Data) -> Any:
    from bench.fit.cells import Cells

    return state_of(Cells(*ends(d["temperature"]), CELLS, float(d["y"][:1000].mean())), d)


def our_spline(d: Data) -> Predict:
    from bench.dataset import Dataset
    from bench.effects.base import Scale
    from bench.effects.spline import Spline
    from bench.fit.smooth import solve_spline

    state = our_cells(d)
    solved = solve_spline(state.sums, state.table.sum(axis=0), INTERVALS, "free")
    spline = Spline(INTERVALS, "free", Scale(state.sums.low, state.sums.high))

    def predict(at: Data) -> np.ndarray:
        n = at["y"].size
        rows = Dataset("at", np.arange(float(n)), {"temperature": at["temperature"]}, np.zeros(n, dtype=np.int64))
        return solved.beta[0] + spline.columns(rows, {}) @ solved.beta[1:]

    return predict


def our_gram(channels: tuple[str, ...], d: Data) -> tuple[Any, Any]:
    from bench.effects.base import Scale, Series
    from bench.fit.gram import SAMPLE, Gram, chebyshev_rows

    series = tuple(Series(c, 3, Scale(*ends(d[c]))) for c in channels)
    step = max(1, d["y"].size // SAMPLE)
    sample = {c: np.ascontiguousarray(d[c][::step]) for c in channels}
    gram = Gram.of(channels, 1 + 3 * len(channels), chebyshev_rows(series), sample, d["y"][::step].copy())
    return gram, state_of(gram, d)


def our_regression(d: Data, channels: tuple[str, ...] = FOUR) -> Predict:
    from bench.fit.normal import solve

    gram, state = our_gram(channels, d)
    solved = solve(gram.normal(state.table.sum(axis=0)))

    def predict(at: Data) -> np.ndarray:
        out = np.empty((gram.width, at["y"].size))
        gram.design(at, out)
        return solved.beta @ out

    return predict


def our_surface(d: Data) -> Predict:
    from bench.effects.base import Scale, Series
    from bench.effects.surface import Surface
    from bench.fit.normal import solve
    from bench.fit.products import Products

    pair = tuple(Series(c, 5, Scale(*ends(d[c]))) for c in ("applied_rate", "temperature"))
    terms = Surface(5, series=pair).terms
    products = Products(*pair, terms, float(d["y"][:1000].mean()))
    solved = solve(products.normal(state_of(products, d).table.sum(axis=0)))

    def predict(at: Data) -> np.ndarray:
        x, z = (np.polynomial.chebyshev.chebvander(one.scale.unit(at[one.channel]), 5) for one in pair)
        return sum(b * x[:, i] * z[:, j] for b, (i, j) in zip(solved.beta, terms, strict=True))

    return predict


# --- peers


def clamped(d: Data) -> np.ndarray:
    low, high = ends(d["temperature"])
    return np.r_[[low] * 3, np.linspace(low, high, INTERVALS + 1), [high] * 3]


def scipy_spline(method: str) -> Callable[[Data], Predict]:
    def work(d: Data) -> Predict:
        from scipy.interpolate import make_lsq_spline

        order = np.argsort(d["temperature"])
        fitted = make_lsq_spline(d["temperature"][order], d["y"][order], clamped(d), 3, method=method)
        return lambda at: fitted(at["temperature"])

    return work


def scipy_univariate(d: Data) -> Predict:
    from scipy.interpolate import LSQUnivariateSpline

    x, first = np.unique(d["temperature"], return_index=True)
    fitted = LSQUnivariateSpline(x, d["y"][first], clamped(d)[4:-4])
    return lambda at: fitted(at["temperature"])


def powers_of(d: Data, bounds: list[tuple[float, float]]) -> np.ndarray:
    """13 columns, normalised, in the order of memory that LAPACK wants."""
    out = np.empty((d["y"].size, 13), order="F")
    out[:, 0] = 1.0
    for k, (name, own) in enumerate(zip(FOUR, bounds, strict=True)):
        z = unit(d[name], *own)
        out[:, 3 * k + 1], out[:, 3 * k + 2], out[:, 3 * k + 3] = z, z * z, z * z * z
    return out


def plane_of(d: Data, bounds: list[tuple[float, float]]) -> np.ndarray:
    """21 columns, normalised."""
    x, z = (unit(d[name], *own) for name, own in zip(("applied_rate", "temperature"), bounds, strict=True))
    a, b = [np.ones_like(x)], [np.ones_like(z)]
    for _ in range(5):
        a.append(a[-1] * x)
        b.append(b[-1] * z)
    out = np.empty((x.size, 21), order="F")
    for column, (i, j) in enumerate((total - j, j) for total in range(6) for j in range(total + 1)):
        np.multiply(a[i], b[j], out=out[:, column])
    return out


def gelsy(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    from scipy import linalg

    return linalg.lstsq(columns, y, lapack_driver="gelsy", check_finite=False, overwrite_a=True)[0]


def gelsy_rows(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """As a user has them who stacked the columns: a row after the other in memory, with the checks of the defaults."""
    from scipy import linalg

    return linalg.lstsq(np.ascontiguousarray(columns), y, lapack_driver="gelsy")[0]


def normal_equations(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    from scipy import linalg

    return linalg.cho_solve(linalg.cho_factor(columns.T @ columns), columns.T @ y)


def numpy_lstsq(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(columns, y, rcond=None)[0]


def statsmodels_qr(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    import statsmodels.api as sm

    return np.asarray(sm.OLS(y, columns).fit(method="qr").params)


def dense(names: tuple[str, ...], build: Any, solver: Any) -> Callable[[Data], Predict]:
    def work(d: Data) -> Predict:
        bounds = [ends(d[name]) for name in names]
        beta = solver(build(d, bounds), d["y"])
        return lambda at: build(at, bounds) @ beta

    return work


def polyfit(d: Data) -> Predict:
    beta = np.polyfit(d["temperature"], d["y"], 3)
    return lambda at: np.polyval(beta, at["temperature"])


def polynomial_fit(d: Data) -> Predict:
    fitted = np.polynomial.Polynomial.fit(d["temperature"], d["y"], 3)
    return lambda at: fitted(at["temperature"])


def memory_pass(d: Data) -> Predict:
    total = d["temperature"].sum() + d["y"].sum()
    return lambda at: np.full(at["y"].size, total)


PLANE = ("applied_rate", "temperature")
CASES: dict[str, dict[str, Callable[[Data], Predict]]] = {
    "spline, 24 intervals": {
        OURS: our_spline,
        "scipy make_lsq_spline norm-eq, sort": scipy_spline("norm-eq"),
        "scipy make_lsq_spline qr, sort": scipy_spline("qr"),
        "scipy LSQUnivariateSpline, unique": scipy_univariate,
        "limit: read T and y once": memory_pass,
    },
    "regression, 13 coefficients": {
        OURS: our_regression,
        "scipy gelsy, normalised columns in Fortran order": dense(FOUR, powers_of, gelsy),
        "scipy gelsy, normalised, C order, defaults": dense(FOUR, powers_of, gelsy_rows),
        "normal equations by hand, normalised": dense(FOUR, powers_of, normal_equations),
        "numpy lstsq, normalised": dense(FOUR, powers_of, numpy_lstsq),
        "statsmodels OLS qr, normalised": dense(FOUR, powers_of, statsmodels_qr),
    },
    "surface, 21 coefficients": {
        OURS: our_surface,
        "scipy gelsy, normalised columns in Fortran order": dense(PLANE, plane_of, gelsy),
        "scipy gelsy, normalised, C order, defaults": dense(PLANE, plane_of, gelsy_rows),
        "normal equations by hand, normalised": dense(PLANE, plane_of, normal_equations),
        "numpy lstsq, normalised": dense(PLANE, plane_of, numpy_lstsq),
    },
    "cubic in temperature": {
        OURS: lambda d: our_regression(d, ("temperature",)),
        "numpy polyfit": polyfit,
        "numpy Polynomial.fit": polynomial_fit,
    },
}


# --- reference


def reference(case: str, d: Data, at: Data) -> np.ndarray:
    """The least-squares fit at some rows: columns and sums in extended precision, solved with 50 digits."""
    import mpmath

    wide = extended_columns(case, d)
    p = len(wide)
    y = d["y"].astype(np.longdouble)
    gram = [[np.longdouble(0)] * p for _ in range(p)]
    right = [np.longdouble(0)] * p
    for start in range(0, y.size, 1 << 18):
        rows = [column[start : start + (1 << 18)] for column in wide]
        for i in range(p):
            right[i] += np.dot(rows[i], y[start : start + (1 << 18)])
            for j in range(i, p):
                if np.any(rows[i]) and np.any(rows[j]):
                    gram[i][j] += np.dot(rows[i], rows[j])
    with mpmath.workdps(50):

        def exact(value: np.longdouble) -> Any:
            head = float(value)
            return mpmath.mpf(head) + mpmath.mpf(float(value - np.longdouble(head)))

        matrix = mpmath.matrix(p)
        for i in range(p):
            for j in range(i, p):
                matrix[i, j] = matrix[j, i] = exact(gram[i][j])
        beta = mpmath.lu_solve(matrix, mpmath.matrix([exact(value) for value in right]))
        found = [float(value) for value in beta]
    columns = extended_columns(case, at, d)
    return np.sum([b * column for b, column in zip(found, columns, strict=True)], axis=0).astype(float)


def extended_columns(case: str, d: Data, whole: Data | None = None) -> list[np.ndarray]:
    """Chebyshev or B-spline columns in extended precision."""
    source = whole or d

    def wide(name: str, order: int) -> list[np.ndarray]:
        low, high = ends(source[name])
        x = d[name].astype(np.longdouble)
        x = (x - (np.longdouble(low) + high) / 2) / ((np.longdouble(high) - low) / 2)
        rows = [np.ones_like(x), x]
        while len(rows) <= order:
            rows.append(2 * x * rows[-1] - rows[-2])
        return rows

    if case.startswith("spline"):
        return splines(d["temperature"], clamped(source))
    if case.startswith("surface"):
        a, b = wide("applied_rate", 5), wide("temperature", 5)
        return [a[total - j] * b[j] for total in range(6) for j in range(total + 1)]
    names = FOUR if case.startswith("regression") else ("temperature",)
    return [wide(names[0], 0)[0], *(row for name in names for row in wide(name, 3)[1:])]


def splines(x: np.ndarray, knots: np.ndarray) -> list[np.ndarray]:
    """B-splines by the recursion of de Boor, in extended precision."""
    t, x = knots.astype(np.longdouble), x.astype(np.longdouble)
    interval = np.clip(np.searchsorted(knots, x, side="right") - 1, 3, knots.size - 5)
    rows: list[Any] = [(interval == i).astype(np.longdouble) for i in range(knots.size - 1)]
    for k in (1, 2, 3):
        new = []
        for i in range(len(rows) - 1):
            left, right = t[i + k] - t[i], t[i + k + 1] - t[i + 1]
            one = (x - t[i]) / left * rows[i] if left > 0 else 0.0
            two = (t[i + k + 1] - x) / right * rows[i + 1] if right > 0 else 0.0
            new.append(one + two)
        rows = new
    return rows


# --- measuring


def memory_mb(line: str) -> float:
    """A line of this process's memory: VmHWM is its peak, VmRSS what it holds now."""
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return next(float(row.split()[1]) for row in text.splitlines() if row.startswith(line)) * 1024 / 1e6


def forget_the_peak() -> float:
    """Let the peak begin anew; returns what is held now [MB]."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return memory_mb("VmRSS")


def worker(folder: Path, case: str, method: str) -> dict[str, Any]:
    """One method in this process; the data are read before, and are not counted."""
    d = {path.stem: np.load(path) for path in folder.glob("*.npy") if path.stem != "reference"}
    work = CASES[case][method]
    few = {name: column[:: max(1, column.size // 20_000)].copy() for name, column in d.items()}
    work(few)
    before, cpu, wall = forget_the_peak(), np.inf, np.inf
    for _ in range(2):
        begun = time.process_time(), time.perf_counter()
        predict = work(d)
        cpu, wall = min(cpu, time.process_time() - begun[0]), min(wall, time.perf_counter() - begun[1])
    peak = memory_mb("VmHWM") - before
    at = {name: column[:: max(1, column.size // 997)][:997].copy() for name, column in d.items()}
    path = folder / f"{list(CASES).index(case)}.ref"
    truth = np.fromfile(path) if path.exists() else np.full(at["y"].size, np.nan)
    error = float(np.max(np.abs(predict(at) - truth)) / np.max(np.abs(truth)))
    return {"cpu_s": cpu, "wall_s": wall, "peak_mb": peak, "error": error}


def after_the_pass(d: Data) -> dict[str, float]:
    """CPU [ms] of each question after the pass; no sample is read again."""
    from bench.fit.normal import held_out_rms, left_out, solve
    from bench.fit.smooth import Smoother, choose_intervals, solve_spline, spline_normal

    state = our_cells(d)
    cells, touched = state.sums, state.touched
    gram, four = our_gram(FOUR, d)

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


def write_file(path: Path, rows: int) -> None:
    """A record of so many samples, a row group at a time, as the bench writes its own."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ("time", "rate", *FOUR)
    schema = pa.schema([*(pa.field(name, pa.float64()) for name in names), pa.field("segment", pa.int16())])
    splits = dict.fromkeys(names, "BYTE_STREAM_SPLIT")
    with pq.ParquetWriter(path, schema, compression="zstd", column_encoding=splits, use_dictionary=["segment"]) as out:
        for first in range(0, rows, 1 << 19):
            part = data(min(1 << 19, rows - first), first=first, of=rows)
            part["rate"] = part.pop("y")
            columns = [pa.array(part[name]) for name in names]
            half = (part["time"] > rows / HZ / 2).astype(np.int16)
            out.write_table(pa.Table.from_arrays([*columns, pa.array(half)], schema=schema))


def sketch(path: Path, names: tuple[str, ...]) -> tuple[Data, np.ndarray]:
    """The first rows of every row group: which columns depend on each other, over the whole range.

    The bench itself takes its 1 s means for this; the start of a run alone would not do, it stands still.
    """
    import pyarrow.parquet as pq

    parts = []
    with pq.ParquetFile(path, pre_buffer=False) as source:
        for group in range(source.num_row_groups):
            parts.append(next(source.iter_batches(batch_size=64, row_groups=[group], columns=[*names, "rate"])))
    columns = {name: np.concatenate([part.column(name).to_numpy() for part in parts]) for name in (*names, "rate")}
    return columns, columns.pop("rate")


def file_worker(path: Path, case: str) -> dict[str, Any]:
    """A fit from a Parquet file: CPU and wall with the reading, peak above what the interpreter and imports take."""
    from bench.effects.base import Scale, Series
    from bench.fit.cells import Cells
    from bench.fit.gram import Gram, chebyshev_rows
    from bench.fit.normal import solve
    from bench.fit.samples import Samples
    from bench.fit.smooth import solve_spline
    from bench.fit.state import State

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
            state = State(Gram.of(names, 13, chebyshev_rows(series), *sketch(path, names)))
        state.add(batch.time, batch.columns, batch.y, batch.segment)
    total = state.table.sum(axis=0)
    if case.startswith("spline"):
        solve_spline(state.sums, total, INTERVALS)
    else:
        solve(state.sums.normal(total))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {"rows": samples.rows, "passes": state.touched / samples.rows, "cpu_s": cpu, "wall_s": wall,
            "peak_mb": memory_mb("VmHWM") - before, "file_mb": path.stat().st_size / 1e6}  # fmt: skip


def spawn(*arguments: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.one_pass", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"failed": done.stderr.strip().splitlines()[-1] if done.stderr.strip() else str(done.returncode)}
    return dict(json.loads(done.stdout))


def measure(rows: int, rounds: int, file_rows: int = 0) -> dict[str, Any]:
    """All cases: per method the least CPU and wall of the rounds, peak memory, error; then questions, then the file."""
    found: dict[str, Any] = {"rows": rows, "cases": {}, "files": {}}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        d = data(rows)
        for channel, column in d.items():
            np.save(folder / channel, column)
        at = {channel: column[:: max(1, rows // 997)][:997].copy() for channel, column in d.items()}
        for order, case in enumerate(CASES):
            reference(case, d, at).tofile(folder / f"{order}.ref")
        found["after_ms"] = after_the_pass(d)
        for case, methods in CASES.items():
            results: dict[str, list[dict[str, Any]]] = {method: [] for method in methods}
            for _ in range(rounds):
                for method in methods:
                    results[method].append(spawn("--worker", str(folder), case, method))
            found["cases"][case] = {method: _best(own) for method, own in results.items()}
        if file_rows:
            path = folder / "data.parquet"
            write_file(path, file_rows)
            for case in list(CASES)[:2]:
                found["files"][case] = spawn("--file-worker", str(path), case)
    return found


def _best(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    good = [one for one in rounds if "failed" not in one]
    if not good:
        return rounds[0]
    return {**{key: min(one[key] for one in good) for key in ("cpu_s", "wall_s")},
            "peak_mb": max(one["peak_mb"] for one in good), "error": good[0]["error"]}  # fmt: skip


def table(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    lines = [f"{found['rows']:,} samples; CPU of one thread, least of the rounds, a process per method.", ""]
    lines += ["| fit | method | CPU ms | wall ms | peak MB | relative error | CPU against ours |"]
    lines += ["|---|---|--:|--:|--:|--:|--:|"]
    for case, methods in found["cases"].items():
        ours = methods[OURS]["cpu_s"]
        for method, one in methods.items():
            if "failed" in one:
                lines.append(f"| {case} | {method} | failed: {one['failed'][:80]} | | | | |")
                continue
            error = "" if method.startswith("limit") else f"{one['error']:.0e}"
            lines.append(
                f"| {case} | {method} | {1e3 * one['cpu_s']:.1f} | {1e3 * one['wall_s']:.1f} | {one['peak_mb']:.0f} | "
                f"{error} | {one['cpu_s'] / ours:.1f} x |"
            )
    lines += ["", "| after the pass, no sample read again | CPU ms |", "|---|--:|"]
    lines += [f"| {name} | {ms:.2f} |" for name, ms in found["after_ms"].items()]
    if found["files"]:
        lines += ["", "| from a Parquet file | samples | passes | file MB | CPU s | wall s | peak MB above imports |"]
        lines += ["|---|--:|--:|--:|--:|--:|--:|"]
    for case, one in found["files"].items():
        if "failed" in one:
            lines.append(f"| {case} | failed: {one['failed'][:80]} |")
            continue
        lines.append(
            f"| {case} | {one['rows']:,} | {one['passes']:g} | {one['file_mb']:.0f} | {one['cpu_s']:.2f} | "
            f"{one['wall_s']:.2f} | {one['peak_mb']:.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=3_600_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--file-rows", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--worker", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--file-worker", nargs=2, help=argparse.SUPPRESS)
    wishes = parser.parse_args()
    if wishes.worker:
        print(json.dumps(worker(Path(wishes.worker[0]), *wishes.worker[1:])))
    elif wishes.file_worker:
        print(json.dumps(file_worker(Path(wishes.file_worker[0]), wishes.file_worker[1])))
    else:
        found = measure(wishes.rows, wishes.rounds, wishes.file_rows)
        print(json.dumps(found) if wishes.json else table(found))


if __name__ == "__main__":
    main()
