"""CAN frames as fixed records: how they lie in memory and in a journal, and how a finished journal packs them.

A record has 16 bytes of head and 8 bytes of data, 64 on a bus with CAN FD.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

HEAD_BYTES = 16
CLASSICAL_BYTES, FD_BYTES = 8, 64
FLAG_EXTENDED, FLAG_REMOTE, FLAG_ERROR, FLAG_FD, FLAG_FAST = 1, 2, 4, 8, 16
"""29-bit identifier, remote frame, error frame, CAN FD, CAN FD with the faster bit rate."""

FrameArray = npt.NDArray[np.void]

_SMALL = ("id", "flags", "len", "channel", "pad")


def frame_type(data_bytes: int) -> np.dtype[np.void]:
    """A record with room for so many bytes of data; `t_ns` is bench time [ns] at reception."""
    return np.dtype(
        [
            ("t_ns", "<i8"),
            ("id", "<u4"),
            ("flags", "u1"),
            ("len", "u1"),
            ("channel", "u1"),
            ("pad", "u1"),
            ("data", "u1", (data_bytes,)),
        ]
    )


FRAME = frame_type(CLASSICAL_BYTES)
"""One captured frame of a classical bus, 24 bytes."""


def records(data: bytes | memoryview, count: int) -> FrameArray:
    """`count` records of equal size (count,); ValueError where the bytes are not so many records."""
    if not count:
        return np.zeros(0, dtype=FRAME)
    size, rest = divmod(len(data), count)
    if rest or size <= HEAD_BYTES:
        raise ValueError(f"{len(data)} bytes are not {count} frames")
    return np.frombuffer(data, dtype=frame_type(size - HEAD_BYTES))


def packed(frames: FrameArray) -> bytes:
    """Parquet of records (n,): sorted by identifier and transposed, each byte beside the same byte of the next frame.

    `at` is the place that each had. A sixth to an eighth of the size for frames of a gyro.
    """
    import pyarrow as pa  # slow to import; a capture never needs it
    import pyarrow.parquet as pq

    at = np.argsort(frames["id"], kind="stable")
    ordered = frames[at]
    width = frames.dtype["data"].itemsize
    data = pa.py_buffer(np.ascontiguousarray(ordered["data"]).tobytes())
    columns: dict[str, Any] = {"at": at.astype(np.int32), "t_ns": ordered["t_ns"]}
    columns |= {name: ordered[name] for name in _SMALL}
    columns["data"] = pa.FixedSizeBinaryArray.from_buffers(pa.binary(width), len(at), [None, data])
    splits = {"at": "DELTA_BINARY_PACKED", "t_ns": "DELTA_BINARY_PACKED", "data": "BYTE_STREAM_SPLIT"}
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.table(columns), sink, compression="zstd", use_dictionary=list(_SMALL), column_encoding=splits,
        write_statistics=False, row_group_size=max(len(at), 1),
    )  # fmt: skip
    return bytes(sink.getvalue())


def unpacked(data: bytes) -> FrameArray:
    """The records (n,) that `packed` was given, byte for byte; ValueError where the bytes are damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.ParquetFile(pa.BufferReader(data)).read(use_threads=False)
    binary = table.column("data").combine_chunks()
    width = binary.type.byte_width
    at = table.column("at").to_numpy()
    frames: FrameArray = np.zeros(table.num_rows, dtype=frame_type(width))
    for name in ("t_ns", *_SMALL):
        frames[name][at] = table.column(name).to_numpy()
    if len(at):
        start = binary.offset * width
        payload = np.frombuffer(binary.buffers()[1], dtype=np.uint8)[start : start + len(at) * width]
        frames["data"][at] = payload.reshape(len(at), width)
    return frames
