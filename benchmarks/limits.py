"""Physical limits: a pass over memory, reading the file, a round trip on loopback, the bus's bit rate."""

from __future__ import annotations

import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rounds import Case, Method, Table, compared, measured

ROWS, QUICK_ROWS = 3_600_000, 200_000
REQUESTS = 2000
CONTROLLER = "watlow_f4t"
_REQUEST_BYTES, _ANSWER_BYTES = 12, 9 + 2 * 10
"""Modbus TCP: a request to read, and its answer with ten words."""
_UNIT_HZ = 500 + 2 * 50 + 1 + 1
"""Frames of a unit in a second: rate, two slow messages, supply, heartbeat."""
BUS_BIT_PER_S = 1_000_000


def spline_from(path: Path) -> Any:
    """The product's way from a file to a fitted spline."""
    from bench.analysis.fit.cells import Cells
    from bench.analysis.fit.samples import Samples
    from bench.analysis.fit.smooth import solve_spline
    from bench.analysis.fit.state import State
    from benchmarks.fit_data import CELLS, INTERVALS

    samples = Samples(path)
    state = State(Cells(*samples.range("temperature"), CELLS))
    for batch in samples.read(("temperature",)):
        state.add(batch.time, batch.columns, batch.y, batch.segment)
    return solve_spline(state.sums, state.table.sum(axis=0), INTERVALS)


def spline_in_memory(d: Any) -> Any:
    from benchmarks.fit_ours import our_spline

    return our_spline(d)


def decoded(path: Path) -> int:
    """Every value of the four columns that a spline needs, batch by batch, one thread."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as source:
        wanted = ["time", "rate", "temperature", "segment"]
        return sum(batch.num_rows for batch in source.iter_batches(1 << 17, columns=wanted, use_threads=False))


def bytes_of(path: Path) -> int:
    """The whole file, from the page cache."""
    count = 0
    with path.open("rb", buffering=0) as source:
        while piece := source.read(1 << 20):
            count += len(piece)
    return count


@contextmanager
def controller() -> Iterator[tuple[Any, int]]:
    """The simulated controller, its register map and its port."""
    from drivers.registers import load_map
    from drivers.sim.modbus_chamber import ModbusChamber

    registers = load_map(CONTROLLER)
    with ModbusChamber(registers) as chamber:
        yield registers, chamber.port


def our_requests(count: int) -> None:
    """First block of a poll, repeated, by the bench's link: checked and decoded."""
    from drivers.modbus import ModbusLink

    with controller() as (registers, port):
        link = ModbusLink(f"tcp://127.0.0.1:{port}")
        block = registers.blocks[0]
        for _ in range(count):
            link.read_block(block)
        link.close()


def pymodbus_requests(count: int) -> None:
    """The same words with only the client of pymodbus: neither checked nor decoded."""
    from pymodbus.client import ModbusTcpClient

    from drivers.registers import block_of

    with controller() as (registers, port), ModbusTcpClient("127.0.0.1", port=port) as client:
        _, start, words = block_of(registers.blocks[0])
        for _ in range(count):
            if client.read_holding_registers(start, count=words, device_id=1).isError():
                raise RuntimeError("refused")


def bare_round_trips(count: int) -> None:
    """The same number of bytes in both directions between two threads."""
    with echo() as link:
        for _ in range(count):
            link.sendall(bytes(_REQUEST_BYTES))
            link.recv(_ANSWER_BYTES)


@contextmanager
def echo() -> Iterator[socket.socket]:
    """A peer in a thread that answers each request with fixed bytes."""
    server = socket.create_server(("127.0.0.1", 0))

    def answer() -> None:
        peer, _ = server.accept()
        with peer:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while peer.recv(_REQUEST_BYTES):
                peer.sendall(bytes(_ANSWER_BYTES))

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        with socket.create_connection(server.getsockname()) as link:
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield link
    finally:
        thread.join()
        server.close()


def _columns(folder: Path) -> dict[str, np.ndarray]:
    return {path.stem: np.load(path) for path in folder.glob("*.npy")}


def _fewer(d: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: column[::50].copy() for name, column in d.items()}


