"""Processes of this computer."""

from __future__ import annotations

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
