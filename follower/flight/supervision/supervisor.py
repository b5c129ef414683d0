"""Who may move the vehicle, and when: one pure function of the state and the situation.

| state     | meaning                                              | setpoints          |
|-----------|------------------------------------------------------|--------------------|
| IDLE      | no target is chosen                                  | none               |
| TRACKING  | a target is chosen; something else is not yet good   | none               |
| READY     | all is good but the mode or the consent              | hold               |
| FOLLOWING | the pilot's mode and consent allow it, all is good   | servo              |
| COASTING  | the target was not seen for a moment                 | servo, slowing down|
| SEARCHING | the target is lost                                   | turn after it      |
| HOLDING   | something is wrong, or the search took too long      | hold               |
| RELEASED  | let go; only a new consent begins again              | hold, while heard  |

In IDLE, TRACKING and READY, and in RELEASED once consent is renewed, the first row that applies
decides; in RELEASED without that, none does and it stays:

| situation                                   | next state | reason                    |
|---------------------------------------------|------------|---------------------------|
| stop was asked for                          | RELEASED   | stop requested            |
| our mode, held by our stream, was left      | RELEASED   | pilot took over           |
| it may have been: nothing heard, nothing    | RELEASED   | link lost, not heard,     |
| answered or no control step for `alone_s`   |            | control stalled           |
| a stick that took over is still held        | RELEASED   | pilot moved the sticks    |
| no target is chosen                         | IDLE       | no target                 |
| one of the troubles below                   | TRACKING   | its own                   |
| the target is not seen, or the estimate bad | TRACKING   | target unseen             |
| disarmed or landed                          | TRACKING   | not flying                |
| the autopilot is in a failsafe              | TRACKING   | autopilot's failsafe      |
| too little battery to begin                 | TRACKING   | battery low               |
| the pilot's mode does not allow following   | READY      | waiting for the mode      |
| the second consent is not given             | READY      | waiting for consent       |
| none of these                               | FOLLOWING  | target seen               |

In FOLLOWING, COASTING, SEARCHING and HOLDING:

| situation                                   | next state | reason                    |
|---------------------------------------------|------------|---------------------------|
| stop was asked for                          | RELEASED   | stop requested            |
| not the mode any more, in a failsafe        | RELEASED   | autopilot's failsafe      |
| not the mode any more                       | RELEASED   | pilot took over           |
| a stick was moved far                       | RELEASED   | pilot moved the sticks    |
| the second consent was withdrawn            | RELEASED   | consent withdrawn         |
| disarmed or landed                          | RELEASED   | not flying                |
| nothing at all heard for `alone_s`          | RELEASED   | link lost                 |
| nothing answered for `alone_s`              | RELEASED   | not heard                 |
| the control loop stood still for `alone_s`  | RELEASED   | control stalled           |
| too little battery to go on                 | RELEASED   | battery low               |
| one of the next two, HOLDING for `hold_s`   | RELEASED   | hold timed out            |
| a trouble                                   | HOLDING    | its own                   |
| no target is chosen any more                | HOLDING    | no target                 |
| target seen, estimate good                  | FOLLOWING  | target seen               |
| HOLDING for `hold_s`                        | RELEASED   | hold timed out            |
| HOLDING, unseen for `search_s`              | HOLDING    | search failed             |
| HOLDING                                     | HOLDING    | target unseen             |
| SEARCHING for `search_s`                    | HOLDING    | search failed             |
| not SEARCHING, estimate good, unseen for    | COASTING   | target unseen             |
| less than `coast_s`                         |            |                           |
| none of these                               | SEARCHING  | target lost               |

The troubles, in their order:

| trouble                                     | reason                    |
|---------------------------------------------|---------------------------|
| no heartbeat for `link_timeout_s`           | link silent               |
| attitude or position older than allowed     | telemetry stale           |
| no frame for `frame_timeout_s`              | frames stale              |
| the control loop itself came late           | control late              |
| estimator or GPS of the autopilot not well  | navigation poor           |
| no cockpit in control, if one has to be     | cockpit lost              |

HOLDING returns to FOLLOWING when its cause has gone before `hold_s` is over: the pilot's consent
still stands. RELEASED never returns by itself. After `alone_s` without a word either way, or
without a step of ours, the autopilot may have gone home and come back into our mode by itself: that
is no consent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar

from follower.situation import Situation


class State(StrEnum):
    """The supervisor's states."""

    IDLE = "idle"
    TRACKING = "tracking"
    READY = "ready"
    FOLLOWING = "following"
    COASTING = "coasting"
    SEARCHING = "searching"
    HOLDING = "holding"
    RELEASED = "released"

    @property
    def engaged(self) -> bool:
        """Whether the vehicle flies by our setpoints, so that leaving needs a hold."""
        return self in ENGAGED

    @property
    def steers(self) -> bool:
        """Whether the servo's output is sent."""
        return self in (State.FOLLOWING, State.COASTING)

    @property
    def streams(self) -> bool:
        """Whether setpoints are sent at all. PX4 wants the stream before it enters OFFBOARD."""
        return self is State.READY or self.engaged


