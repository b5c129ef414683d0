"""Lets a thread give way to those that fly."""

from __future__ import annotations

import os
from contextlib import suppress


def give_way() -> None:
    """Put the calling thread into the scheduler's batch class.

    It then never interrupts another thread when it has something to do, also where the program
    runs with a real-time priority, but keeps its full share when there is time. Where the system
    knows no such class, nothing happens.
    """
    if hasattr(os, "sched_setscheduler"):
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
