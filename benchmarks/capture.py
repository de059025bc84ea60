"""Decoding, writing and capturing CAN frames beside alternatives, in one run.

    python -m benchmarks.capture [--quick] [--seconds 30] [--rounds 3]

CPU is that of a separate process with one thread, the least of alternating rounds; input is loaded before. Frames are
those of one simulated unit with its own DBC, and of a DBC with all features of DBC files.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.can_frames import ANY, FEW, Given, few, load, log_of, messages, of_any_kind, simulated
from benchmarks.rounds import Case, Method, Table, compared, measured
from drivers.journal import FrameArray, JournalWriter, Kind
from drivers.wire import Column, Message

FRAMES = 1_000_000
WRITTEN = 100_000
"""Frames for the writers: one of them needs 150 us for each."""
FAMILY = Path(__file__).parents[1] / "drivers" / "gyros" / "vibratory.dbc"
Columns = dict[str, np.ndarray]


def ours_from_records(given: Given) -> Columns:
    """Blocks of a journal."""
    words = given.frames.view("<u8").reshape(-1, 3)
    ids = words[:, 1] & np.uint64(0xFFFF_FFFF)
    found = {}
    for message in given.layouts.values():
        at = np.flatnonzero(ids == np.uint64(message.id))
        found |= named(message, message.decode(words[at, 2].view(np.uint8).reshape(-1, 8)))
    return found


def ours_from_bytes(given: Given) -> Columns:
    """Payloads as bytes objects, as cantools gets them."""
    ids = np.array(given.ids, dtype=np.uint32)
    whole = np.frombuffer(b"".join([*given.payloads, bytes(8)]), dtype=np.uint8)
    ends = np.cumsum(np.fromiter(map(len, given.payloads), dtype=np.int64, count=len(ids)))
    windows = np.lib.stride_tricks.sliding_window_view(whole, 8)
    found = {}
    for message in given.layouts.values():
        at = np.flatnonzero(ids == message.id)
        data = windows[ends[at] - message.length]
        data[:, message.length :] = 0
        found |= named(message, message.decode(data))
    return found


def named(message: Message, columns: Mapping[str, Column]) -> Columns:
    return {f"{message.name}.{name}": values for name, (values, _) in columns.items()}


def with_cantools(given: Given) -> Columns:
    decode = given.database.decode_message
    found: dict[str, list[float]] = {}
    names = {message.frame_id: message.name for message in given.database.messages}
    for identifier, payload in zip(given.ids, given.payloads, strict=True):
        for name, value in decode(identifier, payload, decode_choices=False).items():
            found.setdefault(f"{names[identifier]}.{name}", []).append(value)
    return {name: np.array(values, dtype=np.float64) for name, values in found.items()}


def cantools_calls(given: Given) -> Columns:
    """Only the calls; results are discarded."""
    decode = given.database.decode_message
    for identifier, payload in zip(given.ids, given.payloads, strict=True):
        decode(identifier, payload, decode_choices=False)
    return {}


def with_asammdf(given: Given) -> Columns:
    """Extraction from a log on disk."""
    from asammdf import MDF

    path = log_of(given)
    out = MDF(path).extract_bus_logging({"CAN": [(given.dbc, 0)]}, ignore_value2text_conversion=True)
    found = {}
    for index, group in enumerate(out.groups):
        message = group.channel_group.comment.split("message ")[1].split()[0]
        for k, channel in enumerate(group.channels):
            if channel.name != "time":
                found[f"{message}.{channel.name}"] = out.get(group=index, index=k).samples
    return found


def off(answer: Columns, given: Given, folder: Path) -> float:
    """Largest difference from our columns, relative to the largest value of each; missing columns count as 1."""
    found, worst = ours_from_records(given), 0.0
    if not answer:
        return float("nan")
    for name, values in found.items():
        theirs = answer.get(name)
        if theirs is not None and theirs.dtype.kind not in "iufb":
            continue  # asammdf turns values with names into text
        if theirs is None or len(theirs) != len(values):
            worst = max(worst, 1.0 if len(values) else 0.0)
        elif len(values):
            worst = max(
                worst, float(np.max(np.abs(theirs.astype(np.float64) - values)) / max(np.max(np.abs(values)), 1e-300))
            )
    return worst


DECODERS = {
    "ours, from records of a journal": Method(ours_from_records),
    "ours, from a list of bytes": Method(ours_from_bytes),
    "cantools decode_message, kept in lists": Method(with_cantools, ("cantools",)),
    "cantools decode_message, calls alone": Method(cantools_calls, ("cantools",)),
    "asammdf extract_bus_logging": Method(with_asammdf, ("asammdf",)),
}


class Written(NamedTuple):
    frames: FrameArray
    messages: list[Any]
    folder: Path


def load_written(folder: Path) -> Written:
    given = CASES["decode, a gyro's DBC"].load(folder)
    return Written(given.frames[:WRITTEN], messages(given.frames[:WRITTEN]), folder)


def few_written(given: Written) -> Written:
    return Written(given.frames[:FEW], given.messages[:FEW], given.folder)


def in_blocks(given: Written) -> int:
    """Our journal: one write per block of 1024 records with its CRC."""
    path = fresh(given, "gtbj")
    writer = JournalWriter(path)
    for start in range(0, len(given.frames), 1024):
        block = given.frames[start : start + 1024]
        writer.append(Kind.FRAMES, block.tobytes(), len(block), 0.0)
    writer.close()
    return path.stat().st_size


def by_message(given: Written) -> int:
    """The same from python-can's messages, one by one, as in the capture."""
    from drivers.frames import to_record

    path = fresh(given, "gtbj")
    writer = JournalWriter(path)
    records: list[bytes] = []
    for message in given.messages:
        records.append(to_record(message, round(message.timestamp * 1e9)))
        if len(records) == 1024:
            writer.append(Kind.FRAMES, b"".join(records), 1024, 0.0)
            records = []
    writer.append(Kind.FRAMES, b"".join(records), len(records), 0.0)
    writer.close()
    return path.stat().st_size


