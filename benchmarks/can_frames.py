"""Input of the benchmark of capture: frames of a simulated unit, frames of a DBC with all features of DBC files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cantools
import numpy as np

from drivers.journal import FRAME, FrameArray
from drivers.wire import Message, load_dbc, read_layouts

FEW = 1000
SAID = {
    "RateValid": 1,
    "LoopLocked": 1,
    "RateSaturated": 0,
    "Serial": 1,
    "Firmware": 1,
    "CoefficientSet": 0,
    "State": 5,
}
"""What a unit says that is well."""
ANY = """VERSION ""
BU_: A
BO_ 1 BIG: 8 A
 SG_ A : 7|16@0- (0.01,-40) [0|0] "" A
 SG_ B : 20|11@0+ (1,0) [0|0] "" A
 SG_ C : 39|32@0- (1,0) [0|0] "" A
BO_ 2 ODD: 7 A
 SG_ D : 3|13@1- (0.5,0) [0|0] "" A
 SG_ E : 17|23@1+ (0.001,5) [0|0] "" A
 SG_ F : 41|9@1- (1,0) [0|0] "" A
BO_ 3 FLOATS: 8 A
 SG_ G : 0|32@1- (1,0) [0|0] "" A
 SG_ H : 39|32@0- (1,0) [0|0] "" A
BO_ 4 MUX: 8 A
 SG_ I M : 0|8@1+ (1,0) [0|0] "" A
 SG_ J m0 : 8|16@1- (0.1,0) [0|0] "" A
 SG_ K m1 : 8|24@1+ (1,0) [0|0] "" A
 SG_ L : 32|32@1+ (1e-6,0) [0|0] "" A
