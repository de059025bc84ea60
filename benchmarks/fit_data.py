"""Samples for the fits of `benchmarks.one_pass`, as arrays and as a file, and a fit in high precision."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HZ, INTERVALS, CELLS = 500.0, 24, 96
RATE = 6e6
"""Range of the raw rate, a 24-bit count."""
FOUR = ("temperature", "frequency", "drive", "quadrature")
Data = dict[str, np.ndarray]
Predict = Callable[[Data], np.ndarray]


def data(rows: int, seed: int = 0, first: int = 0, of: int = 0) -> Data:
    """Samples of -40 .. 85 degC and back; `first` and `of` for a part of a longer record."""
    random = np.random.default_rng((seed, first))
    whole = of or rows
    t = (first + np.arange(rows)) / HZ
    phase = 2 * np.pi * t / (whole / HZ)
    temperature = 22.5 - 62.5 * np.cos(phase) + random.normal(0.0, 0.003, rows)
    y = truth({"temperature": temperature}) + random.normal(0.0, 1.0, rows)
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


def truth(d: Data) -> np.ndarray:
    """The noise-free curve of the samples."""
    return 12.0 + 3.0 * np.sin(d["temperature"] / 20.0) + 0.02 * d["temperature"]


def clamped(d: Data) -> np.ndarray:
    low, high = ends(d["temperature"])
    return np.r_[[low] * 3, np.linspace(low, high, INTERVALS + 1), [high] * 3]


def write_file(path: Path, rows: int) -> None:
    """Write a record of samples, one row group at a time, as the bench does."""
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

    The bench uses its 1 s means for this; the start of a run is not sufficient, because its temperature is constant.
    """
    import pyarrow.parquet as pq

    parts = []
    with pq.ParquetFile(path, pre_buffer=False) as source:
        for group in range(source.num_row_groups):
            parts.append(next(source.iter_batches(batch_size=64, row_groups=[group], columns=[*names, "rate"])))
    columns = {name: np.concatenate([part.column(name).to_numpy() for part in parts]) for name in (*names, "rate")}
    return columns, columns.pop("rate")


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
