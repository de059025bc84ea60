"""Tables that somebody else recorded, as columns of numbers: text, Parquet, MF4, logs, and CAN logs with their DBC.

A gap stays NaN. What cannot be read exactly is refused with file and line; nothing is guessed, dropped or filled.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.acquisition.importer.confines import memory_for
from bench.acquisition.importer.loggers import READERS, read_log
from bench.acquisition.importer.table import EPOCH, Series, Table, of_arrow, on_one_time_base, refuse_large
from bench.acquisition.importer.text import read_text_table
from bench.base import InputError
from drivers.errors import ConfigError
from drivers.wire import Message, read_layouts

CAN_LOGS = (".blf", ".asc", ".log", ".trc")
_SHOWN = 8
"""Identifiers in a message."""


def read_table(
    path: Path | str, dbc: Path | str | None = None, most_bytes: int | None = None, encoding: str | None = None
) -> Table:
    """Read a table by its file's ending; `dbc` describes the frames of a CAN log. InputError when it cannot be read.

    What announces that it needs more than `most_bytes` of memory is refused; None: more than is free for it.
    `encoding` is that of a text; None: as it shows.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            "no such file" if not path.exists() else "is a folder; name a file in it: each is a run of its own", path
        )
    size = path.stat().st_size
    if size == 0:
        raise InputError("is empty", path)
    most_bytes = memory_for(size) if most_bytes is None else most_bytes
    ending = path.suffix.lower()
    if ending in CAN_LOGS:
        return _read_can_log(path, dbc, most_bytes)
    if ending == ".parquet":
        table = _read_parquet(path, most_bytes)
    elif ending in READERS:
        table = read_log(path, most_bytes)
    else:
        mf4 = ending in {".mf4", ".mdf"}
        table = _read_mf4(path, most_bytes) if mf4 else read_text_table(path, most_bytes, encoding)
    if table.rows == 0:
        raise InputError("holds zero rows: there is a header, and no data", path)
    return table


def _read_parquet(path: Path, most_bytes: int) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            known = file.metadata
            refuse_large(known.num_rows, known.num_columns, most_bytes, path)
            names = file.schema_arrow.names
            parts = [of_arrow(file.read(columns=[name]), path) for name in dict.fromkeys(names)]
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(
            f"not a readable Parquet file ({' '.join(str(error).split())}); copy or export it again", path
        ) from None
    columns = {name: column for part in parts for name, column in part.columns.items()}
    units = {name: unit for part in parts for name, unit in part.units.items()}
    notes = tuple(note for part in parts for note in part.notes)
    return Table(
        path, columns, units, notes=notes, unread={n: reason for part in parts for n, reason in part.unread.items()}
    )


def _read_mf4(path: Path, most_bytes: int) -> Table:
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError("MF4 needs asammdf: pip install 'gyro-thermal-bench[mf4]'", path) from None
    signals: dict[str, Series] = {}
    units: dict[str, str] = {}
    try:
        with MDF(path) as file:
            zero = file.start_time
            values, rows = 0, 0
            for group in file.groups:
                values += int(group.channel_group.cycles_nr) * len(group.channels)
                rows = max(rows, int(group.channel_group.cycles_nr))
            refuse_large(rows, -(-values // max(rows, 1)), most_bytes, path)
            for signal in file.iter_channels(skip_master=True):
                if signal.samples.ndim == 1 and signal.samples.dtype.kind in "iufb":
                    name = _free_name(signal.name, signals)
                    times = signal.timestamps.astype(np.float64, copy=False)
                    signals[name] = (times, signal.samples.astype(np.float64))
                    units[name] = str(signal.unit or "")
    except InputError:
        raise
    except Exception as error:  # asammdf raises whatever its parser trips over
        raise InputError(
            f"not a readable MF4 file ({type(error).__name__}: {error}); copy or export it again", path
        ) from None
    return on_one_time_base(path, signals, {name: unit for name, unit in units.items() if unit}, most_bytes, zero)


def _free_name(name: str, taken: Mapping[str, Series]) -> str:
    suffixes = ("", *(f"_{n}" for n in range(2, 1000)))
    return next(f"{name}{suffix}" for suffix in suffixes if f"{name}{suffix}" not in taken)


def _read_can_log(path: Path, dbc: Path | str | None, most_bytes: int) -> Table:
    if dbc is None:
        raise InputError("a CAN log needs the description of its frames; name it with --dbc", path)
    messages = _messages(dbc)
    frames, others, notes = _frames(path, messages)
    if not frames:
        heard = ", ".join(f"0x{number:X} ({count})" for number, count in others.most_common(_SHOWN))
        raise InputError(f"none of its frames is described by {dbc}; it has {heard or 'no frames'}", path)
    signals: dict[str, Series] = {}
    units: dict[str, str] = {}
    for head, (stamps, payloads) in frames.items():
        message = messages[head]
        width = message.width
        whole = b"".join(payload[:width].ljust(width, b"\0") for payload in payloads)
        columns = message.decode(np.frombuffer(whole, dtype=np.uint8).reshape(-1, width))
        for signal, (column, rows) in columns.items():
            name = _free_name(signal, signals)
            at = np.array(stamps) if rows is None else np.array(stamps)[rows]
            if len(at):  # a multiplexed signal is not in every frame, and may be in none
                signals[name] = at, column
                units[name] = message.signals[signal].unit
    table = on_one_time_base(path, signals, {name: unit for name, unit in units.items() if unit}, most_bytes, EPOCH)
    if others:
        notes.append(f"{others.total()} frames are not described by the DBC and are left out")
    return replace(table, notes=(*table.notes, *notes))


_Head = tuple[int, bool]
"""Identifier of a frame, and whether it is of 29 bits."""


def _frames(
    path: Path, messages: Mapping[_Head, Message]
) -> tuple[dict[_Head, tuple[list[float], list[bytes]]], Counter[int], list[str]]:
    """Times and payloads of the messages, how often other identifiers stand in the log, and what is to be said."""
    import can

    found: dict[_Head, tuple[list[float], list[bytes]]] = {}
    others: Counter[int] = Counter()
    try:
        with can.LogReader(str(path)) as log:
            for frame in log:
                head = frame.arbitration_id, frame.is_extended_id
                message = messages.get(head)
                if message is None or frame.is_error_frame or len(frame.data) < message.length:
                    others[frame.arbitration_id] += 1
                    continue
                stamps, payloads = found.setdefault(head, ([], []))
                stamps.append(frame.timestamp)
                payloads.append(bytes(frame.data))
            whole_bytes = getattr(log, "file_size", 0)  # a BLF says at its beginning how long it is
    except Exception as error:  # python-can's readers raise whatever their parsers trip over
        raise InputError(
            f"not a readable CAN log ({type(error).__name__}: {error}); copy or export it again", path
        ) from None
    size = path.stat().st_size
    return found, others, [f"the file is cut off: it has {size:,} of {whole_bytes:,} bytes"] * (size < whole_bytes)


def _messages(dbc: Path | str) -> dict[_Head, Message]:
    try:
        return {(message.id, message.extended): message for message in read_layouts(Path(dbc)).values()}
    except ConfigError as error:
        raise InputError(f"not a readable DBC ({error})", dbc) from None
