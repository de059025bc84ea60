"""One bench at a chamber: a claim on its address, on this computer, that goes with the processes that hold it.

A bench on another computer is not seen by this; the guard "operator override" sees what it commands.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from bench.acquisition.station.settings.chamber import Connection
from bench.base import InputError
from drivers.system import HAS_LOCKS, hold

FOLDER = "bench-chambers"
"""In the computer's folder for temporary files, for all users."""


def address(connection: Connection) -> str:
    """The chamber's address, the same however it is written: a controller on a gateway, or a serial line."""
    parts = urlsplit(connection.url)
    if not parts.hostname:
        return os.path.realpath(parts.path)
    host = parts.hostname
    with contextlib.suppress(OSError):
        host = socket.gethostbyname(host)
    return f"{host}:{parts.port or 502}/{connection.device}"


@contextmanager
def claimed(connection: Connection) -> Iterator[int]:
    """Keep every other bench of this computer from a chamber; InputError where one is at it. The claim's descriptor.

    A process that is given the descriptor, such as a watchdog, keeps the claim when this one is killed.
    """
    where = address(connection)
    if not HAS_LOCKS:
        text = "this system has no locks by which a chamber is claimed: run real equipment from Linux or macOS"
        raise InputError(f"{text}; nothing was moved")
    path = Path(tempfile.gettempdir()) / FOLDER / hashlib.sha256(where.encode()).hexdigest()[:16]
    handle = _open(path, where)
    try:
        if not hold(handle):
            holder = os.pread(handle, 200, 0).decode(errors="replace").strip() or "another process"
            text = f"chamber {connection.url} ({where}) is in use by {holder}"
            raise InputError(f"{text}; end that run first (`bench status`, `bench abort`); nothing was moved")
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"process {os.getpid()}, or its watchdog\n".encode(), 0)
        yield handle
    finally:
        os.close(handle)


def _open(path: Path, where: str) -> int:
    """The file that stands for an address, which every user may lock."""
    try:
        with contextlib.suppress(FileExistsError):
            path.parent.mkdir()
            path.parent.chmod(0o1777)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise InputError(f"cannot claim the chamber at {where}: {error.strerror}", path) from None
    with contextlib.suppress(OSError):  # the file is another user's
        os.fchmod(handle, 0o666)
    return handle
