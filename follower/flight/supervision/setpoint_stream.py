"""Whether a setpoint is sent in a step: a stream that is flown by is not broken off."""

import math
from collections.abc import Sequence

from follower.flight.supervision.supervisor import SupervisorState
from follower_control.vehicle.state import ENTRY_S, Attitude, VehicleState

NEEDS_STREAM = "OFFBOARD"
"""The mode into which a stream of setpoints calls PX4 back out of its failsafe."""

_LATE_S = 0.25
"""An attitude that came later than that had to wait, and what came with it as well."""
_CAUGHT_UP_S = 2.0
"""After that nothing waits any longer, also where no attitude tells so."""


class SetpointStream:
    """Decides, step by step, whether a setpoint is sent.

    Args:
        alone_s: after so many seconds without a step the autopilot may fly by itself.

    Attributes:
        sent: a setpoint was to be sent in the last step.
        held: the vehicle flew by the stream in the last step, in somebody's chosen mode.
    """

    def __init__(self, alone_s: float) -> None:
        self.change(alone_s)
        self._streamed_s = self._stalled_s = self._stood_still_s = -math.inf
        self._last_step_s: float | None = None
        self.sent = self.held = False
        self._entries = 0

    def change(self, alone_s: float) -> None:
        """Go on with another time, in seconds."""
        self._alone_s = alone_s

    def was_left(self, vehicle: VehicleState) -> bool:
        """Whether a vehicle that flew by the stream no longer does, or did not in between."""
        stays = vehicle.obeys_setpoints and vehicle.entries == self._entries
        return self.held and not stays

    def gap_s(self, now_s: float) -> float:
        """Return how many seconds ago the last step was, 0 before the first."""
        return 0.0 if self._last_step_s is None else now_s - self._last_step_s

    def may_call_back(self, vehicle: VehicleState) -> bool:
        """Whether a setpoint could end a failsafe that was not reported to us.

        While our loop stood still PX4 may have gone into it, and a setpoint calls it back into
        OFFBOARD. What waited for us then may be old, and a line may hand it over bit by bit; the
        first heartbeat after that decides.
        """
        heard_s = -math.inf if vehicle.heartbeat_s is None else vehicle.heartbeat_s
        return vehicle.mode == NEEDS_STREAM and heard_s <= self._stood_still_s

    def step(
        self,
        state: SupervisorState,
        vehicle: VehicleState,
        attitudes: Sequence[Attitude],
        now_s: float,
        handed_back: bool,
    ) -> None:
        """Decide for this step.

        Args:
            state: the supervisor's.
            vehicle: newest telemetry.
            attitudes: that came since the last step.
            now_s: the step's time.
            handed_back: the vehicle was given to its autopilot: nothing more is sent.
        """
        self._note_stall(attitudes, now_s)
        self.sent = not handed_back and self._sends(state, vehicle, now_s)
        self._streamed_s = now_s if self.sent else self._streamed_s
        self.held = self.sent and vehicle.obeys_setpoints and not vehicle.entered_by_itself
        self._entries = vehicle.entries
        self._last_step_s = now_s

    def _note_stall(self, attitudes: Sequence[Attitude], now_s: float) -> None:
        """Remember until when we had stood still, or heard only what had waited meanwhile."""
        if self.gap_s(now_s) >= self._alone_s:
            self._stalled_s = self._stood_still_s = now_s
            return
        timely = bool(attitudes) and now_s - attitudes[0].time_s <= _LATE_S
        caught_up = timely or now_s - self._stalled_s > _CAUGHT_UP_S
        if self._stood_still_s == self._last_step_s and not caught_up:
            self._stood_still_s = now_s

    def _sends(self, state: SupervisorState, vehicle: VehicleState, now_s: float) -> bool:
        """Whether a setpoint is to be sent.

        A stream that the autopilot flies by is not broken off, whatever the state: silence would
        send PX4 home. Once the pilot has another mode, nothing is sent, and ArduCopter's GUIDED is
        somebody else's when it comes back; OFFBOARD needs a stream from whom it had one, also when
        the pilot took it in the moment in which that ended.
        """
        if self.may_call_back(vehicle):
            return False
        had_ours = state is SupervisorState.RELEASED or now_s - self._streamed_s < ENTRY_S
        needs_ours = vehicle.mode == NEEDS_STREAM and had_ours
        is_ours = self.sent and vehicle.entries == self._entries
        return state.streams or (vehicle.obeys_setpoints and (is_ours or needs_ours))
