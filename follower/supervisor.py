"""Who may move the vehicle, and when: one pure function of the state and the situation.

| state     | meaning                                             | setpoints          |
|-----------|-----------------------------------------------------|--------------------|
| IDLE      | no target is chosen                                 | none               |
| TRACKING  | a target is chosen; something else is not yet good  | none               |
| READY     | target, estimate and link are good; the pilot's turn| hold               |
| FOLLOWING | the pilot's mode allows it and all is good          | servo              |
| COASTING  | the target was not seen for a moment                | servo, predicted   |
| SEARCHING | the target is lost                                  | hold               |
| HOLDING   | something is wrong, or the search took too long     | hold               |
| RELEASED  | let go; only a new consent begins again             | hold, while heard  |

From every following state the first row that applies decides:

| situation                                   | next state | reason               |
|---------------------------------------------|------------|----------------------|
| stop was asked for                          | RELEASED   | stop requested       |
| the pilot's mode no longer allows following | RELEASED   | pilot took over      |
| disarmed or landed                          | RELEASED   | not flying           |
| no heartbeat for `link_timeout_s`           | HOLDING    | link silent          |
| attitude or position older than allowed     | HOLDING    | telemetry stale      |
| no frame for `frame_timeout_s`              | HOLDING    | frames stale         |
| the control loop itself came late           | HOLDING    | control late         |
| target seen, estimate good                  | FOLLOWING  | target seen          |
| unseen, but less than `coast_s`             | COASTING   | target unseen        |
| unseen for longer                           | SEARCHING  | target lost          |
| SEARCHING for `search_s`                    | HOLDING    | search failed        |
| HOLDING for `hold_s`                        | RELEASED   | hold timed out       |

HOLDING returns to FOLLOWING when its cause has gone before `hold_s` is over: the pilot's consent,
the mode, still stands. RELEASED never returns by itself. It holds for as long as the autopilot
still flies our setpoints, because silence would send PX4 home; once the pilot has taken another
mode, nothing is sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar


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
    NOT_FLYING = "not flying"
    TARGET_UNSEEN = "target unseen"
    TARGET_LOST = "target lost"
    WAITING_FOR_PILOT = "waiting for the pilot's mode"
    TARGET_SEEN = "target seen"
    SEARCH_FAILED = "search failed"
    HOLD_TIMED_OUT = "hold timed out"
    PILOT_TOOK_OVER = "pilot took over"
    STOP_REQUESTED = "stop requested"
    AWAITING_CONSENT = "let go, waiting for consent"


@dataclass(frozen=True, slots=True)
class SupervisorSettings:
    """How long each trouble is borne, in seconds.

    Attributes:
        link_timeout_s: silence of the autopilot's heartbeat (sent at 1 Hz).
        telemetry_timeout_s: age of attitude or position.
        frame_timeout_s: age of the newest frame that vision has answered for.
        control_timeout_s: time between two control steps.
        coast_s: how long to fly on the predicted target.
        search_s: how long to hold and look for a lost target.
        hold_s: how long to hold before letting go.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    link_timeout_s: float = 3.0
    telemetry_timeout_s: float = 0.5
    frame_timeout_s: float = 0.5
    control_timeout_s: float = 0.2
    coast_s: float = 0.8
    search_s: float = 10.0
    hold_s: float = 3.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not 0 < getattr(self, name) < 3600:
                raise ValueError(f"{name} is a time in seconds above 0, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Situation:
    """All that a decision depends on. Ages and durations in seconds; never-seen is infinite.

    Attributes:
        target_chosen: somebody selected a target and has not dropped it.
        unseen_s: 0 while the newest frame shows the target, else the time since one did.
        estimate_good: the estimator stands by its estimate.
        heartbeat_age_s: since the autopilot's last heartbeat.
        telemetry_age_s: age of the older one of attitude and position; an attitude that only
            repeats itself grows old.
        frame_age_s: since the capture of the newest frame that vision answered for.
        control_gap_s: since the previous control step.
        mode_allows: the autopilot is in the mode that flies setpoints.
        flying: armed and not landed.
        stop_requested: the operator pressed stop.
        consent_renewed: after letting go, the operator chose a target or consented anew.
        in_state_s: since the present state was entered.
    """

    target_chosen: bool
    unseen_s: float
    estimate_good: bool
    heartbeat_age_s: float
    telemetry_age_s: float
    frame_age_s: float
    control_gap_s: float
    mode_allows: bool
    flying: bool
    stop_requested: bool
    consent_renewed: bool
    in_state_s: float


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
    if not situation.target_chosen:
        return State.IDLE, Reason.NO_TARGET
    trouble = _trouble(situation, settings)
    if trouble is not None:
        return State.TRACKING, trouble
    if not _target_seen(situation):
        return State.TRACKING, Reason.TARGET_UNSEEN
    if not situation.flying:
        return State.TRACKING, Reason.NOT_FLYING
    if not situation.mode_allows:
        return State.READY, Reason.WAITING_FOR_PILOT
    return State.FOLLOWING, Reason.TARGET_SEEN


def _while_engaged(
    state: State, situation: Situation, settings: SupervisorSettings
) -> tuple[State, Reason]:
    if situation.stop_requested:
        return State.RELEASED, Reason.STOP_REQUESTED
    if not situation.mode_allows:
        return State.RELEASED, Reason.PILOT_TOOK_OVER
    if not situation.flying:
        return State.RELEASED, Reason.NOT_FLYING
    wanted, reason = _wanted_when_engaged(state, situation, settings)
    if wanted is state is State.HOLDING and situation.in_state_s >= settings.hold_s:
        return State.RELEASED, Reason.HOLD_TIMED_OUT
    return wanted, reason


def _wanted_when_engaged(
    state: State, situation: Situation, settings: SupervisorSettings
) -> tuple[State, Reason]:
    trouble = _trouble(situation, settings)
    if trouble is not None:
        return State.HOLDING, trouble
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
    return None


def _target_seen(situation: Situation) -> bool:
    return situation.estimate_good and situation.unseen_s <= 0.0


class Supervisor:
    """Holds the state, since when and why; `next_state` decides."""

    def __init__(self, settings: SupervisorSettings) -> None:
        self._settings = settings
        self._entered_s: float | None = None
        self.state = State.IDLE
        self.reason = Reason.NO_TARGET

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
