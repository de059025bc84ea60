"""Waiting for another process."""

import time
from collections.abc import Callable
from typing import Any

import pytest

PATIENCE_S = 120.0
"""Ends only a test that has failed."""
OFTEN_S, SELDOM_S = 0.01, 0.2
"""Time between two questions at first and after a while: each keeps a processor from what is waited for."""


def until(condition: Callable[[], Any]) -> Any:
    """The first true answer of `condition`, asked again and again."""
    end_s, pause_s = time.monotonic() + PATIENCE_S, OFTEN_S
    while time.monotonic() < end_s:
        if found := condition():
            return found
        time.sleep(pause_s)
        pause_s = min(1.2 * pause_s, SELDOM_S)
    return pytest.fail(f"never came true: {condition}")
