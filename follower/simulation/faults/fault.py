"""What a fault is: what is done, from when on, for how long, and what must come of it.

Times are in seconds, lengths in metres. The limits hold for the flight of `follower faults`: a car
at 3.5 m/s, followed at 14 m with the supervisor's default time-outs, but a search of 2 s.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
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
from follower_control.common.strict_config import SettingsError

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
        SettingsError: there is none of that name.
    """
    for fault in catalogue():
        if fault.name == name:
            return fault
    raise SettingsError(f"there is no fault {name!r}; `follower faults list` shows them")


def in_groups() -> dict[str, list[Fault]]:
    """Return the faults by their groups, in the catalogue's order."""
    groups = groupby(catalogue(), attrgetter("group"))
    return {name: list(faults) for name, faults in groups}


_TEXT = re.compile(r"([^@:\s]+)(?:@(\d+(?:\.\d*)?))?(?::(\d+(?:\.\d*)?))?")


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A fault and when it comes.

    Attributes:
        fault: which.
        at_s: time of the scenario in seconds, None when the fault itself says so.
        for_s: how long, in seconds.
    """

    fault: Fault
    at_s: float | None
    for_s: float

    @classmethod
    def of(cls, fault: Fault) -> PlannedFault:
        """Plan a fault as the catalogue says."""
        return cls(fault, None, fault.for_s)

    @classmethod
    def parse(cls, text: str) -> PlannedFault:
        """Read `NAME`, `NAME@time` or `NAME@time:duration`, in seconds.

        Raises:
            SettingsError: it is none of them.
        """
        match = _TEXT.fullmatch(text)
        if match is None:
            raise SettingsError(f"--fault {text}: write NAME, NAME@time or NAME@time:duration")
        try:
            fault = fault_named(match[1])
        except SettingsError as error:
            raise SettingsError(f"--fault {text}: {error}") from None
        at_s = None if match[2] is None else float(match[2])
        for_s = fault.for_s if match[3] is None else float(match[3])
        if for_s == 0:
            raise SettingsError(
                f"--fault {text}: the duration is 0 s, so that nothing would happen"
            )
        return cls(fault, at_s, for_s)

    def check_begins_by(self, end_s: float) -> None:
        """Refuse a fault that would never come, in a flight that ends at `end_s`.

        Raises:
            SettingsError: it begins later.
        """
        if self.at_s is not None and self.at_s >= end_s:
            raise SettingsError(
                f"--fault {self}: the flight ends at {end_s:g} s; give an earlier time, or "
                f"--scene duration_s={math.ceil(self.at_s + self._shown_s)}"
            )

    @property
    def _shown_s(self) -> float:
        """For how long it is worth watching, in seconds."""
        return _AFTERWARDS_S + (self.for_s if math.isfinite(self.for_s) else 0.0)

    def __str__(self) -> str:
        at = "" if self.at_s is None else f"@{self.at_s:g}"
        changed = self.for_s != self.fault.for_s and math.isfinite(self.for_s)
        return self.fault.name + at + (f":{self.for_s:g}" if changed else "")


_AFTERWARDS_S = 3.0


class FaultSchedule:
    """Starts faults by the time and the supervisor's state; asked by those that carry them out.

    `observe` is called by one thread, the rest by any. Times are seconds on the flight's clock.
    """

    def __init__(self, planned: Iterable[PlannedFault]) -> None:
        self._courses = tuple(_Course(one) for one in planned)

    def observe(self, now_s: float, state: SupervisorState, in_state_s: float) -> None:
        """Begin what is due at `now_s`, after `in_state_s` seconds in the supervisor's state."""
        for course in self._courses:
            course.observe(now_s, state, in_state_s)

    def active(self, kind: FaultKind, now_s: float) -> FaultAction | None:
        """Return the action of this kind that is on, None if none is."""
        actions = self._actions_of(kind)
        return next((one for one, from_s, to_s in actions if from_s <= now_s < to_s), None)

    def begun(self, kind: FaultKind, now_s: float) -> FaultAction | None:
        """Return the action of this kind whose begin has passed, even if it is over."""
        return next((one for one, from_s, _ in self._actions_of(kind) if from_s <= now_s), None)

    def begins(self, kind: FaultKind, now_s: float) -> int:
        """Return how many actions of this kind have begun until `now_s`, seconds."""
        return sum(from_s <= now_s for _, from_s, _ in self._actions_of(kind))

    def end_of(self, kind: FaultKind, now_s: float) -> float:
        """Return when, in seconds, the action of this kind that is on ends; now, if none is."""
        actions = self._actions_of(kind)
        return max((to_s for _, from_s, to_s in actions if from_s <= now_s < to_s), default=now_s)

    def is_over(self, now_s: float) -> bool:
        """Whether nothing that was begun is still to end, some seconds of observation included."""
        lasting = (to_s for _, _, to_s in self.spans if math.isfinite(to_s))
        return all(now_s > to_s + _AFTERWARDS_S for to_s in lasting)

    def is_past(self, now_s: float) -> bool:
        """Whether every fault has begun and, some seconds of observation included, ended."""
        return all(now_s > course.until_s + _AFTERWARDS_S for course in self._courses)

    def plans(self, kind: FaultKind) -> bool:
        """Whether an action of this kind is on, was, or will be."""
        faults = (course.planned.fault for course in self._courses)
        return any(action.kind is kind for fault in faults for action in fault.actions)

    @property
    def spans(self) -> Sequence[tuple[PlannedFault, float, float]]:
        """The faults that have begun: (fault, begin, end), both in seconds."""
        return [
            (course.planned, course.from_s, course.until_s)
            for course in self._courses
            if course.from_s is not None
        ]

    def _actions_of(self, kind: FaultKind) -> Iterator[tuple[FaultAction, float, float]]:
        """Yield the actions of a kind that have their times: (action, begin, end), in seconds."""
        for course in self._courses:
            for action, since_s in course.since_s.items():
                if action.kind is kind:
                    end_s = course.until_s if action.for_s is None else since_s + action.for_s
                    yield action, since_s, end_s


@dataclass
class _Course:
    """One fault's course in time."""

    planned: PlannedFault
    from_s: float | None = None
    since_s: dict[FaultAction, float] = field(default_factory=dict)

    @property
    def until_s(self) -> float:
        return math.inf if self.from_s is None else self.from_s + self.planned.for_s

    def observe(self, now_s: float, state: SupervisorState, in_state_s: float) -> None:
        if self.from_s is None and self._is_due(now_s, state, in_state_s):
            self.from_s = now_s
        if self.from_s is None:
            return
        for action in self.planned.fault.actions:
            if action not in self.since_s and action.state in (None, state):
                begin_s = self.from_s if action.state is None else now_s
                # Replaced as a whole: other threads look through it meanwhile.
                self.since_s = {**self.since_s, action: begin_s + action.after_s}

    def _is_due(self, now_s: float, state: SupervisorState, in_state_s: float) -> bool:
        if self.planned.at_s is not None:
            return now_s >= self.planned.at_s
        fault = self.planned.fault
        return state is fault.state and in_state_s >= fault.in_state_s
