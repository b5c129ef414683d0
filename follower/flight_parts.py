"""The parts of a simulated flight, where faults may be brought in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from follower.control_loop import ControlLoop
from follower.realtime import VisionLoop
from follower.supervisor import State
from follower_control.transport import Transport
from follower_sim.autopilot import SimAutopilot
from follower_sim.camera import SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.world import World


class FlightParts:
    """Sound parts. `follower.faults` has others, with faults in them."""

    def transport(self, inner: Transport) -> Transport:
        """Return the follower's transport."""
        return inner

    def camera(self, world: World, state_at: Callable[[float], BodyState]) -> SimCamera:
        """Return the camera of a body."""
        return SimCamera(world, state_at)

    def vision(self, *arguments: Any) -> VisionLoop:
        """Return the vision loop; the arguments are its own."""
        return VisionLoop(*arguments)

    def control(self, *arguments: Any) -> ControlLoop:
        """Return the control loop; the arguments are its own."""
        return ControlLoop(*arguments)

    def attach(
        self,
        autopilot: SimAutopilot | None,
        stop: Callable[[], None],
        withdraw: Callable[[], None],
    ) -> None:
        """Be told of the simulated autopilot, and of the operator's two ways to end it."""

    def observe(self, now_s: float, state: State, in_state_s: float) -> None:
        """Look at a control step."""

    def is_over(self, now_s: float) -> bool:  # noqa: ARG002  sound parts need no time
        """Whether the flight may end as far as the parts go."""
        return True

    def end(self) -> None:
        """Let go of what is held."""