SIG_VALTYPE_ 3 G : 1;
SIG_VALTYPE_ 3 H : 1;
"""


class Given(NamedTuple):
    """Frames as records of a journal, and as identifiers and bytes objects; their layout, ours and that of cantools."""

    frames: FrameArray
    ids: list[int]
    payloads: list[bytes]
    dbc: Path
    layouts: Mapping[str, Message]
    database: Any


def simulated(count: int) -> FrameArray:
    """Frames of one simulated unit, in the order in which it sends them."""
    layouts, random = load_dbc("vibratory"), np.random.default_rng(1)
    ids = np.full(count, layouts["GYRO_RATE"].id, dtype=np.uint32)
    ids[5::12], ids[11::12] = layouts["GYRO_RES"].id, layouts["GYRO_AMP"].id
    ids[600::6050], ids[601::6050] = layouts["GYRO_SUPPLY"].id, layouts["GYRO_HEARTBEAT"].id
    frames = np.zeros(count, dtype=FRAME)
    sample = np.maximum(np.cumsum(ids == layouts["GYRO_RATE"].id) - 1, 0)
    frames["id"], frames["t_ns"] = ids, sample * 2_000_000
    for message in layouts.values():
        at = np.flatnonzero(ids == message.id)
        values: dict[str, Any] = {}
        for name, signal in message.signals.items():
            low, high = (
                (-(1 << signal.length - 1), 1 << signal.length - 1) if signal.signed else (0, 1 << signal.length)
            )
            values[name] = random.integers(low, high, len(at)) * signal.scale + signal.offset
        values.pop("Crc8", None)
        values |= {name: value for name, value in SAID.items() if name in values}
        for name, most in (("SampleCounter", 0xFFFF), ("SlowCounter", 0xFF)):
            if name in values:
                values[name] = sample[at] & most
        data = message.pack(len(at), values)
        if "Crc8" in message.signals:
            data[:, message.length - 1] = message.crc(data, message.id)
        frames["data"][at], frames["len"][at] = data, message.length
    return frames


def of_any_kind(count: int) -> FrameArray:
    """Frames of the DBC above, in turn, with random bits; floats are finite."""
    random = np.random.default_rng(2)
    frames = np.zeros(count, dtype=FRAME)
    frames["id"], frames["t_ns"] = 1 + np.arange(count) % 4, np.arange(count) * 125_000
    frames["len"] = np.where(frames["id"] == 2, 7, 8)
    data = random.integers(0, 256, (count, 8), dtype=np.uint8)
    data[frames["id"] == 2, 7] = 0
    floats = random.normal(0.0, 100.0, (count, 2)).astype("<f4")
    rows = frames["id"] == 3
    data[rows, :4] = floats[rows, :1].view(np.uint8)
    data[rows, 4:] = floats[rows, 1:].astype(">f4").view(np.uint8)
    rows = frames["id"] == 4
    data[rows, 0] &= 1
    frames["data"] = data
    return frames


def load(name: str, make: Callable[[int], FrameArray], dbc: str) -> Callable[[Path], Given]:
    """Frames of a case, made once into the folder; the bus log for asammdf with them."""

    def given(folder: Path) -> Given:
        path = folder / f"{name}.npy"
        if not path.exists():
            np.save(path, make(int((folder / "frames").read_text())))
            (folder / f"{name}.dbc").write_text(dbc)
        frames = np.load(path)
        whole, lengths = frames["data"].tobytes(), frames["len"].tolist()
        payloads = [whole[8 * k : 8 * k + length] for k, length in enumerate(lengths)]
        path = folder / f"{name}.dbc"
        return Given(
            frames, frames["id"].tolist(), payloads, path, read_layouts(path), cantools.database.load_file(path)
        )

    return given


def few(given: Given) -> Given:
    return given._replace(frames=given.frames[:FEW], ids=given.ids[:FEW], payloads=given.payloads[:FEW])


def bus_log(path: Path, frames: FrameArray) -> Any:
    """The frames as a CAN log of asammdf (ASAM bus logging)."""
    from asammdf import MDF, Signal

    kind = np.dtype(
        [
            ("CAN_DataFrame.BusChannel", "u1"),
            ("CAN_DataFrame.ID", "<u4"),
            ("CAN_DataFrame.IDE", "u1"),
            ("CAN_DataFrame.DLC", "u1"),
            ("CAN_DataFrame.DataLength", "u1"),
            ("CAN_DataFrame.DataBytes", "(8,)u1"),
            ("CAN_DataFrame.Dir", "u1"),
            ("CAN_DataFrame.EDL", "u1"),
            ("CAN_DataFrame.BRS", "u1"),
        ]
    )
    rows = np.zeros(len(frames), dtype=kind)
    rows["CAN_DataFrame.BusChannel"] = 1
    rows["CAN_DataFrame.ID"] = frames["id"]
    for name in ("DLC", "DataLength"):
        rows[f"CAN_DataFrame.{name}"] = frames["len"]
    rows["CAN_DataFrame.DataBytes"] = frames["data"]
    from asammdf.blocks import v4_constants as v4
    from asammdf.blocks.source_utils import Source

    mdf = MDF(version="4.11")
    source = Source("CAN", "CAN", "", v4.SOURCE_BUS, v4.BUS_TYPE_CAN)
    mdf.append(Signal(rows, frames["t_ns"] * 1e-9, name="CAN_DataFrame", source=source), acq_source=source)
    group = mdf.groups[-1].channel_group
    group.flags = v4.FLAG_CG_BUS_EVENT | v4.FLAG_CG_PLAIN_BUS_EVENT
    mdf.save(path, overwrite=True)
    mdf.close()


def log_of(given: Given) -> Path:
    """The bus log of these frames beside their DBC, written on first use."""
    path = given.dbc.with_name(f"{given.dbc.stem}{len(given.frames)}.mf4")
    if not path.exists():
        bus_log(path, given.frames)
    return path


def messages(frames: FrameArray) -> list[Any]:
    """The same frames as python-can messages, for its writers."""
    from drivers.frames import to_messages

    return list(to_messages(frames, "1"))
