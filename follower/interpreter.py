"""Python's own pauses, kept short while a vehicle is steered."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SWITCH_INTERVAL_S = 0.0005
"""Python hands the interpreter from thread to thread this often; its own 5 ms would show as
jitter of the control loop while vision runs Python code."""
_NEVER = 1_000_000_000
_MANY_NEW = 100_000
"""So many new objects are looked through at a time, where pauses do not matter."""


@contextmanager
def short_pauses() -> Iterator[None]:
    """Switch threads often, and look through old objects for cyclic garbage only afterwards.

    Such a look stops every thread for as long as it takes, and it takes longer the more a flight
    has noted down: 0.13 s after some minutes. What is young is still looked through.
    """
    interval_s, thresholds = sys.getswitchinterval(), gc.get_threshold()
    gc.collect()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    gc.set_threshold(*thresholds[:2], _NEVER)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
        sys.setswitchinterval(interval_s)


@contextmanager
def few_collections() -> Iterator[None]:
    """Look for cyclic garbage seldom, for what keeps most of the objects that it makes."""
    before = gc.get_threshold()
    gc.set_threshold(_MANY_NEW, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
