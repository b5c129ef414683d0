"""When which fault is on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from follower.faults.fault import Action, Kind
from follower.faults.planned import PlannedFault
from follower.supervisor import State

_AFTERWARDS_S = 3.0


class FaultSchedule:
    """Starts faults by the time and the supervisor's state; asked by those that carry them out.

    `observe` is called by one thread, the rest by any.
    """

    def __init__(self, planned: Iterable[PlannedFault]) -> None:
        self._courses = tuple(_Course(one) for one in planned)

    def observe(self, now_s: float, state: State, in_state_s: float) -> None:
        """Look whether something begins now."""
        for course in self._courses:
            course.observe(now_s, state, in_state_s)

    def active(self, kind: Kind, now_s: float) -> Action | None:
        """Return the action of this kind that is on, None if none is."""
        for course in self._courses:
            action = course.active(kind, now_s)
            if action is not None:
                return action
        return None

    def begun(self, kind: Kind, now_s: float) -> Action | None:
        """Return the action of this kind whose begin has passed, even if it is over."""
        for course in self._courses:
            action = course.begun(kind, now_s)
            if action is not None:
                return action
        return None

    def end_of(self, kind: Kind, now_s: float) -> float:
        """Return when the action of this kind that is on will be over; now, if none is."""
        return max((course.end_of(kind, now_s) for course in self._courses), default=now_s)

    def is_over(self, now_s: float) -> bool:
        """Whether nothing that was begun is still to end, some seconds for a look included."""
        return all(course.is_over(now_s) for course in self._courses)

    def plans(self, kind: Kind) -> bool:
        """Whether an action of this kind is on, was, or will be."""
        faults = (course.planned.fault for course in self._courses)
        return any(action.kind is kind for fault in faults for action in fault.actions)

    def is_past(self, now_s: float) -> bool:
        """Whether every fault has begun and, some seconds for a look included, ended."""
        return all(course.is_past(now_s) for course in self._courses)

    @property
    def spans(self) -> Sequence[tuple[PlannedFault, float, float]]:
        """The faults that have begun: (fault, begin, end)."""
        return [
            (course.planned, course.from_s, course.until_s)
            for course in self._courses
            if course.from_s is not None
        ]


class _Course:
    """One fault's course in time."""

    def __init__(self, planned: PlannedFault) -> None:
        self.planned = planned
        self.from_s: float | None = None
        self._since: dict[Action, float] = {}

    @property
    def until_s(self) -> float:
        return math.inf if self.from_s is None else self.from_s + self.planned.for_s

    def observe(self, now_s: float, state: State, in_state_s: float) -> None:
        if self.from_s is None and self._is_due(now_s, state, in_state_s):
            self.from_s = now_s
        if self.from_s is None:
            return
        for action in self.planned.fault.actions:
            if action not in self._since and action.state in (None, state):
                begin_s = self.from_s if action.state is None else now_s
                # Replaced as a whole: other threads look through it meanwhile.
                self._since = {**self._since, action: begin_s + action.after_s}

    def active(self, kind: Kind, now_s: float) -> Action | None:
        for action, since_s in self._since.items():
            if action.kind is kind and since_s <= now_s < self._end_s(action):
                return action
        return None

    def end_of(self, kind: Kind, now_s: float) -> float:
        action = self.active(kind, now_s)
        return now_s if action is None else self._end_s(action)

    def _end_s(self, action: Action) -> float:
        return self.until_s if action.for_s is None else self._since[action] + action.for_s

    def begun(self, kind: Kind, now_s: float) -> Action | None:
        for action, since_s in self._since.items():
            if action.kind is kind and since_s <= now_s:
                return action
        return None

    def is_over(self, now_s: float) -> bool:
        if self.from_s is None or math.isinf(self.planned.for_s):
            return True
        return now_s > self.until_s + _AFTERWARDS_S

    def is_past(self, now_s: float) -> bool:
        return self.from_s is not None and now_s > self.until_s + _AFTERWARDS_S

    def _is_due(self, now_s: float, state: State, in_state_s: float) -> bool:
        if self.planned.at_s is not None:
            return now_s >= self.planned.at_s
        fault = self.planned.fault
        return state is fault.state and in_state_s >= fault.in_state_s
