"""How a flight ended: one sentence and one exit code for each way out."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState

SUCCESS, FAILED, HANDED_OVER, RELEASED_FOR_SAFETY, INTERRUPTED = 0, 1, 3, 4, 130
"""Exit codes: as wanted; not as wanted; the pilot or the operator took the vehicle back; something
failed, and the follower released it; Ctrl-C. (2 is for what never became a flight.)"""


@dataclass(frozen=True, slots=True)
class FlightEnd:
    """How a flight ended.

    Attributes:
        sentence: for the terminal and the report, without a full stop.
        exit_code: of the command.
    """

    sentence: str
    exit_code: int


AS_ASKED = FlightEnd("Ended as asked", SUCCESS)
NOT_BEGUN = FlightEnd("Ended as asked; nothing was followed", SUCCESS)
NO_FRAMES = FlightEnd("Ended with the video", SUCCESS)
NOT_RECORDED = FlightEnd("Released: no room for the recording", RELEASED_FOR_SAFETY)
AUTOPILOT_ENDED = FlightEnd("The autopilot's program ended: {held}", RELEASED_FOR_SAFETY)
BROKEN_OFF = FlightEnd("Broken off without a release", RELEASED_FOR_SAFETY)
SUCCEEDED = FlightEnd("The pursuit succeeded", SUCCESS)
MISSED = FlightEnd("The pursuit failed", FAILED)
BY_CTRL_C = FlightEnd("Ended by the user", INTERRUPTED)

RELEASES = {
    SupervisorReason.PILOT_TOOK_OVER: FlightEnd(
        "Handed over to the pilot, who took another mode", HANDED_OVER
    ),
    SupervisorReason.STICKS_MOVED: FlightEnd(
        "Handed over to the pilot, who moved the sticks", HANDED_OVER
    ),
    SupervisorReason.CONSENT_WITHDRAWN: FlightEnd(
        "Released: the consent was withdrawn", HANDED_OVER
    ),
    SupervisorReason.NOT_FLYING: FlightEnd(
        "Released: the vehicle landed or was disarmed", HANDED_OVER
    ),
    SupervisorReason.AUTOPILOT_FAILSAFE: FlightEnd(
        "Released: the autopilot went into a failsafe", RELEASED_FOR_SAFETY
    ),
    SupervisorReason.LINK_LOST: FlightEnd("Released: the link was lost", RELEASED_FOR_SAFETY),
    SupervisorReason.NOT_HEARD: FlightEnd(
        "Released: the autopilot did not answer", RELEASED_FOR_SAFETY
    ),
    SupervisorReason.CONTROL_STALLED: FlightEnd(
        "Released: the control loop stood still", RELEASED_FOR_SAFETY
    ),
    SupervisorReason.BATTERY_LOW: FlightEnd(
        "Released: the battery was too low", RELEASED_FOR_SAFETY
    ),
    SupervisorReason.HOLD_TIMED_OUT: FlightEnd(
        "Released after a hold: {held}", RELEASED_FOR_SAFETY
    ),
}
"""What ended a flight that the follower was not asked to end; {held} is why the vehicle held."""


def pursuit_end(failures: Sequence[str]) -> FlightEnd:
    """Return how a flight ended that was flown to its end, by what its score has not reached."""
    return MISSED if failures else SUCCEEDED


class LastRelease:
    """Follows the supervisor through a flight, and says how that ended.

    What released the vehicle last counts, until it is flown again. A stop that comes when others
    have it already changes nothing.

    Attributes:
        stopped_by: how a flight ends that is stopped, if not as asked.
    """

    def __init__(self) -> None:
        self.stopped_by: FlightEnd | None = None
        self._state = SupervisorState.IDLE
        self._held = self._released = SupervisorReason.NO_TARGET

    @classmethod
    def of(cls, steps: Iterable[tuple[SupervisorState, SupervisorReason]]) -> "LastRelease":
        """Follow a supervisor through steps that are over."""
        release = cls()
        for state, reason in steps:
            release.take(state, reason)
        return release

    def take(self, state: SupervisorState, reason: SupervisorReason) -> None:
        """Take a step's state with its reason."""
        if state is SupervisorState.HOLDING:
            self._held = reason
        released = state is SupervisorState.RELEASED and self._state is not state
        if released and (self._state.engaged or reason in RELEASES):
            self._released = reason
        self._state = state

    @property
    def end(self) -> FlightEnd:
        """How the flight has ended, if it ends now."""
        if self._state.engaged:
            return BROKEN_OFF
        end = RELEASES.get(self._released)
        if end is not None:
            return FlightEnd(end.sentence.format(held=self._held), end.exit_code)
        asked = self._released is SupervisorReason.STOP_REQUESTED
        return self.stopped_by or (AS_ASKED if asked else NOT_BEGUN)
