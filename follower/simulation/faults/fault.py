"""What a fault is: what is done, from when on, for how long, and what must come of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from follower.supervisor import State

FLAVOURS = ("px4", "ardupilot")
LINKS = ("pymavlink", "mavsdk")


class Kind(StrEnum):
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


class Outcome(StrEnum):
    """How a flight with a fault must go on."""

    CARRIES_ON = "follows on"
    COMES_BACK = "holds, follows again"
    LETS_GO = "holds, lets go"
    PILOT_HAS_IT = "pilot has it"
    NEVER_FOLLOWS = "never follows"
    ENDS_IN_MODE = "holds, lets go, ends in a mode"


@dataclass(frozen=True, slots=True)
class Action:
    """Part of a fault.

    Attributes:
        kind: what is done.
        amount: how much of it; see `Kind`.
        after_s: so long after the fault's begin.
        for_s: so long, None as long as the fault.
        state: and not before the supervisor is in this state, None at once.
    """

    kind: Kind
    amount: float = 0.0
    after_s: float = 0.0
    for_s: float | None = None
    state: State | None = None


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of the catalogue.

    Attributes:
        name: as the command line takes it.
        group: what it belongs to, for lists.
        must: the sentence: what must happen, and by when.
        outcome: the same in one word.
        actions: what is done.
        for_s: how long it lasts, infinity to the flight's end.
        state: it begins when the supervisor has been in this state for `in_state_s`, unless a time
            is given on the command line.
        in_state_s: see there.
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
        silent_within_s: from its begin to the last set-point; None: they may go on.
    """

    name: str
    group: str
    must: str
    outcome: Outcome
    actions: tuple[Action, ...]
    for_s: float = math.inf
    state: State = State.FOLLOWING
    in_state_s: float = 9.0
    hold_within_s: float | None = None
    rest_within_s: float | None = None
    excursion_m: float | None = None
    back_within_s: float | None = None
    lockstep: bool = True
    realtime: bool = True
    signed: bool = False
    flavours: tuple[str, ...] = FLAVOURS
    links: tuple[str, ...] = LINKS
    settings: tuple[str, ...] = ()
    ends_in: tuple[tuple[str, str], ...] = ()
    silent_within_s: float | None = None

    def flies(self, flavour: str, link: str, realtime: bool) -> bool:
        """Whether it can come about there."""
        timed = self.realtime if realtime else self.lockstep and link != "mavsdk"
        return timed and flavour in self.flavours and link in self.links

    @property
    def signal(self) -> int | None:
        """The signal that the follower's process gets, None if it gets none."""
        kinds = {action.kind: action for action in self.actions}
        action = kinds.get(Kind.PROCESS_SIGNALLED)
        return None if action is None else int(action.amount)

    @property
    def needs_recorder(self) -> bool:
        """Whether there is nothing to see without a recording."""
        return any(action.kind is Kind.DISK_FULL for action in self.actions)
