"""`bench fleet refit`: every stored unit fitted anew with a model."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench import analysis, archive
from bench.base import InputError, finite
from bench.commands.registering import open_in
from bench.commands.results.stock import Refitted

SMALL = 4
"""Groups up to which processes take longer to start than the work."""


@dataclass(frozen=True)
class RefitOptions:
    """Which runs count, and where to compute; `workers` None: one a processor."""

    selection: archive.Selection = field(default_factory=archive.Selection)

    engine: str = "auto"
    workers: int | None = None
    scheduler: str | None = None


def refit(
    model_name: str, root: Path, where: str | None, moments: Path | None, records: Path | None, options: RefitOptions
) -> Refitted:
    """Refit the moments of a file, by default those of the registry's runs, and write a record a unit."""
    model = analysis.load_model(model_name)
    analysis.check(model)
    refused: list[str] = []
    left_out: tuple[str, ...] = ()
    if moments is None:
        moments, refused, left_out = _collected(root, where, options)
    units = archive.stored_count(moments)
    target = records or moments.with_name(f"refit_{model.name.replace(' ', '_')}.parquet")
    name, engine = engine_of(options, -(-units // archive.GROUP))
    summary = _Summary()
    begun = time.perf_counter()
    count, failed = archive.write_records(
        target, model, summary.of(engine(archive.refits(model), archive.stored_groups(moments)))
    )
    took_s = time.perf_counter() - begun
    return Refitted(
        model=model.name,
        units=count,
        failed=failed,
        without_moments=refused,
        left_out=left_out,
        engine=name,
        seconds=took_s,
        units_per_s=count / took_s,
        rms_dph=summary.quantiles(),
        failures=summary.failures,
        weights={"by": "count", "reason": analysis.OF_SUMS},
        records=target,
    )


def _collected(root: Path, where: str | None, options: RefitOptions) -> tuple[Path, list[str], tuple[str, ...]]:
    if not archive.is_archive(root):
        raise InputError("no registered runs here; make the registry with `bench registry rebuild`", root)
    path = root / "moments.parquet"
    with open_in(root, where) as registry:
        done = archive.collect(
            registry, archive.archive(root), path, lambda groups: engine_of(options, groups)[1], options.selection
        )
    if not done.rows:
        raise InputError(
            f"no finished run has moments: {'; '.join([*done.refused[:1], *done.left_out]) or 'none is registered'}",
            root,
        )
    return path, done.refused, done.left_out


def engine_of(options: RefitOptions, groups: int) -> tuple[str, archive.Engine]:
    """Name and engine for so many groups."""
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers is {options.workers}, at least 1 is needed")
    workers = options.workers or os.cpu_count() or 1
    name = options.engine
    if name == "auto":
        name = "dask" if options.scheduler else "serial" if groups <= SMALL else "pool"
    if options.scheduler and name != "dask":
        raise InputError(f"--scheduler is for --engine dask, not {name}")
    if name == "dask":
        return f"dask, {options.scheduler or f'{workers} workers'}", archive.dask_engine(workers, options.scheduler)
    if name == "serial" or workers == 1:
        return "serial", archive.local_engine(1)
    return f"pool, {workers} workers", archive.local_engine(workers)


class _Summary:
    """Figures of all records, gathered as they pass."""

    def __init__(self) -> None:
        self._rms: list[float] = []
        self.failures: list[str] = []

    def of(self, records: Iterator[list[archive.Record]]) -> Iterator[list[archive.Record]]:
        for some in records:
            self._rms += [record.rms_dph for record in some if record.rms_dph is not None]
            wrong = (f"{record.unit}: {record.error}" for record in some if record.error is not None)
            self.failures += list(wrong)[: 10 - len(self.failures)]
            yield some

    def quantiles(self) -> dict[str, float | None]:
        if not self._rms:
            return {"median": None, "p95": None, "highest": None}
        values = np.quantile(self._rms, (0.5, 0.95, 1.0))
        return {key: finite(value) for key, value in zip(("median", "p95", "highest"), values, strict=True)}
