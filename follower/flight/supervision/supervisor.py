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
| RELEASED  | released; only a new consent begins again            | hold, while heard  |

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

from enum import StrEnum

from follower.flight.supervision.inputs import SupervisorInputs
from follower.settings.supervisor import SupervisorSettings


class SupervisorState(StrEnum):
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
        return self in (SupervisorState.FOLLOWING, SupervisorState.COASTING)

    @property
    def streams(self) -> bool:
        """Whether setpoints are sent at all. PX4 wants the stream before it enters OFFBOARD."""
        return self is SupervisorState.READY or self.engaged


ENGAGED = frozenset(
    {
        SupervisorState.FOLLOWING,
        SupervisorState.COASTING,
        SupervisorState.SEARCHING,
        SupervisorState.HOLDING,
    }
)


class SupervisorReason(StrEnum):
    """Why the supervisor is where it is."""

    NO_TARGET = "no target"
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
    AWAITING_CONSENT = "released, waiting for consent"

    @classmethod
    def _missing_(cls, value: object) -> "SupervisorReason | None":
        return cls.AWAITING_CONSENT if value == _AS_RECORDED_BEFORE else None


_AS_RECORDED_BEFORE = "let go, waiting for consent"


def next_state(
    state: SupervisorState, situation: SupervisorInputs, settings: SupervisorSettings
) -> tuple[SupervisorState, SupervisorReason]:
    """Return the state to be in now, and why; the tables above. Pure."""
    if state is SupervisorState.RELEASED and not situation.consent_renewed:
        return SupervisorState.RELEASED, SupervisorReason.AWAITING_CONSENT
    if state.engaged:
        return _while_engaged(state, situation, settings)
    return _before_engaged(situation, settings)


def _before_engaged(
    situation: SupervisorInputs, settings: SupervisorSettings
) -> tuple[SupervisorState, SupervisorReason]:
    if situation.stop_requested:
        return SupervisorState.RELEASED, SupervisorReason.STOP_REQUESTED
    if situation.mode_left:
        return SupervisorState.RELEASED, SupervisorReason.PILOT_TOOK_OVER
    alone = _alone(situation, settings)
    if situation.stream_held and alone is not None:
        return SupervisorState.RELEASED, alone
    if situation.sticks_moved:
        return SupervisorState.RELEASED, SupervisorReason.STICKS_MOVED
    if not situation.target_chosen:
        return SupervisorState.IDLE, SupervisorReason.NO_TARGET
    trouble = _trouble(situation, settings)
    if trouble is not None:
        return SupervisorState.TRACKING, trouble
    if not _target_seen(situation):
        return SupervisorState.TRACKING, SupervisorReason.TARGET_UNSEEN
    if not situation.flying:
        return SupervisorState.TRACKING, SupervisorReason.NOT_FLYING
    if situation.failsafe:
        return SupervisorState.TRACKING, SupervisorReason.AUTOPILOT_FAILSAFE
    if situation.battery_low:
        return SupervisorState.TRACKING, SupervisorReason.BATTERY_LOW
    if not situation.mode_allows:
        return SupervisorState.READY, SupervisorReason.WAITING_FOR_PILOT
    if not situation.consent_given:
        return SupervisorState.READY, SupervisorReason.WAITING_FOR_CONSENT
    return SupervisorState.FOLLOWING, SupervisorReason.TARGET_SEEN


def _while_engaged(
    state: SupervisorState, situation: SupervisorInputs, settings: SupervisorSettings
) -> tuple[SupervisorState, SupervisorReason]:
    way_out = _way_out(situation, settings)
    if way_out is not None:
        return SupervisorState.RELEASED, way_out
    wanted, reason = _wanted_when_engaged(state, situation, settings)
    if wanted is state is SupervisorState.HOLDING and situation.in_state_s >= settings.hold_s:
        return SupervisorState.RELEASED, SupervisorReason.HOLD_TIMED_OUT
    return wanted, reason


