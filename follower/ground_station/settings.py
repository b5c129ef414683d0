"""What is shown to a ground station, and as whom."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar


class TargetMessage(StrEnum):
    """How the target's position is told to autopilots that can follow one."""

    NONE = "none"
    """Not at all."""
    FOLLOW_TARGET = "follow_target"
    """FOLLOW_TARGET: PX4's follow-me, ArduPilot's FOLLOW mode."""
    GLOBAL_POSITION = "global_position"
    """GLOBAL_POSITION_INT, as a vehicle of its own would tell it: ArduPilot's FOLLOW mode."""
    BOTH = "both"
    """Both."""


@dataclass(frozen=True, slots=True)
class GroundStationSettings:
    """A MAVLink camera with tracking, and parameters, on the link to the autopilot.

    Attributes:
        enabled: whether there is all that.
        camera_component: the camera's component id, 100 to 105; another camera has another one.
        image_rate_hz: how often the target's box is told if nobody asks for another rate.
        active_only: say that the target is tracked with the flag "active" alone, also while it is
            coasted after: some ground stations show the box only then.
        video_uri: where the ground station finds the video, such as rtsp://192.168.1.5:8554/live;
            rtp:PORT or udp://0.0.0.0:PORT for RTP by UDP. Empty: no stream is told of.
        definition_uri: where it finds the camera definition file; empty offers it by MAVLink FTP.
        parameters: whether gains and limits are parameters of component 191.
        target: as what the target's position is told.
        target_rate_hz: how often.
        target_system: the MAVLink system id under which it is told; ArduPilot takes none of its
            own.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    enabled: bool = False
    camera_component: int = 100
    image_rate_hz: float = 5.0
    active_only: bool = True
    video_uri: str = ""
    definition_uri: str = ""
    parameters: bool = True
    target: TargetMessage = TargetMessage.NONE
    target_rate_hz: float = 5.0
    target_system: int = 250

    def __post_init__(self) -> None:
        if not 100 <= self.camera_component <= 105:
            raise ValueError(f"camera_component lies between 100 and 105, not {self}")
        rates = self.image_rate_hz, self.target_rate_hz
        if not all(0.1 <= rate <= 50 for rate in rates):
            raise ValueError(
                f"image_rate_hz and target_rate_hz lie between 0.1 and 50, not {rates}"
            )
        if not 1 <= self.target_system <= 255:
            raise ValueError(f"target_system lies between 1 and 255, not {self.target_system}")
        if len(self.video_uri) > 159 or len(self.definition_uri) > 139:
            raise ValueError("video_uri has up to 159 characters, definition_uri up to 139")
