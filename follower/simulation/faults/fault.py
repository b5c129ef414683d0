"""What a fault is: what is done, from when on, for how long, and what must come of it.

Times are in seconds, lengths in metres. The limits hold for the flight of `follower faults`: a car
at 3.5 m/s, followed at 14 m with the supervisor's default time-outs, but a search of 2 s.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib import resources
from itertools import groupby
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import yaml
from pydantic import TypeAdapter

from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.link import LINK_KINDS

FLAVOURS = ("px4", "ardupilot")


class FaultKind(StrEnum):
    """One thing that can be made to go wrong; what `amount` means stands behind it."""

    VISION_DIES = "vision dies"
    VISION_HANGS = "vision hangs"
    VISION_SLOW = "vision slow"  # seconds a frame
    FRAMES_FROZEN = "frames frozen"
    FRAMES_BLACK = "frames black"
    FRAMES_SILENT = "no frames"
    FRAMES_LATE = "frames late"  # seconds
    FRAMES_REORDERED = "frames reordered"
    ATTITUDE_FROZEN = "attitude frozen"
    POSITION_FROZEN = "position frozen"
    TELEMETRY_STOPPED = "telemetry stopped"
    TELEMETRY_LATE = "telemetry late"  # seconds
    ATTITUDE_NAN = "attitude NaN"
    POSITION_NAN = "position NaN"
    POSITION_STOPPED = "position stopped"
    POSITION_JUMPS = "position jumps"  # metres
    YAW_JUMPS = "yaw jumps"  # radians
    LINK_DOWN = "link down"
    PACKETS_LOST = "packets lost"  # share
    PACKETS_DOUBLED = "packets doubled"  # share
    PACKETS_REORDERED = "packets reordered"  # share
    GARBAGE = "garbage"
    STRANGERS = "strangers"
    FUZZED = "fuzzed packets"
    FORGED_UNSIGNED = "forged, unsigned"
    FORGED_WRONG = "forged, wrong signature"
    REPLAYED = "replayed"
    AUTOPILOT_RESTARTS = "autopilot restarts"
    PILOT_SWITCHES = "pilot switches"
    PILOT_RETURNS = "pilot returns"
    MODE_REFUSED = "mode refused"
    OTHER_MODES_REFUSED = "other modes refused"
    ESTIMATOR_FAILSAFE = "estimator failsafe"
    ESTIMATOR_UNWELL = "estimator unwell"  # innovation over its limit
    BATTERY_LOW = "battery low"  # percent left
    STICK_MOVED = "stick moved"  # pulse, microseconds
    CLOCK_JUMPS = "autopilot's clock jumps"  # seconds
    CLOCK_SLOW = "autopilot's clock slow"  # seconds lost a second
    WALL_CLOCK_JUMPS = "wall clock jumps"  # seconds
    CONTROL_STALLS = "control stalls"
    CONTROL_STARVED = "control starved"  # longest pause, seconds
    DISK_FULL = "disk full"
    STOP_REQUESTED = "stop requested"
    CONSENT_WITHDRAWN = "consent withdrawn"
    PROCESS_SIGNALLED = "process signalled"  # the signal's number


class ExpectedOutcome(StrEnum):
    """How a flight with a fault must go on."""

    FOLLOWS_ON = "follows on"
    FOLLOWS_AGAIN = "holds, follows again"
    RELEASED = "holds, released"
    RELEASED_IN_MODE = "released, ends in a mode"
    PILOT_IN_CONTROL = "pilot in control"
    NEVER_FOLLOWS = "never follows"


class FaultSetup(NamedTuple):
    """How a fault is flown.

    Attributes:
        flavour: "px4" or "ardupilot".
        link: "pymavlink" or "mavsdk".
        realtime: with threads and UDP, not in lockstep.
    """

    flavour: str
    link: str = "pymavlink"
    realtime: bool = False


@dataclass(frozen=True, slots=True)
class FaultAction:
    """Part of a fault.

    Attributes:
        kind: what is done.
        amount: how much of it; see `FaultKind`.
        after_s: so long after the fault's begin.
        for_s: so long, None as long as the fault.
        state: and not before the supervisor is in this state, None at once.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    kind: FaultKind
    amount: float = 0.0
    after_s: float = 0.0
    for_s: float | None = None
    state: SupervisorState | None = None


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of the catalogue.

    Attributes:
        name: as the command line takes it.
        group: what it belongs to, for lists.
        must: the sentence: what must happen, and by when.
        outcome: the same in one phrase.
        actions: what is done.
        for_s: how long it lasts, infinity to the flight's end.
        state: it begins when the supervisor has been in this state for `in_state_s`, unless a time
            is given on the command line.
        in_state_s: see there; seconds.
        hold_within_s: from its begin to the first hold on the wire; None: no hold is wanted.
        rest_within_s: from its begin to the vehicle's standing still; likewise.
        excursion_m: how far the vehicle may go from where the fault began until it stands;
            likewise.
        back_within_s: from its end until it is followed again; likewise.
        lockstep: it can be put into a flight on a simulated clock.
        realtime: and into one in real time.
        signed: the link is signed.
        flavours: the autopilots with which it can come about.
        links: and the links.
        settings: that the follower flies with, `key.path=value` each.
        ends_in: the mode in which each autopilot must be at the fault's end.
        silent_within_s: from its begin to the last setpoint; None: they may go on.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    name: str
    group: str
    must: str
    outcome: ExpectedOutcome
    actions: tuple[FaultAction, ...]
    for_s: float = math.inf
    state: SupervisorState = SupervisorState.FOLLOWING
    in_state_s: float = 9.0
    hold_within_s: float | None = None
    rest_within_s: float | None = None
    excursion_m: float | None = None
    back_within_s: float | None = None
    lockstep: bool = True
    realtime: bool = True
    signed: bool = False
    flavours: tuple[str, ...] = FLAVOURS
    links: tuple[str, ...] = LINK_KINDS
    settings: tuple[str, ...] = ()
    ends_in: dict[str, str] = field(default_factory=dict, hash=False)
    silent_within_s: float | None = None

    def flies(self, setup: FaultSetup) -> bool:
        """Whether it can come about there."""
        timed = self.realtime if setup.realtime else self.lockstep and setup.link != "mavsdk"
        return timed and setup.flavour in self.flavours and setup.link in self.links

    @property
    def signal(self) -> int | None:
        """The signal that the follower's process gets, None if it gets none."""
        signals = (a.amount for a in self.actions if a.kind is FaultKind.PROCESS_SIGNALLED)
        return next(map(int, signals), None)

    @property
    def needs_recorder(self) -> bool:
        """Whether there is nothing to see without a recording."""
        return any(action.kind is FaultKind.DISK_FULL for action in self.actions)


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
