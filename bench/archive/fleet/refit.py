"""Refit of a whole fleet from its moments. A unit gets the same answer on every computer and at every repetition."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.analysis import Model, Moments, one_blas_thread, solve_moments
from bench.archive.fleet.engines import Work
from bench.archive.fleet.moments_file import Group
from bench.base import BenchError, FloatArray, InputError

SCHEMA = pa.schema(
    [
        pa.field("unit", pa.string()),
        pa.field("run", pa.string()),
        pa.field("error", pa.string()),
        pa.field("rms_dph", pa.float64()),
        pa.field("condition", pa.float64()),
        pa.field("rows", pa.int64()),
        pa.field("ranges", pa.list_(pa.float64())),
        pa.field("beta", pa.list_(pa.float64())),
    ]
)


@dataclass(frozen=True)
class Record:
    """The refit of one unit, or why there is none.

    `beta` holds the constant and the scaled amplitudes [deg/h]; `ranges` holds low and high of each channel that the
    model needs, one after the other, which are its scales and its validity.
    """

    unit: str
    run: str
    error: str | None = None
    rms_dph: float | None = None
    condition: float | None = None
    rows: int | None = None
    ranges: tuple[float, ...] = ()
    beta: tuple[float, ...] = ()


def refit_unit(model: Model, unit: str, run: str, values: FloatArray) -> Record:
    """Fit the model to the packed moments of one unit; any error ends in its record and stops nothing."""
    try:
        with np.errstate(all="ignore"):  # not finite numbers become an error of their unit below
            solved = solve_moments(model, Moments.unpack(values))
        numbers = (solved.rms_dph, solved.condition, *solved.beta.tolist())
        if not np.all(np.isfinite(numbers)):
            raise InputError("the solution is not finite: the moments are damaged")
    except BenchError as error:
        return Record(unit, run, str(error))
    except Exception as bug:
        return Record(unit, run, f"internal error: {type(bug).__name__}: {bug}")
    ranges = tuple(end for bounds in solved.validity.values() for end in bounds)
    return Record(unit, run, None, solved.rms_dph, solved.condition, solved.rows, ranges, tuple(solved.beta.tolist()))


def refit_group(model: Model, group: Group) -> list[Record]:
    """Records of a group, in its order; BLAS uses one thread, so that the load cannot change the digits."""
    with one_blas_thread():
        return [refit_unit(model, *each) for each in zip(group.units, group.runs, group.values, strict=True)]


def refits(model: Model) -> Work[Group, Record]:
    """The work of an engine: each unit of a group refitted."""
    return Work(partial(refit_group, model), _lost)


def _lost(group: Group, why: str) -> list[Record]:
    return [Record(unit, run, f"not refitted: {why}") for unit, run in zip(group.units, group.runs, strict=True)]


def write_records(path: Path, model: Model, records: Iterable[list[Record]]) -> tuple[int, int]:
    """Write records as they come and replace the file at the end; returns their number and that of the failures."""
    partial = path.with_name(f".{path.name}.part")
    count = failed = 0
    try:
        with pq.ParquetWriter(partial, SCHEMA.with_metadata({"model": model.to_yaml()}), compression="zstd") as writer:
            for some in records:
                writer.write_table(pa.Table.from_pylist([asdict(record) for record in some], schema=writer.schema))
                count += len(some)
                failed += sum(record.error is not None for record in some)
        partial.replace(path)
    except OSError as error:
        raise InputError(f"records cannot be written: {error.strerror or error}", path) from None
    finally:
        partial.unlink(missing_ok=True)
    return count, failed
