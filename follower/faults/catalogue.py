"""All faults by name."""

from __future__ import annotations

from collections.abc import Iterable

from follower.faults.fault import Fault
from follower.faults.groups.autopilot import AUTOPILOT
from follower.faults.groups.computer import COMPUTER
from follower.faults.groups.frames import FRAMES
from follower.faults.groups.link import LINK
from follower.faults.groups.pilot import PILOT
from follower.faults.groups.process import PROCESS
from follower.faults.groups.release import RELEASE
from follower.faults.groups.telemetry import TELEMETRY
from follower.faults.groups.vision import VISION

CATALOGUE: tuple[Fault, ...] = (
    *VISION,
    *FRAMES,
    *TELEMETRY,
    *LINK,
    *AUTOPILOT,
    *PILOT,
    *RELEASE,
    *COMPUTER,
    *PROCESS,
)


def fault_named(name: str) -> Fault:
    """Return a fault of the catalogue.

    Raises:
        ValueError: there is none of that name.
    """
    for fault in CATALOGUE:
        if fault.name == name:
            return fault
    raise ValueError(f"there is no fault {name!r}; `follower faults list` shows them")


def in_groups(faults: Iterable[Fault] = CATALOGUE) -> dict[str, list[Fault]]:
    """Return the faults by their groups, in the catalogue's order."""
    groups: dict[str, list[Fault]] = {}
    for fault in faults:
        groups.setdefault(fault.group, []).append(fault)
    return groups
