"""Settings of supervision: consent, sticks, health, release, and how long each trouble is borne."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, TypeAlias

from follower_control.common.strict_config import StrictFields, check_positive, check_ranges

_LEAST = 1e-3


@dataclass(frozen=True, slots=True)
class SupervisorSettings(StrictFields):
    """How long each trouble is borne, in seconds, and how good a prediction is flown by.

    Attributes:
        link_timeout_s: silence of the autopilot's heartbeat (sent at 1 Hz).
        telemetry_timeout_s: age of attitude or position.
        frame_timeout_s: age of the newest frame that vision has answered for.
        control_timeout_s: time between two control steps.
        coast_s: how long to fly on the predicted target, ...
        coast_within_deg: ... while the standard deviation of its direction is smaller. More than
            5 degrees is for targets that are known to go on as they did behind what hides them;
            how fast is then flown is limited by `envelope.trust`, and how long there is an
            estimate at all by `estimator.restart_after_s`.
        search_s: how long to look for a lost target.
        hold_s: how long to hold before releasing.
        alone_s: without a word from us for so long the autopilot may act by itself; below PX4's
            COM_OF_LOSS_T and ArduCopter's GUID_TIMEOUT.
    """

    link_timeout_s: float = 3.0
    telemetry_timeout_s: float = 0.5
    frame_timeout_s: float = 0.5
    control_timeout_s: float = 0.2
    coast_s: float = 0.8
    coast_within_deg: float = 5.0
    search_s: float = 10.0
    hold_s: float = 3.0
    alone_s: float = 1.0

    def __post_init__(self) -> None:
        times = [name for name in self.__slots__ if name.endswith("_s")]
        check_ranges(self, coast_within_deg=(_LEAST, 180), **dict.fromkeys(times, (_LEAST, 3600)))


Way: TypeAlias = Literal["command", "terminal", "cockpit"]
"""How an operator gives orders."""


@dataclass(frozen=True, slots=True)
class ConsentSettings(StrictFields):
    """What else than the pilot's mode is needed, and what gives it anew after a release.

    Attributes:
        kind: "mode" needs the pilot's OFFBOARD or GUIDED alone; "command" a MAVLink command to us,
            "rc" a switch of the transmitter, "terminal" the Enter key, "cockpit" the web page's
            button, on top.
        again: for "mode": what begins anew after a release. "operator": a target chosen anew or
            the Enter key alone. "mode": also the pilot, by staying in another mode for
            `own_mode_s`; after that zero setpoints are sent again, and taking the mode counts.
        own_mode_s: how long another mode has to stand, with no failsafe, to be the pilot's own.
        command_system: MAVLink system id from which the command is taken.
        rc_channel: of the switch, counted from 1.
        rc_threshold_us: pulse from which on the switch is on.
        rc_reversed: it is on below.
        rc_timeout_s: a switch that is not received for so long is off.
    """

    kind: Literal["mode", "command", "rc", "terminal", "cockpit"] = "mode"
    again: Literal["operator", "mode"] = "operator"
    own_mode_s: float = 2.0
    command_system: int = 255
    rc_channel: int = 7
    rc_threshold_us: int = 1700
    rc_reversed: bool = False
    rc_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(
            self,
            own_mode_s=(_LEAST, 3600),
            command_system=(1, 255),
            rc_channel=(1, 18),
            rc_threshold_us=(900, 2100),
            rc_timeout_s=(_LEAST, 10),
        )

    def takes_orders_by(self, way: Way) -> bool:
        """Whether consent can be given in this way; it can be withdrawn in any."""
        return self.kind in ("mode", way)


@dataclass(frozen=True, slots=True)
class HealthSettings(StrictFields):
    """What is asked of the vehicle's health.

    Attributes:
        battery_to_start: smallest share of the battery with which following begins.
        battery_to_go_on: smallest share with which it goes on.
        gps_fix: smallest GPS_FIX_TYPE; 3 is a position in space. None flies without GPS.
        largest_ratio: largest innovation of velocity and horizontal position over its limit.
        stale_s: what was reported longer ago does not count any more.
    """

    battery_to_start: float = 0.3
    battery_to_go_on: float = 0.2
    gps_fix: int | None = 3
    largest_ratio: float = 1.0
    stale_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.battery_to_go_on <= self.battery_to_start <= 1:
            raise ValueError("0 <= battery_to_go_on <= battery_to_start <= 1 does not hold")
        check_positive(self, "largest_ratio", "stale_s")


class ReleaseAction(StrEnum):
    """What follows on the hold with which every release begins."""

    HOLD = "hold"
    """Zero setpoints, until the pilot takes another mode."""
    LOITER = "loiter"
    """PX4's Hold, ArduCopter's BRAKE: its LOITER would sink with a throttle that is down."""
    RTL = "rtl"
    LAND = "land"
    HAND_BACK = "hand_back"
    """Standing still, no more setpoints. ArduCopter stays where it is, in GUIDED; PX4 goes into the
    failsafe that COM_OBL_RC_ACT chooses: without RC and with its default it flew home."""


@dataclass(frozen=True, slots=True)
class ReleaseSettings(StrictFields):
    """What becomes of the vehicle after a release.

    Everything but "hold" and "hand_back" changes the autopilot's mode, which nothing else does.

    Attributes:
        action: what follows on the hold.
        retry_s: how long to wait for a mode before asking for it again.
    """

    action: ReleaseAction = ReleaseAction.HOLD
    retry_s: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(self, retry_s=(0.1, 60))


Stick = Literal["roll", "pitch", "throttle", "yaw"]


@dataclass(frozen=True, slots=True)
class StickSettings(StrictFields):
    """What sticks do while the vehicle follows; where no RC is shown, they do nothing.

    A deflection is positive to the right, forward and up.

    Attributes:
        nudge: whether they shift what is wanted.
        takeover: from this share of the full deflection on, roll, pitch or yaw take over: hold and
            release. None: never.
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
        if len(set(self.channels)) < 4 or not all(1 <= channel <= 18 for channel in self.channels):
            raise ValueError(f"four sticks have four channels from 1 to 18, not {self.channels}")
        check_ranges(
            self,
            max_distance_m=(0, 50),
            max_side_m_s=(0, 50),
            max_elevation_deg=(0, 45),
            max_bearing_deg=(0, 45),
            centre_us=(1200, 1800),
            throw_us=(100, 700),
        )

    @property
    def channels(self) -> tuple[int, int, int, int]:
        """The channels of roll, pitch, throttle and yaw."""
        return self.roll_channel, self.pitch_channel, self.throttle_channel, self.yaw_channel
