"""What operating systems do differently: locks of files, and folders that are forced to the disk."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS = fcntl is not None
"""Whether `hold` keeps other processes out; without, only one bench may work in a folder."""


def hold(file: IO[Any] | int, *, shared: bool = False, wait: bool = False) -> bool:
    """Lock an open file until it is closed, or its process ends; False where another process holds it.

    `shared`: with others that share it; `wait`: until it is free. True, too, where the file system has no locks.
    """
    if fcntl is None:
        return True
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    with suppress(OSError):
        try:
            fcntl.flock(file, kind if wait else kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def end_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that leads a session of its own, with what it started; on Windows the process alone."""
    if hasattr(os, "killpg"):
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()


def sync_folder(folder: Path) -> None:
    """Force the names of a folder to the disk: a file that was renamed survives a power cut. OSError."""
    if os.name == "nt":  # it opens no folders, and keeps the order of names itself
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
