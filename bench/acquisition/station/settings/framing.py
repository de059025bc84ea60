"""The section of the station file on how packets lie in the bytes of a serial line or of UDP."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT, PlacedError
from drivers.framing import Check, Framing, Kind, Number, Sum

LONGEST = 248
Byte = Annotated[int, Field(ge=0, le=LONGEST - 1)]
Order = Literal["little", "big"]


class NumberSettings(BaseModel):
    """An unsigned number in a packet."""

    model_config = STRICT

    byte: Byte
    """Its first byte; byte 0 is the first of the packet."""
    bytes: Annotated[int, Field(ge=1, le=2)] = 1
    """How many it has."""
    order: Order = "little"
    """Byte order."""

    def to_driver(self) -> Number:
        """The same for the driver."""
        return Number(self.byte, self.bytes, self.order)


class CrcSettings(BaseModel):
    """A CRC in the last bytes of a packet, by the parameters of the catalogue of CRCs (RevEng)."""

    model_config = STRICT

    width: Literal[8, 16, 24, 32, 64]
    """Bits."""
    poly: Annotated[int, Field(ge=1)]
    """Polynomial without its highest term, such as 0x1021."""
    init: Annotated[int, Field(ge=0)] = 0
    """Register before the first byte."""
    refin: bool = False
    """Bits of each byte are taken in from the lowest."""
    refout: bool = False
    """The register is reflected at the end."""
    xorout: Annotated[int, Field(ge=0)] = 0
    """What the register is combined with at the end."""
    order: Order = "little"
    """Order of its own bytes."""
    start: Byte = 0
    """First byte that it covers; it covers all from there to itself."""

    @model_validator(mode="after")
    def _fits(self) -> CrcSettings:
        for name in ("poly", "init", "xorout"):
            if getattr(self, name) >> self.width:
                raise PlacedError(f"is 0x{getattr(self, name):X}, more than {self.width} bits", (name,))
        return self

    def to_driver(self) -> Check:
        """The same for the driver."""
        return Check(**self.model_dump())


class SumSettings(BaseModel):
    """A sum of bytes in the last bytes of a packet."""

    model_config = STRICT

    kind: Kind
    """`add`: the sum, `inverted`: its one's complement, `negated`: its two's complement, so that all bytes add up to 0;
    `xor`: the exclusive or of all bytes; `fletcher`: Fletcher-16, modulo 255;
    `fletcher_256`: modulo 256, as in UBX and MIP."""
    bytes: Annotated[int, Field(ge=1, le=2)] = 1
    """How many it has; Fletcher has 2, an exclusive or 1."""
    init: Annotated[int, Field(ge=0, le=0xFFFF)] = 0
    """What it begins with."""
    order: Order = "little"
    """Order of its own bytes; of Fletcher, `little` has the plain sum first."""
    start: Byte = 0
    """First byte that it covers; it covers all from there to itself."""

    @model_validator(mode="after")
    def _fits(self) -> SumSettings:
        needed = {"fletcher": 2, "fletcher_256": 2, "xor": 1}.get(self.kind, self.bytes)
        if self.bytes != needed:
            raise PlacedError(f"is {self.bytes}: {self.kind} has {needed}", ("bytes",))
        most = {"fletcher": 254, "fletcher_256": 255}.get(self.kind, (1 << 8 * self.bytes) - 1)
        if self.init > most:
            raise PlacedError(f"is {self.init}: it has to be at most {most}", ("init",))
        return self

    def to_driver(self) -> Sum:
        """The same for the driver."""
        return Sum(self.kind, self.bytes, self.init, self.order, self.start)


class FramingSettings(BaseModel):
    """How packets lie in the bytes of a line; bytes count from the first of the packet, header and CRC included."""

    model_config = STRICT

    kind: Literal["slip", "cobs", "header", "datagram"]
    """SLIP (RFC 1055), COBS with a zero after each packet, packets with a fixed header, or one packet a datagram."""
    header: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2} ?){1,8}$", examples=["AA 55"])] | None = None
    """Bytes that each packet begins with, in hex: "AA 55"."""
    length: Annotated[int, Field(ge=1, le=LONGEST)] | None = None
    """Bytes of every packet; left out where they differ."""
    longest: Annotated[int, Field(ge=1, le=LONGEST)] = 64
    """Bytes of the longest packet, where they differ."""
    length_at: NumberSettings | None = None
    """Where a packet says how long it is."""
    length_adds: Annotated[int, Field(ge=-LONGEST, le=LONGEST)] = 0
    """How many bytes a packet has beyond what it says there."""
    id_at: NumberSettings | None = None
    """Where a packet says which one it is: the `id` of its signals; left out: all are 0."""
    crc: CrcSettings | None = None
    """CRC in its last bytes."""
    sum: SumSettings | None = None
    """Instead of a CRC: a sum of bytes in its last bytes."""

    @model_validator(mode="after")
    def _complete(self) -> FramingSettings:
        if self.kind == "header" and self.header is None:
            raise PlacedError("packets with a header need `header`: the bytes that each begins with", ("kind",))
        if self.kind == "header" and (self.length is None) == (self.length_at is None):
            text = "packets with a header end by `length`, or by `length_at`; state one of them"
            raise PlacedError(text, ("kind",))
        if self.crc is not None and self.sum is not None:
            raise PlacedError("has a `crc`, too: state what stands in the last bytes, one of the two", ("sum",))
        if self.length is not None:
            inside = {"length_at": self.length_at, "id_at": self.id_at}
            for name, one in inside.items():
                if one is not None and one.byte + one.bytes > self.length:
                    raise PlacedError(f"is beyond the packet, which has {self.length} bytes", (name,))
        return self

    def to_driver(self) -> Framing:
        """The same for the driver."""
        return Framing(
            self.kind,
            bytes.fromhex(self.header or ""),
            self.length,
            self.longest,
            None if self.length_at is None else self.length_at.to_driver(),
            self.length_adds,
            None if self.id_at is None else self.id_at.to_driver(),
            None if (check := self.crc or self.sum) is None else check.to_driver(),
        )
