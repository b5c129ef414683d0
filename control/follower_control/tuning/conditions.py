"""Under what circumstances a loop is looked at: delays, rates, geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class LoopDelays:
    """What passes between a thing and its effect, seconds.

    Attributes:
        camera_s: from a frame's exposure to the first setpoint made from it.
        frame_interval_s: between two frames.
        control_interval_s: between two setpoints.
        position_s: age of the newest position when it is used.
        stamp_error_s: how much later than the exposure the frames' stamps are, unknown to the
            follower (its own `camera.latency_s` taken off).
        extra_s: more dead time on the way to the vehicle, unknown to anybody.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    camera_s: float = 0.075
    frame_interval_s: float = 1 / 30
    control_interval_s: float = 0.02
    position_s: float = 0.02
    stamp_error_s: float = 0.0
    extra_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("frame_interval_s", "control_interval_s"):
            if not 0 < getattr(self, name) < 2:
                raise ValueError(f"{name} is above 0, not {getattr(self, name)}")
        for name in ("camera_s", "position_s", "extra_s"):
            if not 0 <= getattr(self, name) < 5:
                raise ValueError(f"{name} is a time in seconds, not {getattr(self, name)}")
        if not abs(self.stamp_error_s) <= self.camera_s:
            raise ValueError("stamp_error_s is no larger than camera_s")

    @property
    def sight_s(self) -> float:
        """How old what is known of the target is, on average."""
        return self.camera_s + self.frame_interval_s / 2


@dataclass(frozen=True, slots=True)
class Conditions:
    """Where the loops are looked at.

    Attributes:
        delays: of camera, control and telemetry.
        range_m: distance at which the target is steadily followed; another one than the servo's
            `distance_m` by a nudge.
        elevation_rad: at which the target is seen.
        size_m: the root of its width times its height.
        acceleration_m_s2: how hard the vehicle is steered: the envelope's jerk limit delays a
            harder change by more.
    """

    delays: LoopDelays = LoopDelays()
    range_m: float = 15.0
    elevation_rad: float = -0.3
    size_m: float = 1.8
    acceleration_m_s2: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.range_m < math.inf or not 0 < self.size_m < math.inf:
            raise ValueError("range_m and size_m are above 0")
        if not abs(self.elevation_rad) < math.pi / 2:
            raise ValueError("elevation_rad lies within ±90 degrees")
        if not 0 <= self.acceleration_m_s2 < 100:
            raise ValueError("acceleration_m_s2 is not negative")
