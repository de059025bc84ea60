"""Processes of this computer, and whose they are."""

from __future__ import annotations

import getpass
import os
from pathlib import Path

from drivers.system import hold, sync_folder

__all__ = ["hold", "locked", "process_alive", "sync_folder", "user_name"]


def process_alive(pid: int) -> bool:
    """Whether there is such a process, ours or somebody else's."""
    if os.name == "nt":  # a signal, be it 0, would reach the process there
        import psutil

        return bool(psutil.pid_exists(pid))
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it is somebody else's
        return True
    return pid > 0


def locked(file: Path) -> bool:
    """Whether a process holds the lock of this file for itself; a file that cannot be opened has none."""
    try:
        with file.open("rb") as opened:
            return not hold(opened, shared=True)
    except OSError:
        return False


OPERATOR = "BENCH_OPERATOR"
"""Environment variable that names who works at the bench, where it is not the user of the process."""


def user_name() -> str:
    """Who works with this process: as `BENCH_OPERATOR` says, else its user; `unknown` where neither has a name."""
    if name := os.environ.get(OPERATOR):
        return name
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "unknown"
