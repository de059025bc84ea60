"""The only module that opens CAN buses: any python-can interface by its name, with its bit timing and its filters.

When the library of a vendor is missing, python-can raises a different exception for each interface (ImportError,
OSError, NameError, a custom one); here it is one ConfigError that names what to install.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.can_record import CLASSICAL_BYTES, FD_BYTES
from drivers.errors import ConfigError, LinkError, one_line
from drivers.framing import Framing
from drivers.layout import layout_of
from drivers.wire import load_dbc

if TYPE_CHECKING:
    import can

_RECEIVE_BUFFER = 8 << 20
_SO_RCVBUFFORCE = 33

NEEDS = {
    "socketcan": "a Linux kernel with SocketCAN (modprobe can_raw)",
    "pcan": "PEAK's PCAN-Basic library (libpcanbasic.so, PCANBasic.dll)",
    "kvaser": "Kvaser CANlib (libcanlib.so from the linuxcan package, canlib32.dll)",
    "vector": "Vector's XL Driver Library (vxlapi64.dll; Windows only)",
    "ixxat": "HMS Ixxat's VCI driver (vcinpl.dll; Windows only)",
    "nixnet": "NI-XNET and the Python package nixnet (Windows only)",
    "nican": "NI-CAN (nican.dll; 32-bit Windows only)",
    "neovi": "the Python package python-ics",
    "etas": "ETAS BOA (dll-csiBind.dll; Windows only)",
    "systec": "SYS TEC's USB-CAN library (usbcan64.dll; Windows only)",
    "usb2can": "8devices' usb2can.dll and the Python package pywin32 (Windows only)",
    "iscan": "Thorsis isCAN's iscandrv library",
    "neousys": "Neousys' WDT_DIO library",
    "canalystii": "the Python package canalystii",
    "cantact": "the Python package cantact",
    "gs_usb": "the Python package gs-usb and libusb",
    "slcan": "the Python package pyserial",
    "robotell": "the Python package pyserial",
    "seeedstudio": "the Python package pyserial",
    "serial": "the Python package pyserial",
    "udp_multicast": "the Python package msgpack",
}
"""Requirements of the interfaces of python-can 4.6 (from its documentation, and its error when they are missing)."""


@dataclass(frozen=True)
class BusSettings:
    """Which python-can interface to open; `options` are passed to it as they are.

    `timing` are the fields of `can.BitTiming`, or of `can.BitTimingFd` when `fd` is set; it replaces `bitrate` and
    `data_bitrate`. `filters` are python-can filters; without filters everything is received.
    """

    interface: str
    channel: str
    bitrate: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    fd: bool = False
    data_bitrate: int | None = None
    timing: Mapping[str, Any] | None = None
    filters: Sequence[Mapping[str, Any]] = ()
    framing: Framing | None = None
    """How packets lie on a line that is no CAN; the interface is `packets` then."""

    @property
    def room(self) -> int:
        """Bytes of data that its longest frames have."""
        if self.framing is not None:
            return self.framing.room
        return FD_BYTES if self.fd else CLASSICAL_BYTES

    def __str__(self) -> str:
        if self.framing is not None:
            return f"packets on {self.channel}"
        return f"CAN bus {self.interface}:{self.channel}"


def open_bus(settings: BusSettings) -> can.BusABC:
    """Open a bus; ConfigError when the settings cannot work here, LinkError when the bus is not available now.

    Our own frames are never received: they must not be mistaken for frames of a unit.
    """
    if settings.framing is not None:
        return _open_line(settings, settings.framing)
    import can

    if settings.interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise ConfigError(f"{settings}: python-can has no interface {settings.interface!r}; it has {known}")
    options = _options(settings)
    try:
        bus = can.Bus(interface=settings.interface, channel=settings.channel, ignore_config=True, **options)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{settings}: {one_line(error)}; see `options` and the bit rate in the station file"
        ) from error
    except (NotImplementedError, ImportError, NameError, AttributeError) as error:
        raise ConfigError(f"{settings}: {one_line(error)}{_needs(settings)}") from error
    except (can.CanError, OSError) as error:
        if _is_missing(error):
            raise ConfigError(f"{settings}: {one_line(error)}{_needs(settings)}") from error
        raise LinkError(f"{settings} does not open: {one_line(error)}") from error
    _enlarge_buffer(bus)
    return bus


def _open_line(settings: BusSettings, framing: Framing) -> can.BusABC:
    from drivers.packet_bus import PacketBus

    try:
        return PacketBus(settings.channel, framing, settings.bitrate, **settings.options)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{settings}: {one_line(error)}; see `channel` and `options` in the station file") from error
    except OSError as error:
        raise LinkError(f"{settings} does not open: {one_line(error)}") from error


def unit_filters(units: Iterable[tuple[str | Path | None, int, Mapping[str, Any] | None]]) -> list[dict[str, Any]]:
    """python-can filters that let through the frames of these units, and nothing else.

    Each is given as its DBC, its number and the mapping of its signals.

    SocketCAN filters in the kernel and still reports error frames; interfaces that filter in python-can drop those.
    """
    rules = []
    for dbc, number, signals in units:
        messages = load_dbc(dbc).values() if signals is None and dbc is not None else layout_of(dbc, signals).messages
        for message in messages:
            mask = 0x1FFFFFFF if message.extended else 0x7FF
            rules.append({"can_id": message.id + number, "can_mask": mask, "extended": message.extended})
    return rules


def _options(settings: BusSettings) -> dict[str, Any]:
    options = dict(settings.options)
    if options.get("receive_own_messages"):
        raise ConfigError(f"{settings}: receive_own_messages must stay off, or our own frames are taken for a unit's")
    if settings.bitrate is not None and settings.timing is None:
        options["bitrate"] = settings.bitrate
    if settings.fd:
        options["fd"] = True
        if settings.data_bitrate is not None and settings.timing is None:
            options["data_bitrate"] = settings.data_bitrate
    if settings.timing is not None:
        options["timing"] = _timing(settings, settings.timing)
    if settings.filters:
        options["can_filters"] = [dict(rule) for rule in settings.filters]
    return options


def _timing(settings: BusSettings, given: Mapping[str, Any]) -> can.BitTiming | can.BitTimingFd:
    """Bit timing from its fields; with a sample point among them, by `from_sample_point`."""
    import can

    kind = can.BitTimingFd if settings.fd else can.BitTiming
    by_point = "sample_point" in given or "nom_sample_point" in given
    try:
        return kind.from_sample_point(**given) if by_point else kind(**given)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{settings}: timing: {one_line(error)}") from error


def _is_missing(error: BaseException) -> bool:
    """Whether an operating system error means that a driver is not installed, rather than a bus not plugged in."""
    text = str(error).lower()
    return isinstance(error, OSError) and ("library" in text or "shared object" in text or error.errno == 97)


def _needs(settings: BusSettings) -> str:
    needs = NEEDS.get(settings.interface)
    return f"; {settings.interface} needs {needs}" if needs else ""


def _enlarge_buffer(bus: can.BusABC) -> None:
    """Enlarge the SocketCAN buffer, which by default holds some 300 frames; without permission, nothing changes."""
    link = getattr(bus, "socket", None)
    if isinstance(link, socket.socket) and link.family == getattr(socket, "AF_CAN", None):
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