ENGAGED = frozenset({State.FOLLOWING, State.COASTING, State.SEARCHING, State.HOLDING})


class Reason(StrEnum):
    """Why the supervisor is where it is."""

    NO_TARGET = "no target"
    TARGET_CHOSEN = "target chosen"
    LINK_SILENT = "link silent"
    TELEMETRY_STALE = "telemetry stale"
    FRAMES_STALE = "frames stale"
    CONTROL_LATE = "control late"
    NAVIGATION_POOR = "navigation poor"
    COCKPIT_LOST = "cockpit lost"
    BATTERY_LOW = "battery low"
    NOT_FLYING = "not flying"
    TARGET_UNSEEN = "target unseen"
    TARGET_LOST = "target lost"
    AUTOPILOT_FAILSAFE = "autopilot's failsafe"
    WAITING_FOR_PILOT = "waiting for the pilot's mode"
    WAITING_FOR_CONSENT = "waiting for consent"
    TARGET_SEEN = "target seen"
    SEARCH_FAILED = "search failed"
    HOLD_TIMED_OUT = "hold timed out"
    PILOT_TOOK_OVER = "pilot took over"
    STICKS_MOVED = "pilot moved the sticks"
    CONSENT_WITHDRAWN = "consent withdrawn"
    LINK_LOST = "link lost"
    NOT_HEARD = "not heard by the autopilot"
    CONTROL_STALLED = "control stalled"
    STOP_REQUESTED = "stop requested"
    AWAITING_CONSENT = "let go, waiting for consent"


