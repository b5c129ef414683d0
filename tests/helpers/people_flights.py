"""Words that the flights of people and autopilots share."""

import pytest

from follower.flight.supervision.supervisor import SupervisorState

F, C, S, H, R = (
    SupervisorState.FOLLOWING,
    SupervisorState.COASTING,
    SupervisorState.SEARCHING,
    SupervisorState.HOLDING,
    SupervisorState.RELEASED,
)
OURS = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}
PILOTS = {"px4": "POSCTL", "ardupilot": "LOITER"}
CONTROL_S = 0.02
SHORT = ("supervisor.search_s=1.0", "supervisor.hold_s=1.0")

flavours = pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
