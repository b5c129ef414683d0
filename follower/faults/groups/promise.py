"""How most faults go on, with the limits that this means. Times are in seconds, lengths in metres.

The limits hold for the flight of `follower faults`: a car at 3.5 m/s, followed at 14 m with the
supervisor's time-outs as they are set by default, but a search of 2 s.
"""

from __future__ import annotations

from typing import Any

from follower.faults.fault import Action, Fault, Outcome

_HOLD_SOON: dict[str, Any] = {
    "hold_within_s": 0.7,
    "rest_within_s": 7.0,
    "excursion_m": 13.0,
}
"""What is noticed by a time-out of half a second. PX4 takes its time with the last half metre a
second, also in its own Hold."""


def lets_go(name: str, group: str, must: str, *actions: Action, **more: Any) -> Fault:
    """Return a fault after which the vehicle is held and let go."""
    return Fault(name, group, must, Outcome.LETS_GO, actions, **{**_HOLD_SOON, **more})


def carries_on(name: str, group: str, must: str, *actions: Action, **more: Any) -> Fault:
    """Return a fault in spite of which the target is followed on."""
    return Fault(name, group, must, Outcome.CARRIES_ON, actions, **{"for_s": 4.0, **more})


def comes_back(name: str, group: str, must: str, *actions: Action, **more: Any) -> Fault:
    """Return a fault after which the target is followed again."""
    limits = {"hold_within_s": 0.7, "back_within_s": 3.0, **more}
    return Fault(name, group, must, Outcome.COMES_BACK, actions, **limits)


def pilot_has_it(name: str, must: str, *actions: Action, **more: Any) -> Fault:
    """Return a fault after which the vehicle is the pilot's, or its autopilot's."""
    return Fault(name, "pilot", must, Outcome.PILOT_HAS_IT, actions, **more)
