"""When which fault is on."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from follower.flight.supervision.supervisor import SupervisorState
from follower.simulation.faults.fault import Fault, FaultAction, FaultKind, fault_named
from follower_control.common.strict_config import SettingsError

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
        except ValueError as error:
            raise SettingsError(f"--fault {text}: {error}") from None
        at_s = None if match[2] is None else float(match[2])
        for_s = fault.for_s if match[3] is None else float(match[3])
        return cls(fault, at_s, for_s)

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
