"""What can be set about the link to the autopilot."""

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from follower_control.common.strict_config import SettingsError, StrictFields, check_ranges
from follower_vision.plugins import PluginGroup

_OFTEN_HZ = 4.0


LinkKind: TypeAlias = Literal["pymavlink", "mavsdk"]
LINK_KINDS: tuple[LinkKind, ...] = get_args(LinkKind)
LINK_PLUGINS = PluginGroup(
    "follower.links", "link", ("poll", "send", "_receive", "_send_setpoint", "_send_fields")
)
"""Each makes a `Link` when it is called like `pymavlink_link.MavlinkLink`."""


def link_kinds() -> list[str]:
    """Return the kinds of links that there are; those of other packages come last."""
    return [*LINK_KINDS, *LINK_PLUGINS.names(LINK_KINDS)]


def is_link(kind: str) -> bool:
    """Return whether there is a kind of links.

    Raises:
        PluginError: two packages have it.
    """
    return kind in LINK_KINDS or LINK_PLUGINS.find(kind) is not None


def check_link(kind: str | None) -> None:
    """Refuse what `--link` names if there is no such kind of links.

    Raises:
        SettingsError: there is none, or two packages have it.
    """
    if kind is not None and not is_link(kind):
        raise SettingsError(f"--link {kind}: choose {' or '.join(link_kinds())}")


@dataclass(frozen=True, slots=True)
class LinkSettings(StrictFields):
    """The link to the autopilot.

    Attributes:
        kind: "pymavlink" (our own stream), "mavsdk" (its library's, watched by ours), or another
            package's.
        vehicle_id: MAVLink system id of the vehicle; None takes the only one that is received.
        listen_s: how long to listen for others before the only one is taken.
        attitude_rate_hz: how often ATTITUDE is asked for.
        position_rate_hz: how often LOCAL_POSITION_NED is asked for.
        rc_rate_hz: how often RC_CHANNELS is asked for, the pilot's sticks and switches; 0 never.
        clearance_rate_hz: how often DISTANCE_SENSOR and TERRAIN_REPORT are asked for; 0 never.
        mode_rate_hz: how often the mode is asked after while setpoints are sent or flown: of
            themselves autopilots report it once a second; 0 leaves it at that.
        timesync_rate_hz: how often the clocks are compared.
        signing_key_file: file of the MAVLink 2 signing key; None signs nothing and takes all.
        stall_s: a control loop that gives no setpoint for so long is taken to stand still, and
            mavsdk's stream is set to zero; it is ended 0.1 s later.
    """

    kind: str = "pymavlink"
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
        """Whether so much is asked that an autopilot that receives us answers every second."""
        return max(self.mode_rate_hz, self.timesync_rate_hz) >= _OFTEN_HZ

    def __post_init__(self) -> None:
        if not is_link(self.kind):
            raise ValueError(
                f"kind: there is no {self.kind!r}; there are {', '.join(link_kinds())}"
            )
        check_ranges(
            self,
            vehicle_id=(1, 255),
            listen_s=(0, 60),
            attitude_rate_hz=(0.1, 500),
            position_rate_hz=(0.1, 500),
            timesync_rate_hz=(0.1, 500),
            rc_rate_hz=(0, 50),
            clearance_rate_hz=(0, 50),
            mode_rate_hz=(0, 50),
            stall_s=(0.05, 0.2),
        )
