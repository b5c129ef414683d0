"""A simulated camera that fails as the schedule says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from follower.faults.fault import Kind
from follower.faults.schedule import FaultSchedule
from follower_sim.camera import Delivery, SimCamera
from follower_sim.exposure import Exposure
from follower_sim.kinematics import BodyState
from follower_sim.world import World


class FaultyCamera(SimCamera):
    """See `SimCamera`.

    Args:
        world: see there.
        state_at: see there.
        schedule: says what is on.
    """

    def __init__(
        self, world: World, state_at: Callable[[float], BodyState], schedule: FaultSchedule
    ) -> None:
        super().__init__(world, state_at)
        self._schedule = schedule
        self._frozen: Exposure | None = None
        self._kept: Exposure | None = None
        self._is_odd = False

    def capture(self) -> Delivery | None:
        """Take the picture due, and do to it what the faults ask for."""
        now_s = self.next_capture_s
        delivery = super().capture()
        if delivery is None or self._schedule.active(Kind.FRAMES_SILENT, now_s) is not None:
            return None
        delivery = replace(delivery, exposure=self._spoiled(delivery.exposure, now_s))
        late = self._schedule.active(Kind.FRAMES_LATE, now_s)
        if late is not None:
            delivery = replace(delivery, available_s=delivery.available_s + late.amount)
        if self._schedule.active(Kind.FRAMES_REORDERED, now_s) is not None:
            return self._swapped(delivery)
        return delivery

    def _spoiled(self, exposure: Exposure, now_s: float) -> Exposure:
        if self._schedule.active(Kind.FRAMES_BLACK, now_s) is not None:
            return exposure.replaced(lambda: np.zeros_like(exposure.unseen.image))
        frozen = self._frozen
        if self._schedule.active(Kind.FRAMES_FROZEN, now_s) is None or frozen is None:
            self._frozen = exposure
            return exposure
        return exposure.replaced(lambda: frozen.frame.image)

    def _swapped(self, delivery: Delivery) -> Delivery | None:
        """Give the second of two frames before the first."""
        self._is_odd = not self._is_odd
        if not self._is_odd:
            return delivery
        before, self._kept = self._kept, delivery.exposure
        return None if before is None else replace(delivery, exposure=before)
