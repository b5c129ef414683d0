"""The parts of a simulated flight, where faults can be injected."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from follower.flight.control.loop import ControlLoop
from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.target.request import TargetFinder
from follower.flight.threads import VisionLoop
from follower.flight.vision.video_sink import FlightVideo
from follower.recording import Recorder
from follower.simulation.options import VisionSource
from follower_control.common.transport import Transport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.camera import SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import Scenario
from follower_sim.vehicle.gimbal import Gimbal
from follower_sim.world.world import World

Action = Callable[[], None]
"""What an operator does to a flight."""


class FlightComponents:
    """Parts without faults. `follower.simulation.faults` has others, with faults in them."""

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

    def attach(self, autopilot: SimAutopilot | None, stop: Action, withdraw: Action) -> None:
        """Take the simulated autopilot, and the operator's two ways to end the flight."""

    def observe(self, now_s: float, state: SupervisorState, in_state_s: float) -> None:
        """Take the supervisor's state after a control step, and for how many seconds it lasts."""

    def is_over(self, now_s: float) -> bool:  # noqa: ARG002  parts without faults need no time
        """Whether the flight may end as far as the parts go."""
        return True

    def end(self) -> None:
        """Release what is held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """Who watches a simulated flight, and what is unusual about it.

    Attributes:
        video: takes every frame with its track, if given.
        recorder: records the flight, if given.
        parts: what it is made of; others than the usual ones inject faults.
        vision: what vision goes by. Without pixels, images are rendered for `video` alone.
        finder: finds what operators point at, if given.
        boots_within_s: how long an autopilot that is just started may take to send a heartbeat.
    """

    video: FlightVideo | None = None
    recorder: Recorder | None = None
    parts: FlightComponents | None = None
    vision: VisionSource = VisionSource.PIXELS
    finder: TargetFinder | None = None
    boots_within_s: float | None = None


def start_state(scenario: Scenario) -> BodyState:
    """Return where the vehicle stands at first."""
    north, east = scenario.start.at
    heading = math.radians(scenario.start.heading_deg)
    return BodyState(0.0, (north, east, 0.0), attitude_rad=(0.0, 0.0, heading))


def gimbal_of(scenario: Scenario) -> Gimbal | None:
    """Return the gimbal that holds the scenario's camera, None if it is fixed."""
    camera = scenario.camera
    if camera.gimbal is None:
        return None
    heading = math.radians(scenario.start.heading_deg)
    return Gimbal(camera.gimbal, math.radians(camera.pitch_deg), heading, 0.0)
