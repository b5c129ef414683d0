"""A camera that takes no pictures: its frames have their times alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from follower_sim.camera import SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.world import World
from follower_vision.frame import Image


class BlindCamera(SimCamera):
    """The simulated camera with its rate, latency, jitter and drops, and black pictures.

    Args:
        world: its scenario has the camera's settings and faults.
        state_at: where the vehicle is at a time on the system's clock.
    """

    def __init__(self, world: World, state_at: Callable[[float], BodyState]) -> None:
        camera = world.scenario.camera
        black = np.zeros((1, 1, 3), np.uint8)
        self._black = np.broadcast_to(black, (camera.height, camera.width, 3))
        super().__init__(world, state_at, renderer=_Nothing(self._black))

    def _picture(
        self,
        captured_s: float,  # noqa: ARG002  all alike
        fault: str | None,  # noqa: ARG002
    ) -> Callable[[], Image]:
        return lambda: self._black


class _Nothing:
    """Draws nothing, in no time."""

    def __init__(self, image: Image) -> None:
        self._nothing = image

    def render(
        self,
        time_s: float,  # noqa: ARG002
        body: BodyState,  # noqa: ARG002
        exposure_s: float = 0.0,  # noqa: ARG002
    ) -> Image:
        """Return the same black image."""
        return self._nothing