CASES = {
    "24-interval spline, samples in memory": Case(
        _columns,
        _fewer,
        {
            "one pass": Method(spline_in_memory),
            "limit: read T and y once (sum)": Method(lambda d: d["temperature"].sum() + d["y"].sum(), limit=True),
            "limit: copy T and y": Method(lambda d: (d["temperature"].copy(), d["y"].copy()), limit=True),
        },
    ),
    "the same from data.parquet": Case(
        lambda folder: folder / "data.parquet",
        lambda path: path.with_name("few.parquet"),
        {
            "one pass": Method(spline_from),
            "limit: pyarrow decodes the columns, one thread": Method(decoded, limit=True),
            "limit: read the bytes of the file": Method(bytes_of, limit=True),
        },
    ),
    f"{REQUESTS:,} Modbus TCP requests, server included": Case(
        lambda folder: REQUESTS,
        lambda count: 50,
        {
            "link of the bench": Method(our_requests),
            "pymodbus client alone": Method(pymodbus_requests),
            "limit: bare sockets": Method(bare_round_trips, limit=True),
        },
    ),
}


def bits(identifiers: np.ndarray, payloads: np.ndarray) -> np.ndarray:
    """Bits (n,) of classical frames with 11-bit identifiers (n,) and data (n, bytes), pauses between frames included.

    Start of frame to CRC is stuffed after five equal bits; delimiters, acknowledge, end and pause are 13 bits more
    (ISO 11898-1).
    """
    n, size = payloads.shape
    body = np.zeros((n, 19 + 8 * size + 15), dtype=np.uint8)
    body[:, 1:12] = (identifiers[:, None] >> np.arange(10, -1, -1)) & 1
    body[:, 15:19] = (size >> np.arange(3, -1, -1)) & 1  # 12..14 are RTR, IDE, r0: dominant
    body[:, 19 : 19 + 8 * size] = np.unpackbits(payloads, axis=1)
    crc = np.zeros(n, dtype=np.uint16)
    for column in body[:, : 19 + 8 * size].T:
        over = ((crc >> 14) & 1) ^ column
        crc = ((crc << 1) & 0x7FFF) ^ np.where(over, 0x4599, 0).astype(np.uint16)
    body[:, -15:] = (crc[:, None] >> np.arange(14, -1, -1)) & 1
    stuffed, last, run = np.zeros(n, dtype=np.int64), np.full(n, 2), np.zeros(n, dtype=np.int64)
    for column in body.T:
        run = np.where(column == last, run + 1, 1)
        last = column.astype(np.int64)
        full = run == 5
        stuffed += full
        last, run = np.where(full, 1 - last, last), np.where(full, 1, run)
    return body.shape[1] + stuffed + 13


def gyro_payloads(n: int) -> np.ndarray:
    """Data of the rate message: a small rate with noise in 1e-6 deg/s, counter, status, a check sum."""
    random = np.random.default_rng(0)
    payloads = np.zeros((n, 8), dtype=np.uint8)
    payloads[:, :4] = random.normal(3000.0, 4000.0, n).astype("<i4").view(np.uint8).reshape(n, 4)
    payloads[:, 4:6] = np.arange(n).astype("<u2").view(np.uint8).reshape(n, 2)
    payloads[:, 6] = 0x30
    payloads[:, 7] = random.integers(0, 256, n)
    return payloads


def bus_table() -> Table:
    """Frames per second that the bit rate allows, and the corresponding number of units."""
    size = 8
    plain = 19 + 8 * size + 15 + 13
    worst = plain + (19 + 8 * size + 15 - 1) // 4
    found = bits(np.full(50_000, 0x120), gyro_payloads(50_000))
    rows = []
    for name, length in (("no stuffing", plain), ("rate message of a unit, mean", found.mean()), ("worst", worst)):
        rate = BUS_BIT_PER_S / length
        rows.append((name, f"{length:.1f}", f"{rate:,.0f}", f"{rate / _UNIT_HZ:.1f}", f"{1e6 / rate:.0f}"))
    head = ("8 data bytes, 1 Mbit/s", "bits per frame", "frames/s", "units of 602 frames/s", "us per frame")
    reading = (
        "Computed, not measured: a recorder with less CPU per frame than the last column keeps up with a full bus."
    )
    return Table("The bus's bit rate", reading, head, rows)


def tables(quick: bool) -> list[Table]:
    from benchmarks.fit_data import data, write_file

    rows = QUICK_ROWS if quick else ROWS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        d = data(rows)
        for channel in ("temperature", "y", "time"):
            np.save(folder / channel, d[channel])
        write_file(folder / "data.parquet", rows)
        write_file(folder / "few.parquet", 20_000)
        found = measured("benchmarks.limits", folder, CASES, 1 if quick else 5)
        size_mb = (folder / "data.parquet").stat().st_size / 1e6
    reading = (
        f"{rows:,} samples, {size_mb:.0f} MB as a file; the ratio of a limit is its share of our time; at 1.0 x "
        "no further gain is possible."
    )
    return [compared("Memory, file, loopback", reading, found), bus_table()]
