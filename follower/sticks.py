"""The pilot's sticks while we follow: small deflections shift, large ones take over."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from follower_control.nudge import NO_NUDGE, Nudge
from follower_control.vehicle import RcChannels, VehicleState

Stick = Literal["roll", "pitch", "throttle", "yaw"]
_FRESH_S = 0.5


@dataclass(frozen=True, slots=True)
class StickSettings:
    """What sticks do while the vehicle follows; where no RC is shown, they do nothing.

    A deflection is positive to the right, forward and up.

    Attributes:
        nudge: whether they shift what is wanted.
        takeover: from this share of the full deflection on, roll, pitch or yaw take over: hold and
            let go. None: never.
        deadband: share of the full deflection that does nothing.
        max_distance_m: pitch fully forward comes so much nearer, fully back goes farther away.
        max_elevation_deg: throttle fully up looks down on the target so much more steeply.
        max_bearing_deg: yaw fully right turns the nose so far to the right of the target.
        max_side_m_s: roll fully right goes around the target to the right so fast.
        roll_channel, pitch_channel, throttle_channel, yaw_channel: counted from 1.
        reversed: the sticks whose pulse falls when they are moved right, forward or up. Pitch does
            as ArduPilot and PX4 want it from a transmitter.
        centre_us: pulse of a stick in its middle.
        throw_us: from there to the end.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    nudge: bool = False
    takeover: float | None = 0.75
    deadband: float = 0.1
    max_distance_m: float = 5.0
    max_elevation_deg: float = 15.0
    max_bearing_deg: float = 15.0
    max_side_m_s: float = 1.5
    roll_channel: int = 1
    pitch_channel: int = 2
    throttle_channel: int = 3
    yaw_channel: int = 4
    reversed: tuple[Stick, ...] = ("pitch",)
    centre_us: int = 1500
    throw_us: int = 400

    def __post_init__(self) -> None:
        if not 0 < self.deadband < 0.5:
            raise ValueError(f"deadband lies between 0 and 0.5, not {self.deadband}")
        if self.takeover is not None and not self.deadband < self.takeover <= 1:
            raise ValueError(f"takeover lies between deadband and 1, not {self.takeover}")
        most = (self.max_distance_m, self.max_side_m_s)
        if not all(0 <= value <= 50 for value in most):
            raise ValueError(f"max_distance_m and max_side_m_s lie between 0 and 50, not {most}")
        angles = (self.max_elevation_deg, self.max_bearing_deg)
        if not all(0 <= angle <= 45 for angle in angles):
            raise ValueError(f"max_elevation_deg, max_bearing_deg are 0 to 45, not {angles}")
        channels = (self.roll_channel, self.pitch_channel, self.throttle_channel, self.yaw_channel)
        if len(set(channels)) < 4 or not all(1 <= channel <= 18 for channel in channels):
            raise ValueError(f"four sticks have four channels from 1 to 18, not {channels}")
        if not (1200 <= self.centre_us <= 1800 and 100 <= self.throw_us <= 700):
            raise ValueError("centre_us lies between 1200 and 1800, throw_us between 100 and 700")


class Sticks:
    """Reads the sticks from step to step.

    They count from when roll, pitch and yaw were first seen in their middle while we follow: a
    pilot who flies and then turns the mode switch may still hold one. The throttle's middle is
    where it stands at that moment, because not every throttle springs back. While channels do not
    come nothing is shifted; who took over keeps it until roll, pitch and yaw are back in their
    middle, whoever wants to follow again.

    Attributes:
        nudge: by how much to shift what is wanted.
        taken_over: whether the pilot wants the vehicle back.
    """

    def __init__(self, settings: StickSettings) -> None:
        self._settings = settings
        self._middle: float | None = None
        self.nudge, self.taken_over = NO_NUDGE, False

    def step(self, vehicle: VehicleState, engaged: bool, now_s: float) -> None:
        """Take the newest channels; while we do not fly only a stick that took over counts."""
        self.nudge = NO_NUDGE
        if not engaged:
            self._middle = None
        rc = vehicle.fresh_rc(now_s, _FRESH_S)
        roll, pitch, yaw = (self._deflection(rc, stick) for stick in ("roll", "pitch", "yaw"))
        throttle = self._deflection(rc, "throttle")
        if roll is None or pitch is None or yaw is None or throttle is None:
            return
        most = max(map(abs, (roll, pitch, yaw)))
        if most <= self._settings.deadband:
            self.taken_over = False
            if engaged and self._middle is None:
                self._middle = throttle
        if self._middle is not None:
            self._take(roll, pitch, yaw, throttle - self._middle)

    def _take(self, roll: float, pitch: float, yaw: float, throttle: float) -> None:
        s = self._settings
        most = max(map(abs, (roll, pitch, yaw)))
        self.taken_over = self.taken_over or (s.takeover is not None and most >= s.takeover)
        if s.nudge:
            self.nudge = Nudge(
                distance_m=-s.max_distance_m * self._beyond(pitch),
                elevation_rad=-math.radians(s.max_elevation_deg) * self._beyond(throttle),
                azimuth_rad=-math.radians(s.max_bearing_deg) * self._beyond(yaw),
                side_m_s=s.max_side_m_s * self._beyond(roll),
            )

    def _beyond(self, deflection: float) -> float:
        """Return what lies beyond the deadband, stretched to 1 again."""
        band = self._settings.deadband
        share = min(max(abs(deflection) - band, 0.0) / (1 - band), 1.0)
        return math.copysign(share, deflection)

    def _deflection(self, rc: RcChannels | None, stick: Stick) -> float | None:
        s = self._settings
        pulse = None if rc is None else rc.pulse_us(getattr(s, f"{stick}_channel"))
        if pulse is None:
            return None
        share = (pulse - s.centre_us) / s.throw_us
        return min(max(-share if stick in s.reversed else share, -1.0), 1.0)
