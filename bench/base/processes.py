"""Processes of this computer, and whose they are."""

from __future__ import annotations

import getpass
import os


def process_alive(pid: int) -> bool:
    """Whether there is such a process, ours or somebody else's."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it is somebody else's
        return True
    return pid > 0


def user_name() -> str:
    """The user of this process; `unknown` in a container without a name for its user."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "unknown"
