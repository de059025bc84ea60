"""Speed of the generated C code: `python -m benchmarks.embedded` prints a table for docs and closing notes.

Time per sample: least of the rounds over a wandering record, gcc -O2. Worst: the greatest single call in 200,000 (with
the clock's own cost; on a shared machine it shows mainly the machine) and its 99.9th percentile. Instructions per
sample by callgrind, if it is installed: least and greatest over kinds of input, which shows how constant they are.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.base.channels import IntArray
from bench.deliver.export.ccode import c_files, inputs_of
from bench.deliver.export.delivery import INPUTS, NO_VALUE, ONE, Block, Delivery, Kind, Shape
from bench.deliver.export.forms import FORMS
from bench.deliver.export.image import read, words_of
from bench.deliver.export.measure import wander, worst_errors
from bench.deliver.export.signals import channel_signal, lag_signal, play_signal

BUDGET_NS = 1e6
"""The second paper's 1 ms for a lookup at 1 kHz."""

_MAIN = r"""
#define _POSIX_C_SOURCE 200112L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "calibration.h"
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return 1e9 * t.tv_sec + t.tv_nsec; }
static int order(const void *a, const void *b) { return (*(const double *)a > *(const double *)b) ? 1 : -1; }
int main(int argc, char **argv)
{
    const int rows = atoi(argv[2]), rounds = atoi(argv[3]);
    calibration_input_t *in = malloc(sizeof(*in) * (size_t)rows);
    double *calls = malloc(sizeof(double) * (size_t)rows), best = 1e30, begin;
    calibration_output_t out = 0, sum = 0;
    calibration_state_t state;
    FILE *file = fopen(argv[1], "rb");
    (void)argc;
    if (file == NULL || fread(in, sizeof(*in), (size_t)rows, file) != (size_t)rows) { return 1; }
    calibration_reset(&state);
    for (int round = 0; round < rounds; round++) {
        begin = now();
        for (int row = 0; row < rows; row++) { calibration_step(&state, &in[row], &out); sum += out; }
        begin = (now() - begin) / rows;
        if (begin < best) { best = begin; }
    }
    for (int row = 0; row < rows; row++) {
        begin = now();
        calibration_step(&state, &in[row], &out);
        calls[row] = now() - begin;
        sum += out;
    }
    qsort(calls, (size_t)rows, sizeof(double), order);
    printf("%.3f %.0f %.0f %d\n", best, calls[(int)(0.999 * rows)], calls[rows - 1], (int)(sum != 0));
    return 0;
}
"""


@dataclass(frozen=True)
class Timed:
    """One model in one form: ns per sample, of single calls, and instructions (least, greatest; None: no callgrind)."""

    model: str
    form: str
    worst_dph: float
    mean_ns: float
    p999_ns: float
    most_ns: float
    instructions: tuple[float, float] | None


def models() -> Mapping[str, Delivery]:
    """The papers' models and the usual result of a diagnosis, with random coefficients of typical size."""
    rng = np.random.default_rng(7)
    rate = channel_signal("rate", -300.0 * 3600, 300.0 * 3600)
    celsius = channel_signal("temperature", -55.0, 125.0)
    lag = lag_signal(0, (-55.0, 125.0), (-55.0, 125.0), 60.0, 0.002)
    surface = Block(Shape.SURFACE, 0, 1, 5, rng.normal(size=21) * 0.05)
    spline = rng.normal(size=96) * 1e-4
    loop = Block(Shape.SERIES, 2, 0, 1, np.array([0.0, 1e-4]))
    return {
        "surface, 21 coefficients": Delivery("surface", (rate, celsius), (surface,)),
        "spline, 24 pieces": Delivery("spline", (celsius,), (Block(Shape.SPLINE, 0, 0, 24, spline),)),
        "spline 24, lag, loop": Delivery(
            "composed", (celsius, lag, play_signal(1, 0.1)), (Block(Shape.SPLINE, 1, 0, 24, spline), loop),
            period_ns=2_000_000,
        ),
    }  # fmt: skip


def timed(name: str, delivery: Delivery, form: str, rows: int = 200_000, rounds: int = 15) -> Timed:
    """Compile, run and count instructions."""
    words = words_of(delivery, form, 1, 1)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for file, text in c_files(read(words), words).items():
            (folder / file).write_text(text)
        (folder / "main.c").write_text(_MAIN)
        program = folder / "main"
        sources = [str(folder / "main.c"), str(folder / "calibration.c")]
        subprocess.run(["gcc", "-std=c99", "-O2", "-g", "-o", str(program), *sources], check=True)
        samples = wander(delivery, rows)
        _store(folder / "in", delivery, words, samples)
        output = subprocess.run(
            [str(program), str(folder / "in"), str(rows), str(rounds)], check=True, capture_output=True, text=True
        ).stdout.split()
        counted = _instructions(folder, program, delivery, words) if shutil.which("valgrind") else None
    worst = worst_errors(delivery, [form])[0].worst
    return Timed(name, form, worst, float(output[0]), float(output[1]), float(output[2]), counted)


def _store(path: Path, delivery: Delivery, words: list[int], counts: Mapping[int, IntArray]) -> int:
    columns = [counts[INPUTS[name].id] for name in inputs_of(read(words))]
    path.write_bytes(np.ascontiguousarray(np.column_stack(columns).astype("<i4")).tobytes())
    return len(columns[0])


def _instructions(folder: Path, program: Path, delivery: Delivery, words: list[int]) -> tuple[float, float]:
    """Least and greatest instructions of one sample over kinds of input, each held for 400 samples."""
    boxes = {s.source: s for s in delivery.signals if s.kind is Kind.CHANNEL}
    kinds = {
        "low": lambda s: s.low, "high": lambda s: s.high, "middle": lambda s: s.centre,
        "below": lambda s: s.low - ONE // 8, "above": lambda s: s.high + ONE // 8, "none": lambda s: NO_VALUE,
    }  # fmt: skip
    found = []
    for pick in kinds.values():
        counts = {id_: np.full(400, pick(signal), dtype=np.int64) for id_, signal in boxes.items()}
        counts.setdefault(0, np.full(400, 1_000_000, dtype=np.int64))
        rows = _store(folder / "kind", delivery, words, counts)
        command = [
            "valgrind",
            "--tool=callgrind",
            "--toggle-collect=calibration_step",
            "--callgrind-out-file=/dev/null",
        ]
        done = subprocess.run(
            [*command, str(program), str(folder / "kind"), str(rows), "1"], check=True, capture_output=True, text=True
        )
        collected = re.search(r"Collected : (\d+)", done.stderr)
        found.append(int(collected[1]) / (2 * rows) if collected else np.nan)
    return float(min(found)), float(max(found))


def main() -> None:
    """Print the table."""
    print("| model | form | error [deg/h] | mean [ns] | 99.9 % [ns] | worst call [ns] | share of 1 ms | instructions |")
    print("|---|---|---|---|---|---|---|---|")
    for name, delivery in models().items():
        for form in FORMS:
            t = timed(name, delivery, form)
            counted = "-" if t.instructions is None else f"{t.instructions[0]:.0f} to {t.instructions[1]:.0f}"
            print(
                f"| {name} | {form} | {t.worst_dph:.2g} | {t.mean_ns:.1f} | {t.p999_ns:.0f} | {t.most_ns:.0f} "
                f"| {t.mean_ns / BUDGET_NS:.1e} | {counted} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
