"""Processes of this computer, and whose they are."""

from __future__ import annotations

import getpass
import os
from pathlib import Path


def process_alive(pid: int) -> bool:
    """Whether there is such a process, ours or somebody else's."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it is somebody else's
        return True
    return pid > 0


def locked(file: Path) -> bool:
    """Whether a process holds the lock of this file for itself; a file that cannot be opened has none."""
    import fcntl  # POSIX alone has it, and this module is imported everywhere

    try:
        with file.open("rb") as opened:
            fcntl.flock(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def user_name() -> str:
    """The user of this process; `unknown` in a container without a name for its user."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "unknown"
