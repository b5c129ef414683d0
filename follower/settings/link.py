"""What can be set about the link to the autopilot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias, get_args

_OFTEN_HZ = 4.0


LinkKind: TypeAlias = Literal["pymavlink", "mavsdk"]
LINK_KINDS: tuple[LinkKind, ...] = get_args(LinkKind)


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """The link to the autopilot.

    Attributes:
        kind: "pymavlink" (our own stream) or "mavsdk" (its library's, watched by ours).
        vehicle_id: MAVLink system id of the vehicle; None takes the only one that is heard.
        listen_s: how long to listen for others before the only one is taken.
        attitude_rate_hz: how often ATTITUDE is asked for.
        position_rate_hz: how often LOCAL_POSITION_NED is asked for.
        rc_rate_hz: how often RC_CHANNELS is asked for, the pilot's sticks and switches; 0 never.
        clearance_rate_hz: how often DISTANCE_SENSOR and TERRAIN_REPORT are asked for; 0 never.
        mode_rate_hz: how often the mode is asked after while setpoints are sent or flown: of
            themselves autopilots tell it once a second; 0 leaves it at that.
        timesync_rate_hz: how often the clocks are compared.
        signing_key_file: file of the MAVLink 2 signing key; None signs nothing and takes all.
        stall_s: a control loop that gives no setpoint for so long is taken to stand still, and
            mavsdk's stream is set to zero; it is ended 0.1 s later.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    kind: LinkKind = "pymavlink"
    vehicle_id: int | None = None
    listen_s: float = 2.5
    attitude_rate_hz: float = 100.0
    position_rate_hz: float = 30.0
    rc_rate_hz: float = 10.0
    clearance_rate_hz: float = 5.0
    mode_rate_hz: float = 25.0
    timesync_rate_hz: float = 5.0
    signing_key_file: str | None = None
    stall_s: float = 0.15

    @property
    def asks_often(self) -> bool:
        """Whether so much is asked that an autopilot that hears us answers every second."""
        return max(self.mode_rate_hz, self.timesync_rate_hz) >= _OFTEN_HZ

    def __post_init__(self) -> None:
        if self.vehicle_id is not None and not 1 <= self.vehicle_id <= 255:
            raise ValueError(f"vehicle_id is a system id from 1 to 255, not {self.vehicle_id}")
        if not 0 <= self.listen_s <= 60:
            raise ValueError(f"listen_s lies between 0 and 60 s, not {self.listen_s}")
        rates = (self.attitude_rate_hz, self.position_rate_hz, self.timesync_rate_hz)
        if not all(math.isfinite(rate) and 0.1 <= rate <= 500 for rate in rates):
            raise ValueError(f"rates lie between 0.1 and 500 Hz, not {rates}")
        if not 0 <= self.clearance_rate_hz <= 50:
            raise ValueError(f"clearance_rate_hz is 0 to 50 Hz, not {self.clearance_rate_hz}")
        if not all(0 <= rate <= 50 for rate in (self.rc_rate_hz, self.mode_rate_hz)):
            raise ValueError(
                f"rc_rate_hz and mode_rate_hz lie between 0 and 50 Hz, "
                f"not {self.rc_rate_hz} and {self.mode_rate_hz}"
            )
        if not 0.05 <= self.stall_s <= 0.2:
            raise ValueError(f"stall_s lies between 0.05 and 0.2 s, not {self.stall_s}")
