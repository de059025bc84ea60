"""The outputs of a unit apart: of each rate a run folder of its own, in which it is `rate` and all else is as it was.

What looks at one output (report, limits, export, certificate, page) then needs to know of none other. The folder of
rate_y of a run stands beside it, as `<run>_rate_y`; the raw journals stay in the run.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pyarrow as pa
import pyarrow.parquet as pq

from bench.base import OUTPUTS, RATES, InputError
from bench.record.chain import use
from bench.record.events import EVENTS
from bench.record.files import copy_whole, staged
from bench.record.folder import RunFolder
from bench.record.means import write_means
from bench.record.samples import CODE, SampleFile, channel_of, samples_writer

_TEXTS = ("*.yaml", EVENTS)


def rates_of(run: RunFolder) -> tuple[str, ...]:
    """Names of the rates that a finished run recorded: `rate`, or rate_x, rate_y …; InputError as `SampleFile`."""
    use(run.path, run.data.name)
    with SampleFile(run.data) as samples:
        return tuple(name for name in RATES if name in samples.names)


def apart(run: RunFolder) -> list[RunFolder]:
    """The run of each rate of a unit; the run itself where the unit has one output.

    Folders that were made before are taken as they are. InputError where the run cannot be read, OSError.
    """
    if not run.data.is_file():
        return [run]
    rates = rates_of(run)
    return [run] if rates == ("rate",) or not rates else [_of(run, rate) for rate in rates]


def of_output(run: RunFolder, output: str) -> RunFolder:
    """The run of one rate of a unit; InputError that lists them where it has no such."""
    rates = rates_of(run)
    if output not in rates:
        raise InputError(f"'{output}' is not a rate of this unit; choose one of {', '.join(rates)}", run.path)
    return run if output == "rate" else _of(run, output)


def _of(run: RunFolder, rate: str) -> RunFolder:
    manifest = run.manifest()
    source = {"run": run.path.name, "output": rate, "sha256": manifest.files.get(run.data.name)}
    made = RunFolder(run.path.with_name(f"{run.path.name}_{rate}"))
    with contextlib.suppress(InputError):  # none yet, or one that must be made again
        if made.manifest().source == source:
            return made
    if made.path.exists():
        raise InputError(f"was made from other data than {run.path.name} has now; move it away", made.path)
    with staged(run.path.parent) as place:
        new = RunFolder(place / made.path.name)
        new.path.mkdir()
        for file in (file for pattern in _TEXTS for file in run.path.glob(pattern)):
            copy_whole(file, new.path / file.name)
        _write_data(run, rate, new)
        write_means(new.data, new.means)
        changes = {"run": made.path.name, "source": source, "files": new.hashes()}
        manifest.model_copy(update=changes).write(new.path)
        new.path.rename(made.path)
    return made


def _kept(schema: pa.Schema, rate: str) -> Iterator[tuple[pa.Field, pa.Field]]:
    """Columns of the run, each with what it becomes."""
    for field in schema:
        name = channel_of(field)
        if name == rate:
            said = {**(field.metadata or {}), b"channel": b"rate"}
            yield (
                field,
                (
                    field.with_name("rate" + CODE).with_metadata(said)
                    if field.name.endswith(CODE)
                    else field.with_name("rate")
                ),
            )
        elif name not in OUTPUTS:
            yield field, field


def _write_data(run: RunFolder, rate: str, new: RunFolder) -> None:
    """The samples with one rate, a row group at a time: in constant memory."""
    with pq.ParquetFile(run.data, page_checksum_verification=True) as source:
        kept = list(_kept(source.schema_arrow, rate))
        names, schema = [old.name for old, _ in kept], pa.schema([field for _, field in kept])
        with samples_writer(new.data, schema) as writer:
            for group in range(source.num_row_groups):
                table = source.read_row_group(group, columns=names).select(names)
                writer.write_table(pa.Table.from_arrays(table.columns, schema=schema))
