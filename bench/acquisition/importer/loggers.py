"""Files of data loggers and spreadsheets: XLSX, TDMS, ULog and HDF5, each by the library that is kept for it."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from bench.acquisition.importer.table import Series, Table, on_one_time_base, refuse_large
from bench.acquisition.importer.text import table_of_text
from bench.base import InputError


def read_log(path: Path, most_bytes: int) -> Table:
    """Table of a file with one of the endings of `READERS`; InputError where it cannot be read, or no library can."""
    library, reader = READERS[path.suffix.lower()]
    try:
        return reader(path, most_bytes)
    except ModuleNotFoundError:
        text = f"{path.suffix} needs {library}: pip install 'gyro-thermal-bench[logs]'"
        raise InputError(text, path) from None
    except InputError:
        raise
    except Exception as error:  # each library raises whatever its parser trips over
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise InputError(f"not a readable {path.suffix} file ({said}); copy or export it again", path) from None


def _read_xlsx(path: Path, most_bytes: int) -> Table:
    """The first sheet, read as the same table in text would be: merged heads, a row of units, numbers in text."""
    import openpyxl

    with closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
        sheet = book.worksheets[0]
        refuse_large(sheet.max_row or 0, sheet.max_column or 0, most_bytes, path)
        rows = [["" if cell.data_type == "e" else _as_text(cell.value) for cell in row] for row in sheet.iter_rows()]
    used = [at for at, column in enumerate(zip_longest(*rows, fillvalue="")) if any(text != "" for text in column)]
    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    for row in rows:
        shown = [row[at] if at < len(row) else "" for at in used]
        writer.writerow(shown if any(text != "" for text in shown) else [])
    try:
        return table_of_text(text.getvalue().encode(), path)
    except InputError as error:
        raise InputError(f"{error}; it is the first sheet that is read, '{sheet.title}'") from None


def _as_text(value: object) -> object:
    """What stands in a cell, with all digits; durations in seconds, yes and no as 1 and 0."""
    if value is None or isinstance(value, bool):
        return "" if value is None else int(value)
    if isinstance(value, timedelta):
        return value.total_seconds()
    return value.isoformat(" ") if isinstance(value, datetime) else value


def _read_tdms(path: Path, most_bytes: int) -> Table:
    """Every numeric channel, at the times that its waveform or its group's time channel states."""
    import nptdms

    zeros: set[Any] = set()

    def signals() -> Iterator[tuple[str, Series, str]]:
        with nptdms.TdmsFile.open(path) as file:
            for group in file.groups():
                clock = next((c for c in group.channels() if np.issubdtype(c.dtype, np.datetime64)), None)
                for channel in group.channels():
                    if channel.dtype.kind not in "iufb" or not len(channel):
                        continue
                    unit = str(channel.properties.get("unit_string", ""))
                    if "wf_increment" in channel.properties:
                        times = channel.time_track()
                        zeros.add(channel.properties.get("wf_start_time"))
                    elif clock is not None:
                        stamps = clock[:]
                        zeros.add(stamps[0])
                        times = (stamps - stamps[0]) / np.timedelta64(1, "s")
                    else:
                        times = np.arange(len(channel), dtype=np.float64)
                        zeros.add(None)
                    yield f"{group.name}.{channel.name}", (np.asarray(times, np.float64), channel[:]), unit

    return _joined(path, signals(), most_bytes, zeros)


def _read_ulog(path: Path, most_bytes: int) -> Table:
    """Every field of every topic, at the time stamps of its topic."""
    import pyulog

    def signals() -> Iterator[tuple[str, Series, str]]:
        with path.open("rb") as file:
            topics = pyulog.ULog(file).data_list
        for topic in topics:
            times = topic.data["timestamp"] * 1e-6
            for field, values in topic.data.items():
                if field != "timestamp" and values.dtype.kind in "iufb":
                    number = f"_{topic.multi_id}" if topic.multi_id else ""
                    yield f"{topic.name}{number}.{field}", (times, values), ""

    return _joined(path, signals(), most_bytes)


def _read_hdf5(path: Path, most_bytes: int) -> Table:
    """Every one-dimensional set of numbers of the length that most of them have, and its attribute `unit`."""
    import h5py

    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim == 1 and item.dtype.kind in "iufb":
            found[name.replace("/", ".")] = item

    with h5py.File(path) as file:
        file.visititems(visit)
        if not found:
            raise InputError("holds no one-dimensional sets of numbers", path)
        sizes = [item.size for item in found.values()]
        rows = max(set(sizes), key=lambda size: (sizes.count(size), size))
        kept = {name: item for name, item in found.items() if item.size == rows}
        refuse_large(rows, len(kept), most_bytes, path)
        units = {n: str(item.attrs[key]) for n, item in kept.items() for key in ("unit", "units") if key in item.attrs}
        others = tuple(f"'{n}' has {i.size} values and the others {rows}; it is left out"
                       for n, i in found.items() if n not in kept)  # fmt: skip
        return Table(path, {n: item[:].astype(np.float64) for n, item in kept.items()}, units, notes=others)


def _joined(
    path: Path, signals: Iterator[tuple[str, Series, str]], most_bytes: int, zeros: Collection[Any] = ()
) -> Table:
    """All `signals` in one table; `zeros`: the moments, UTC, from which their times count, None where there is none."""
    series, units = {}, {}
    for name, (times, values), unit in signals:
        series[name] = (times, np.asarray(values, np.float64))
        if unit:
            units[name] = unit
    if not series:
        raise InputError("holds no channels of numbers", path)
    (zero,) = zeros if len(zeros) == 1 else (None,)
    begin = zero if zero is None else np.datetime64(zero, "us").item().replace(tzinfo=UTC)
    return on_one_time_base(path, series, units, most_bytes, begin)


READERS: dict[str, tuple[str, Callable[[Path, int], Table]]] = {
    ".xlsx": ("openpyxl", _read_xlsx), ".tdms": ("npTDMS", _read_tdms), ".ulg": ("pyulog", _read_ulog),
    ".h5": ("h5py", _read_hdf5), ".hdf5": ("h5py", _read_hdf5),
}  # fmt: skip
"""By ending: the library, and what reads it."""
