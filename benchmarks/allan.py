"""Allan deviation of two hours at 500 Hz: beside allantools.oadev at the same averaging times.

    python -m benchmarks.allan [--quick]

A process per method, alternating; CPU time of one thread; the error is the largest relative difference from allantools.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis.noise.allan import AllanCurve, allan_deviation
from bench.base.channels import FloatArray
from benchmarks.rounds import Case, Method, Table, compared, measured

_HZ = 500.0
_ROWS = 3_600_000
_FEW = 20_000
_KEPT = "rate.npy"


def _write(folder: Path, rows: int) -> None:
    """White noise and a random walk, the averaging times of the bench, and the results of allantools for these."""
    rng = np.random.default_rng(1)
    rate = 2.0 + rng.standard_normal(rows) + 1e-3 * np.cumsum(rng.standard_normal(rows))
    np.save(folder / _KEPT, rate)
    curve = allan_deviation(rate, 1.0 / _HZ)
    np.save(folder / "taus.npy", curve.tau_s)
    np.save(folder / "reference.npy", _theirs((rate, curve.tau_s)))


def _load(folder: Path) -> tuple[FloatArray, FloatArray]:
    return np.load(folder / _KEPT), np.load(folder / "taus.npy")


def _few(given: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    rate, taus_s = given
    return rate[:_FEW], taus_s[taus_s < _FEW / 3.0 / _HZ]


def _theirs(given: tuple[FloatArray, FloatArray]) -> FloatArray:
    import allantools

    return np.asarray(allantools.oadev(given[0], rate=_HZ, data_type="freq", taus=given[1])[1])


def _ours(given: tuple[FloatArray, FloatArray]) -> AllanCurve:
    return allan_deviation(given[0], 1.0 / _HZ, given[1])


def _error(answer: Any, given: tuple[FloatArray, FloatArray], folder: Path) -> float:
    """Largest relative difference from allantools over all averaging times."""
    found = answer.deviation_dph if isinstance(answer, AllanCurve) else answer
    return float(np.max(np.abs(found / np.load(folder / "reference.npy") - 1.0)))


_THEIRS = Method(_theirs, needs=("allantools",))
_ONE_PASS = Method(lambda given: float(given[0].sum()), limit=True)
CASES = {
    "Allan deviation": Case(
        _load, _few, {"bench": Method(_ours), "allantools.oadev": _THEIRS, "one pass over memory": _ONE_PASS}, _error
    )
}


def tables(quick: bool) -> list[Table]:
    """The table of docs/performance.md."""
    rows = 360_000 if quick else _ROWS
    with tempfile.TemporaryDirectory() as folder:
        _write(Path(folder), rows)
        times = len(np.load(Path(folder) / "taus.npy"))
        found = measured("benchmarks.allan", Path(folder), CASES, rounds=1 if quick else 3)
    reading = (
        f"{rows / 1e6:g} million samples, the same {times} averaging times for all; the error is against allantools."
    )
    return [compared("Allan deviation", reading, found)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples, one round")
    for table in tables(parser.parse_args().quick):
        print(table.markdown())


if __name__ == "__main__":
    main()
