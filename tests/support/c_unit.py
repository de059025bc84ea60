"""The generated C code, compiled as strictly as gcc can and run on arrays of counts."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np

from bench.deliver.export.ccode import c_files, inputs_of
from bench.deliver.export.image import read

FLAGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wdouble-promotion", "-Wfloat-equal")
FLAGS += ("-Wshadow", "-Wundef", "-Wstrict-prototypes", "-Wcast-qual", "-Wsign-conversion", "-O2")
TYPES = {"float32": np.float32, "fixed": np.int32, "split": np.int64, "split_fixed": np.int64}

HARNESS = """
#include "calibration.h"
void run(int32_t rows, const int32_t *counts, calibration_output_t *out, uint32_t *flags, int32_t settled);
void run(int32_t rows, const int32_t *counts, calibration_output_t *out, uint32_t *flags, int32_t settled)
{
    calibration_state_t state;
    int32_t row;
    calibration_reset(&state);
    for (row = 0; row < rows; row++)
    {
        calibration_input_t input;
%s
        if (settled != 0) { calibration_reset(&state); }
        flags[row] = calibration_step(&state, &input, &out[row]);
    }
}
"""


def compiled(folder: Path, words: list[int], extra: tuple[str, ...] = ()) -> Path:
    """Shared library of the code of an image."""
    image = read(words)
    for name, text in c_files(image, words).items():
        (folder / name).write_text(text)
    names = inputs_of(image)
    reads = "\n".join(f"        input.{name} = counts[(row * {len(names)}) + {i}];" for i, name in enumerate(names))
    (folder / "harness.c").write_text(HARNESS % reads)
    made = folder / "calibration.so"
    command = ["gcc", *FLAGS, *extra, "-shared", "-fPIC", "-o", str(made)]
    done = subprocess.run(
        [*command, str(folder / "calibration.c"), str(folder / "harness.c")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return made


def run(library: Path, words: list[int], counts: dict[int, np.ndarray], *, settled: bool = False):
    """Raw outputs and flags (n,) of the compiled code."""
    from bench.deliver.export.delivery import INPUTS

    image = read(words)
    own = np.column_stack([counts[INPUTS[name].id] for name in inputs_of(image)]).astype(np.int32)
    own = np.ascontiguousarray(own)
    out, flags = np.zeros(len(own), dtype=TYPES[image.form]), np.zeros(len(own), dtype=np.uint32)
    pointer = ctypes.c_void_p
    code = ctypes.CDLL(str(library))
    code.run(
        ctypes.c_int32(len(own)), pointer(own.ctypes.data), pointer(out.ctypes.data), pointer(flags.ctypes.data),
        ctypes.c_int32(settled),
    )  # fmt: skip
    return out, flags
