"""The section of the station file on its CAN buses."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BaseModel, Field, model_validator

from bench.acquisition.station.settings.framing import FramingSettings
from bench.acquisition.station.settings.link import LinkSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.base import STRICT, PlacedError
from drivers.daq import COLUMN_BYTES, COUNTER_BYTES, SCHEME
from drivers.interfaces import BusSettings, unit_filters
from drivers.packet_bus import INTERFACE as PACKETS
from drivers.packet_bus import refusal

Text = Annotated[str, Field(min_length=1)]

LOCAL_INTERFACES = ("virtual", "blocks")
"""python-can interfaces that live inside one process: captured in it. Everything else gets a process of its own."""


class Bus(BaseModel):
    """One CAN bus, by the name of its python-can interface."""

    model_config = STRICT

    interface: Text
    """python-can interface: socketcan, pcan, kvaser, …; `blocks` or `virtual` in a simulated station; `packets` for a
    serial line or UDP."""
    channel: Text
    """Channel of that interface, such as can0; of `packets` a serial port, udp://0.0.0.0:5005 or daq:NAME/DEVICE."""
    bitrate: Annotated[int, Field(gt=0)] | None = None
    """Bit rate [bit/s]; left out where the operating system sets it; of a serial port its baud rate."""
    fd: bool = False
    """CAN FD: frames of up to 64 bytes."""
    data_bitrate: Annotated[int, Field(gt=0)] | None = None
    """Bit rate [bit/s] of the data phase of CAN FD."""
    timing: dict[str, int | float] | None = None
    """Instead of bit rates: fields of python-can's BitTiming, or of BitTimingFd with `fd`; with a sample point in them,
    those of its `from_sample_point`."""
    filtered: bool = True
    """Only frames of the station's units are received; off: the journal keeps everything on the bus."""
    framing: FramingSettings | None = None
    """How packets lie in the bytes of a serial line or of UDP; needed with `packets`."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Further options of the interface."""
    link: LinkSettings = LinkSettings(degraded_after_s=1.0, lost_after_s=4.0)
    """What a failure of its capture means; units on a bus that is lost leave the run, where others are left."""

    @model_validator(mode="after")
    def _fits(self) -> Bus:
        if self.data_bitrate is not None and not self.fd:
            text = f"data_bitrate is {self.data_bitrate}: only CAN FD has one; add `fd: true`"
            raise PlacedError(text, ("data_bitrate",))
        if self.timing is not None and (self.bitrate or self.data_bitrate):
            raise PlacedError("timing and bit rates exclude each other; leave one of them out", ("timing",))
        if self.framing is not None and self.channel.startswith(("memory:", "udp-to:")):
            text = f"channel {self.channel!r} is no line of a unit; write a serial port, or udp://0.0.0.0:PORT"
            raise PlacedError(text, ("channel",))
        if self.channel.startswith(SCHEME) and self.framing is not None:
            self._samples(self.framing)
        if self.framing is not None and (why := refusal(self.channel, self.bitrate, self.options)):
            raise PlacedError(why, ("channel",))
        if (self.framing is not None) != (self.interface == PACKETS):
            text = "needs `framing`" if self.framing is None else f"has no framing; only {PACKETS!r} has one"
            raise PlacedError(f"interface {self.interface!r} {text}", ("interface",))
        if self.framing is not None and (self.fd or self.timing is not None):
            raise PlacedError("packets are no CAN: leave out `fd` and `timing`", ("fd" if self.fd else "timing",))
        return self

    def _samples(self, framing: FramingSettings) -> None:
        """The framing of a data acquisition device: a number and columns of float64."""
        columns = ((framing.length or 0) - COUNTER_BYTES) / COLUMN_BYTES
        if framing.kind != "datagram" or columns < 1 or columns % 1:
            text = f"samples of a device are `kind: datagram` with `length: {COUNTER_BYTES}` + {COLUMN_BYTES} a column"
            raise PlacedError(text, ("framing",))

    @property
    def local(self) -> bool:
        """Whether it lives inside one process."""
        return self.interface in LOCAL_INTERFACES or self.channel.startswith("memory:")

    @property
    def room(self) -> int:
        """Bytes of data that its longest frames have."""
        return self.to_driver().room

    def to_driver(self, units: Iterable[UnitSettings] = ()) -> BusSettings:
        """The same for the driver; filtered for these units, if there are any."""
        filtered = self.filtered and self.framing is None
        heard = [(unit.dbc, unit.number, unit.mapping) for unit in units] if filtered else []
        return BusSettings(
            interface=self.interface,
            channel=self.channel,
            bitrate=self.bitrate,
            options=self.options,
            fd=self.fd,
            data_bitrate=self.data_bitrate,
            timing=self.timing,
            filters=unit_filters(heard),
            framing=None if self.framing is None else self.framing.to_driver(),
        )