@dataclass(frozen=True, slots=True)
class SupervisorSettings:
    """How long each trouble is borne, in seconds, and how good a prediction is flown by.

    Attributes:
        link_timeout_s: silence of the autopilot's heartbeat (sent at 1 Hz).
        telemetry_timeout_s: age of attitude or position.
        frame_timeout_s: age of the newest frame that vision has answered for.
        control_timeout_s: time between two control steps.
        coast_s: how long to fly on the predicted target, ...
        coast_within_deg: ... while the standard deviation of its direction is smaller. More than
            5 degrees is for targets that are known to go on as they did behind what hides them;
            how fast is then flown is limited by `envelope.trust`, and how long there is an
            estimate at all by `estimator.restart_after_s`.
        search_s: how long to look for a lost target.
        hold_s: how long to hold before letting go.
        alone_s: without a word from us for so long the autopilot may act by itself; below PX4's
            COM_OF_LOSS_T and ArduCopter's GUID_TIMEOUT.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    link_timeout_s: float = 3.0
    telemetry_timeout_s: float = 0.5
    frame_timeout_s: float = 0.5
    control_timeout_s: float = 0.2
    coast_s: float = 0.8
    coast_within_deg: float = 5.0
    search_s: float = 10.0
    hold_s: float = 3.0
    alone_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.coast_within_deg <= 180:
            raise ValueError(f"coast_within_deg lies within 180, not {self.coast_within_deg}")
        for name in (name for name in self.__slots__ if name.endswith("_s")):
            if not 0 < getattr(self, name) < 3600:
                raise ValueError(f"{name} is a time in seconds above 0, not {getattr(self, name)}")


def next_state(
    state: State, situation: Situation, settings: SupervisorSettings
) -> tuple[State, Reason]:
    """Return the state to be in now, and why; the tables above. Pure."""
    if state is State.RELEASED and not situation.consent_renewed:
        return State.RELEASED, Reason.AWAITING_CONSENT
    if state.engaged:
        return _while_engaged(state, situation, settings)
    return _before_engaged(situation, settings)


def _before_engaged(situation: Situation, settings: SupervisorSettings) -> tuple[State, Reason]:
    if situation.stop_requested:
        return State.RELEASED, Reason.STOP_REQUESTED
    if situation.mode_left:
        return State.RELEASED, Reason.PILOT_TOOK_OVER
    alone = _alone(situation, settings)
    if situation.stream_held and alone is not None:
        return State.RELEASED, alone
    if situation.sticks_moved:
        return State.RELEASED, Reason.STICKS_MOVED
    if not situation.target_chosen:
        return State.IDLE, Reason.NO_TARGET
    trouble = _trouble(situation, settings)
    if trouble is not None:
        return State.TRACKING, trouble
    if not _target_seen(situation):
        return State.TRACKING, Reason.TARGET_UNSEEN
    if not situation.flying:
        return State.TRACKING, Reason.NOT_FLYING
    if situation.failsafe:
        return State.TRACKING, Reason.AUTOPILOT_FAILSAFE
    if situation.battery_low:
        return State.TRACKING, Reason.BATTERY_LOW
    if not situation.mode_allows:
        return State.READY, Reason.WAITING_FOR_PILOT
    if not situation.consent_given:
        return State.READY, Reason.WAITING_FOR_CONSENT
    return State.FOLLOWING, Reason.TARGET_SEEN


def _while_engaged(
    state: State, situation: Situation, settings: SupervisorSettings
) -> tuple[State, Reason]:
    way_out = _way_out(situation, settings)
    if way_out is not None:
        return State.RELEASED, way_out
    wanted, reason = _wanted_when_engaged(state, situation, settings)
    if wanted is state is State.HOLDING and situation.in_state_s >= settings.hold_s:
        return State.RELEASED, Reason.HOLD_TIMED_OUT
    return wanted, reason


def _way_out(situation: Situation, settings: SupervisorSettings) -> Reason | None:
    ways = (
        (situation.stop_requested, Reason.STOP_REQUESTED),
        (not situation.mode_allows and situation.failsafe, Reason.AUTOPILOT_FAILSAFE),
        (not situation.mode_allows, Reason.PILOT_TOOK_OVER),
        (situation.sticks_moved, Reason.STICKS_MOVED),
        (not situation.consent_given, Reason.CONSENT_WITHDRAWN),
        (not situation.flying, Reason.NOT_FLYING),
    )
    way_out = next((reason for applies, reason in ways if applies), None)
    if way_out is None:
        way_out = _alone(situation, settings)
    if way_out is None and situation.battery_low:
        way_out = Reason.BATTERY_LOW
    return way_out


def _alone(situation: Situation, settings: SupervisorSettings) -> Reason | None:
    """Return why the autopilot may have flown by itself, and come back, unseen."""
    silent_s = min(situation.heartbeat_age_s, situation.telemetry_age_s)
    ways = (
        (silent_s, Reason.LINK_LOST),
        (situation.answer_age_s, Reason.NOT_HEARD),
        (situation.control_gap_s, Reason.CONTROL_STALLED),
    )
    return next((reason for time_s, reason in ways if time_s >= settings.alone_s), None)


def _wanted_when_engaged(
    state: State, situation: Situation, settings: SupervisorSettings
) -> tuple[State, Reason]:
    trouble = _trouble(situation, settings)
    if trouble is not None:
        return State.HOLDING, trouble
    if not situation.target_chosen:
        return State.HOLDING, Reason.NO_TARGET
    if _target_seen(situation):
        return State.FOLLOWING, Reason.TARGET_SEEN
    if state is State.HOLDING:
        searched = situation.unseen_s >= settings.search_s
        return State.HOLDING, Reason.SEARCH_FAILED if searched else Reason.TARGET_UNSEEN
    if state is State.SEARCHING and situation.in_state_s >= settings.search_s:
        return State.HOLDING, Reason.SEARCH_FAILED
    if (
        state is not State.SEARCHING
        and situation.estimate_good
        and (situation.unseen_s < settings.coast_s)
    ):
        return State.COASTING, Reason.TARGET_UNSEEN
    return State.SEARCHING, Reason.TARGET_LOST


def _trouble(situation: Situation, settings: SupervisorSettings) -> Reason | None:
    if situation.heartbeat_age_s > settings.link_timeout_s:
        return Reason.LINK_SILENT
    if situation.telemetry_age_s > settings.telemetry_timeout_s:
        return Reason.TELEMETRY_STALE
    if situation.frame_age_s > settings.frame_timeout_s:
        return Reason.FRAMES_STALE
    if situation.control_gap_s > settings.control_timeout_s:
        return Reason.CONTROL_LATE
    if situation.navigation_poor:
        return Reason.NAVIGATION_POOR
    return Reason.COCKPIT_LOST if situation.cockpit_lost else None


def _target_seen(situation: Situation) -> bool:
    return situation.estimate_good and situation.unseen_s <= 0.0


class Supervisor:
    """Holds the state, since when and why; `next_state` decides."""

    def __init__(self, settings: SupervisorSettings) -> None:
        self._settings = settings
        self._entered_s: float | None = None
        self.state = State.IDLE
        self.reason = Reason.NO_TARGET

    def change(self, settings: SupervisorSettings) -> None:
        """Decide by other times from now on."""
        self._settings = settings

    def in_state_s(self, now_s: float) -> float:
        """Return how long the present state has lasted, in seconds."""
        return 0.0 if self._entered_s is None else now_s - self._entered_s

    def step(self, situation: Situation, now_s: float) -> State:
        """Decide for the present situation and return the state to act by."""
        state, reason = next_state(self.state, situation, self._settings)
        if state is not self.state or self._entered_s is None:
            self._entered_s = now_s
        if reason is not Reason.AWAITING_CONSENT:
            self.reason = reason
        self.state = state
        return state
