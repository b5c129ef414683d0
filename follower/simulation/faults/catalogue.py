"""All faults by name, read from `catalogue.yaml`."""

from functools import cache
from importlib import resources
from itertools import groupby
from operator import attrgetter
from typing import Any

import yaml
from pydantic import TypeAdapter

from follower.simulation.faults.fault import ExpectedOutcome, Fault

_USUAL: dict[str, dict[str, float]] = {
    ExpectedOutcome.FOLLOWS_ON: {"for_s": 4.0},
    ExpectedOutcome.FOLLOWS_AGAIN: {"hold_within_s": 0.7, "back_within_s": 3.0},
    # What a time-out of half a second notices. PX4 takes its time with the last half metre a
    # second, also in its own Hold.
    ExpectedOutcome.RELEASED: {"hold_within_s": 0.7, "rest_within_s": 7.0, "excursion_m": 13.0},
    ExpectedOutcome.RELEASED_IN_MODE: {"for_s": 10.0, "hold_within_s": 0.1},
}
"""What each outcome usually means in seconds and metres."""


@cache
def catalogue() -> tuple[Fault, ...]:
    """Return all faults in the order of the file.

    Raises:
        ValueError: the file does not describe faults.
    """
    text = resources.files(__package__).joinpath("catalogue.yaml").read_text("utf-8")
    faults = [
        _with_usual_limits({"name": name, "group": group, **given})
        for group, members in yaml.safe_load(text).items()
        for name, given in members.items()
    ]
    return TypeAdapter(tuple[Fault, ...]).validate_python(faults)


def _with_usual_limits(given: dict[str, Any]) -> dict[str, Any]:
    """Return what the file says of a fault on top of its outcome's usual limits."""
    actions = [{"kind": one} if isinstance(one, str) else one for one in given["actions"]]
    return {**_USUAL.get(given["outcome"], {}), **given, "actions": actions}


def fault_named(name: str) -> Fault:
    """Return a fault of the catalogue.

    Raises:
        ValueError: there is none of that name.
    """
    for fault in catalogue():
        if fault.name == name:
            return fault
    raise ValueError(f"there is no fault {name!r}; `follower faults list` shows them")


def in_groups() -> dict[str, list[Fault]]:
    """Return the faults by their groups, in the catalogue's order."""
    groups = groupby(catalogue(), attrgetter("group"))
    return {name: list(faults) for name, faults in groups}