def _way_out(situation: SupervisorInputs, settings: SupervisorSettings) -> SupervisorReason | None:
    alone = _alone(situation, settings)
    ways = (
        (situation.stop_requested, SupervisorReason.STOP_REQUESTED),
        (not situation.mode_allows and situation.failsafe, SupervisorReason.AUTOPILOT_FAILSAFE),
        (not situation.mode_allows, SupervisorReason.PILOT_TOOK_OVER),
        (situation.sticks_moved, SupervisorReason.STICKS_MOVED),
        (not situation.consent_given, SupervisorReason.CONSENT_WITHDRAWN),
        (not situation.flying, SupervisorReason.NOT_FLYING),
        (alone is not None, alone),
        (situation.battery_low, SupervisorReason.BATTERY_LOW),
    )
    return next((reason for applies, reason in ways if applies), None)


def _alone(situation: SupervisorInputs, settings: SupervisorSettings) -> SupervisorReason | None:
    """Return why the autopilot may have flown by itself, and come back, unseen."""
    silent_s = min(situation.heartbeat_age_s, situation.telemetry_age_s)
    ways = (
        (silent_s, SupervisorReason.LINK_LOST),
        (situation.answer_age_s, SupervisorReason.NOT_HEARD),
        (situation.control_gap_s, SupervisorReason.CONTROL_STALLED),
    )
    return next((reason for time_s, reason in ways if time_s >= settings.alone_s), None)


def _wanted_when_engaged(
    state: SupervisorState, situation: SupervisorInputs, settings: SupervisorSettings
) -> tuple[SupervisorState, SupervisorReason]:
    trouble = _trouble(situation, settings)
    if trouble is not None:
        return SupervisorState.HOLDING, trouble
    if not situation.target_chosen:
        return SupervisorState.HOLDING, SupervisorReason.NO_TARGET
    if _target_seen(situation):
        return SupervisorState.FOLLOWING, SupervisorReason.TARGET_SEEN
    if state is SupervisorState.HOLDING:
        searched = situation.unseen_s >= settings.search_s
        reason = SupervisorReason.SEARCH_FAILED if searched else SupervisorReason.TARGET_UNSEEN
        return SupervisorState.HOLDING, reason
    if state is SupervisorState.SEARCHING and situation.in_state_s >= settings.search_s:
        return SupervisorState.HOLDING, SupervisorReason.SEARCH_FAILED
    coasts = situation.estimate_good and situation.unseen_s < settings.coast_s
    if state is not SupervisorState.SEARCHING and coasts:
        return SupervisorState.COASTING, SupervisorReason.TARGET_UNSEEN
    return SupervisorState.SEARCHING, SupervisorReason.TARGET_LOST


def _trouble(situation: SupervisorInputs, settings: SupervisorSettings) -> SupervisorReason | None:
    telemetry_stale = situation.telemetry_age_s > settings.telemetry_timeout_s
    troubles = (
        (situation.heartbeat_age_s > settings.link_timeout_s, SupervisorReason.LINK_SILENT),
        (telemetry_stale, SupervisorReason.TELEMETRY_STALE),
        (situation.frame_age_s > settings.frame_timeout_s, SupervisorReason.FRAMES_STALE),
        (situation.control_gap_s > settings.control_timeout_s, SupervisorReason.CONTROL_LATE),
        (situation.navigation_poor, SupervisorReason.NAVIGATION_POOR),
        (situation.cockpit_lost, SupervisorReason.COCKPIT_LOST),
    )
    return next((reason for applies, reason in troubles if applies), None)


def _target_seen(situation: SupervisorInputs) -> bool:
    return situation.estimate_good and situation.unseen_s <= 0.0


class Supervisor:
    """Holds the state, since when and why; `next_state` decides.

    Attributes:
        state: the present one.
        reason: why it is the present one.
    """

    def __init__(self, settings: SupervisorSettings) -> None:
        self._settings = settings
        self._entered_s: float | None = None
        self.state = SupervisorState.IDLE
        self.reason = SupervisorReason.NO_TARGET

    def change(self, settings: SupervisorSettings) -> None:
        """Decide by other times from now on."""
        self._settings = settings

    def in_state_s(self, now_s: float) -> float:
        """Return how long the present state has lasted, in seconds."""
        return 0.0 if self._entered_s is None else now_s - self._entered_s

    def step(self, situation: SupervisorInputs, now_s: float) -> SupervisorState:
        """Decide for the situation at `now_s` (seconds) and return the state to act by."""
        state, reason = next_state(self.state, situation, self._settings)
        if state is not self.state or self._entered_s is None:
            self._entered_s = now_s
        if reason is not SupervisorReason.AWAITING_CONSENT:
            self.reason = reason
        self.state = state
        return state