def with_writer(ending: str) -> Callable[[Written], int]:
    """A writer of python-can."""

    def write(given: Written) -> int:
        import can

        path = fresh(given, ending)
        with can.Logger(str(path)) as log:
            for message in given.messages:
                log.on_message_received(message)
            while ending == "db" and log.num_frames < len(given.messages):
                time.sleep(0.005)  # what its thread has not written when it is stopped is lost: all but the first 501
        return path.stat().st_size

    return write


def crc_alone(given: Written) -> int:
    return zlib.crc32(given.frames.tobytes())


def fresh(given: Written, ending: str) -> Path:
    path = given.folder / f"written-{os.getpid()}.{ending}"
    path.unlink(missing_ok=True)
    return path


WRITERS = {
    "our journal, blocks of 1024": Method(in_blocks),
    "our journal, message by message": Method(by_message),
    **{
        f"python-can {ending.upper()}": Method(with_writer(ending), ("can",))
        for ending in ("blf", "asc", "csv", "log", "db")
    },
    "python-can MF4": Method(with_writer("mf4"), ("can", "asammdf")),
    "CRC-32 of the bytes": Method(crc_alone, limit=True),
}
CASES: dict[str, Case] = {
    "decode, a gyro's DBC": Case(load("gyro", simulated, FAMILY.read_text()), few, DECODERS, off),
    "decode, any DBC": Case(load("any", of_any_kind, ANY), few, DECODERS, off),
    "write": Case(load_written, few_written, WRITERS, repeats=1),
}


def tables(quick: bool = False, seconds: float = 30.0, rounds: int = 3) -> list[Table]:
    """All tables of capture."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "frames").write_text(str(20_000 if quick else FRAMES))
        for case in list(CASES.values())[:2]:
            given = case.load(folder)
            log_of(given)
            log_of(few(given))
        rows = measured("benchmarks.capture", folder, CASES, 1 if quick else rounds)
    decode = [row for row in rows if row.case.startswith("decode")]
    write = [row for row in rows if row.case == "write"]
    return [
        compared(
            "Decoding CAN frames", f"{20_000 if quick else FRAMES:,} frames into columns of physical values.", decode
        ),
        compared("Writing CAN frames", f"{min(WRITTEN, 20_000 if quick else FRAMES):,} frames to a file.", write),
        *saturated_tables(2.0 if quick else seconds),
    ]


def saturated_tables(seconds: float) -> list[Table]:
    """Buses at and beyond their capacity."""
    from benchmarks.saturated import tables as of_buses

    return of_buses(seconds)


def show(tables: Iterable[Table]) -> None:
    for table in tables:
        print(table.markdown(), end="\n\n", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    show(tables(options.quick, options.seconds, options.rounds))


if __name__ == "__main__":
    main()
