"""Waiting for another process."""

import time
from collections.abc import Callable
from typing import Any

import pytest

PATIENCE_S = 120.0
"""Ends only a test that has failed."""


def until(condition: Callable[[], Any]) -> Any:
    """The first true answer of `condition`, asked again and again."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if found := condition():
            return found
        time.sleep(0.02)
    return pytest.fail(f"never came true: {condition}")
