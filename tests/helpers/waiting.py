"""Waiting for what other threads and processes do."""

import time
from collections.abc import Callable
from typing import Any


def until(condition: Callable[[], Any], within_s: float = 60.0) -> Any:
    """Return what is so as soon as it is; fail if it does not come about."""
    end_s = time.monotonic() + within_s
    while not (found := condition()):
        assert time.monotonic() < end_s, "it did not come about"
        time.sleep(0.02)
    return found
