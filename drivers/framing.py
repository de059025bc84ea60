"""How packets lie in the bytes of a serial line or a datagram: SLIP, COBS, a header, or one packet a datagram.

Driver and simulator share it: it holds only the description of the wire, as data. A packet counts its bytes from its
first one, header and check sum included, with what SLIP or COBS added taken away.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import xor
from typing import Literal, NamedTuple

from anycrc import CRC

from drivers.errors import ConfigError

Order = Literal["little", "big"]
_END, _ESC, _ESC_END, _ESC_ESC = b"\xc0", b"\xdb", b"\xdb\xdc", b"\xdb\xdd"


@dataclass(frozen=True)
class Number:
    """An unsigned number in a packet: its first byte, how many there are, and their order."""

    byte: int
    size: int = 1
    order: Order = "little"

    def read(self, packet: bytes) -> int:
        """Its value."""
        return int.from_bytes(packet[self.byte : self.byte + self.size], self.order)

    def write(self, packet: bytearray, value: int) -> None:
        """Put a value there; ConfigError where it does not fit."""
        try:
            packet[self.byte : self.byte + self.size] = value.to_bytes(self.size, self.order)
        except OverflowError:
            raise ConfigError(f"{value} does not fit {self.size} bytes at byte {self.byte} of a packet") from None


@dataclass(frozen=True)
class Check:
    """A CRC in the last bytes of a packet, by the parameters that catalogues of CRCs have."""

    width: int
    poly: int
    init: int = 0
    refin: bool = False
    refout: bool = False
    xorout: int = 0
    order: Order = "little"
    """Order of its own bytes."""
    start: int = 0
    """First byte that it covers."""

    @property
    def size(self) -> int:
        """How many bytes it has."""
        return (self.width + 7) // 8

    @cached_property
    def _crc(self) -> CRC:
        return CRC(self.width, self.poly, self.init, self.refin, self.refout, self.xorout)

    def of(self, packet: bytes) -> bytes:
        """What the last bytes of a packet must be."""
        value: int = self._crc.calc(bytes(packet[self.start : -self.size]))
        return value.to_bytes(self.size, self.order)


Kind = Literal["add", "inverted", "negated", "xor", "fletcher", "fletcher_256"]


@dataclass(frozen=True)
class Sum:
    """A sum of bytes in the last bytes of a packet.

    `add`: the sum, `inverted`: its one's complement, `negated`: its two's complement, `xor`: the exclusive or of all
    bytes; `fletcher`: two sums modulo 255, of 8 bits each (Fletcher, IEEE Trans. Communications 30 (1982) 247);
    `fletcher_256`: the same modulo 256 (RFC 1145).
    """

    kind: Kind
    size: int = 1
    """Bytes that it has; Fletcher has 2."""
    init: int = 0
    """What it begins with."""
    order: Order = "little"
    """Order of its own bytes; of Fletcher, `little` has the plain sum first."""
    start: int = 0
    """First byte that it covers."""

    def of(self, packet: bytes) -> bytes:
        """What the last bytes of a packet must be."""
        covered = bytes(packet[self.start : -self.size])
        value = self._value(covered) % (1 << 8 * self.size)
        return value.to_bytes(self.size, self.order)

    def _value(self, covered: bytes) -> int:
        if self.kind == "xor":
            return reduce(xor, covered, self.init)
        if self.kind in ("fletcher", "fletcher_256"):
            first, second, modulus = self.init, self.init, 255 if self.kind == "fletcher" else 256
            for byte in covered:
                first = (first + byte) % modulus
                second = (second + first) % modulus
            return second << 8 | first
        total = self.init + sum(covered)
        return {"add": total, "inverted": ~total, "negated": -total}[self.kind]


@dataclass(frozen=True)
class Framing:
    """Packets on a line."""

    kind: Literal["slip", "cobs", "header", "datagram"]
    header: bytes = b""
    """What each packet begins with."""
    length: int | None = None
    """Bytes of every packet; None: they differ."""
    longest: int = 64
    """Bytes of the longest packet, where lengths differ."""
    length_at: Number | None = None
    """Where a packet says how long it is …"""
    length_adds: int = 0
    """… and how many bytes more there are than that says."""
    id_at: Number | None = None
    """Where a packet says which one it is; None: there is one kind of packet, number 0."""
    crc: Check | Sum | None = None
    """What is in its last bytes to check it by."""

    @property
    def room(self) -> int:
        """Bytes of the longest packet, in whole words of eight."""
        return -(-(self.length or self.longest) // 8) * 8

    def taken(self, length: int) -> list[tuple[str, range]]:
        """Bytes of a packet of this length that no signal can have, by what they are."""
        check = 0 if self.crc is None else self.crc.size
        numbers = {"number": self.id_at, "length": self.length_at}
        said = [(name, range(at.byte, at.byte + at.size)) for name, at in numbers.items() if at is not None]
        return [("header", range(len(self.header))), *said, ("CRC or sum", range(length - check, length))]

    def wrong(self, packet: bytes) -> bool:
        """Whether a packet is not whole."""
        if len(packet) > self.longest if self.length is None else len(packet) != self.length:
            return True
        if len(packet) < self._least or not packet.startswith(self.header):
            return True
        if self.length_at is not None and self.length_at.read(packet) + self.length_adds != len(packet):
            return True
        return self.crc is not None and self.crc.of(packet) != packet[-self.crc.size :]

    @property
    def _least(self) -> int:
        """Bytes without which a packet cannot be read."""
        ends = [one.byte + one.size for one in (self.length_at, self.id_at) if one is not None]
        return max([len(self.header), 1, *ends]) + (0 if self.crc is None else self.crc.size)

    def number(self, packet: bytes) -> int:
        """Which packet it is."""
        return 0 if self.id_at is None else self.id_at.read(packet)

    def encode(self, number: int, payload: bytes) -> bytes:
        """A packet on the line: header, number, length and CRC are put into the payload, which has room for them."""
        packet = bytearray(payload)
        packet[: len(self.header)] = self.header
        if self.id_at is not None:
            self.id_at.write(packet, number)
        if self.length_at is not None:
            self.length_at.write(packet, len(packet) - self.length_adds)
        if self.crc is not None:
            packet[-self.crc.size :] = self.crc.of(bytes(packet))
        if self.kind == "slip":
            return _END + bytes(packet).replace(_ESC, _ESC_ESC).replace(_END, _ESC_END) + _END
        return _cobs(bytes(packet)) + b"\0" if self.kind == "cobs" else bytes(packet)


class Piece(NamedTuple):
    """A packet that arrived, or bytes that are none."""

    packet: bytes
    whole: bool
    after: int
    """Bytes that had already arrived after it."""


class Deframer:
    """Finds the packets in bytes as they arrive. A little before the first one is the end of an earlier."""

    def __init__(self, framing: Framing) -> None:
        self._framing = framing
        self._rest = b""
        self._found = False
        self._skipped = 0

    def feed(self, data: bytes) -> Iterator[Piece]:
        """The packets that are complete now, and what is broken."""
        find = {"slip": self._delimited, "cobs": self._delimited, "header": self._headed}
        for piece in find.get(self._framing.kind, self._datagram)(data):
            self._skipped += len(piece.packet)
            self._found = self._found or piece.whole or self._skipped > 2 * self._framing.room
            if self._found:
                yield piece

    def _datagram(self, data: bytes) -> Iterator[Piece]:
        yield Piece(data, not self._framing.wrong(data), 0)

    def _delimited(self, data: bytes) -> Iterator[Piece]:
        mark = _END if self._framing.kind == "slip" else b"\0"
        decode = _unslip if self._framing.kind == "slip" else _uncobs
        *parts, rest = (self._rest + data).split(mark)
        after = sum(len(part) + 1 for part in parts) + len(rest)
        for part in parts:
            after -= len(part) + 1
            if part:
                packet = decode(part)
                yield Piece(packet or part, packet is not None and not self._framing.wrong(packet), after)
        self._rest = rest
        if len(rest) > 2 * self._framing.room + 2:  # no end where there must be one
            self._rest = b""
            yield Piece(rest, False, 0)

    def _headed(self, data: bytes) -> Iterator[Piece]:
        framing, rest = self._framing, self._rest + data
        broken = b""
        while True:
            at = rest.find(framing.header)
            if at < 0:
                at = max(len(rest) - len(framing.header) + 1, 0)
                broken, rest = broken + rest[:at], rest[at:]
                break
            broken, rest = broken + rest[:at], rest[at:]
            length = self._length(rest)
            if length is None or len(rest) < length:
                break
            if framing.wrong(rest[:length]):  # or the header is one by chance
                broken, rest = broken + rest[:1], rest[1:]
                continue
            if broken:
                yield Piece(broken, False, len(rest))
                broken = b""
            packet, rest = rest[:length], rest[length:]
            yield Piece(packet, True, len(rest))
        if broken:
            yield Piece(broken, False, len(rest))
        self._rest = rest

    def _length(self, rest: bytes) -> int | None:
        """Length of the packet that begins here; None: not known yet. One that cannot be is that of the least."""
        framing = self._framing
        if framing.length is not None:
            return framing.length
        assert framing.length_at is not None  # checked with the settings
        if len(rest) < framing.length_at.byte + framing.length_at.size:
            return None
        said = framing.length_at.read(rest) + framing.length_adds
        return said if framing._least <= said <= framing.longest else framing._least


def _unslip(part: bytes) -> bytes | None:
    """The packet between two ends (RFC 1055); None where an escape is followed by something else."""
    if part.count(_ESC) != part.count(_ESC_END) + part.count(_ESC_ESC):
        return None
    return part.replace(_ESC_END, _END).replace(_ESC_ESC, _ESC)


def _cobs(packet: bytes) -> bytes:
    """Cheshire and Baker, Consistent Overhead Byte Stuffing, IEEE/ACM Transactions on Networking 7 (1999) 159."""
    coded, blocks = b"", packet.split(b"\0")
    for place, block in enumerate(blocks):
        full = len(block) - len(block) % 254
        coded += b"".join(b"\xff" + block[i : i + 254] for i in range(0, full, 254))
        if full < len(block) or not full or place < len(blocks) - 1:
            coded += bytes([len(block) - full + 1]) + block[full:]
    return coded


def _uncobs(part: bytes) -> bytes | None:
    """The packet in a coded part without its zero; None where it ends within a group."""
    packet, at = b"", 0
    while at < len(part):
        code = part[at]
        group = part[at + 1 : at + code]
        if len(group) != code - 1:
            return None
        packet += group
        at += code
        if code < 255 and at < len(part):
            packet += b"\0"
    return packet
