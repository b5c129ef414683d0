"""What can go wrong on the way between autopilot and companion."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Faults:
    """Switches that a test or a scenario throws while the flight goes on.

    Attributes:
        silent: nothing is sent at all, not even answers; the vehicle flies on.
        telemetry_stopped: nothing but heartbeats and answers is sent.
        attitude_frozen: ATTITUDE repeats its numbers with new times.
        attitude_nan: ATTITUDE carries NaN.
        position_frozen: LOCAL_POSITION_NED repeats its numbers with new times.
        position_nan: it carries NaN.
        position_stopped: it is not sent, as when the estimator has no position.
        position_jump_m: it lies so much too far north.
        yaw_jump_rad: ATTITUDE's heading is wrong by so much.
        clock_jump_s: the autopilot's clock is ahead of what it was by so much.
        refuses_setpoints: the mode that flies set-points is not entered.
        refused_modes: names of modes that are not entered.
        deaf: nothing that arrives is heard.
        drop_sent, drop_received: probability that a packet is lost.
    """

    silent: bool = False
    telemetry_stopped: bool = False
    attitude_frozen: bool = False
    attitude_nan: bool = False
    position_frozen: bool = False
    position_nan: bool = False
    position_stopped: bool = False
    position_jump_m: float = 0.0
    yaw_jump_rad: float = 0.0
    clock_jump_s: float = 0.0
    refuses_setpoints: bool = False
    refused_modes: tuple[str, ...] = ()
    deaf: bool = False
    drop_sent: float = 0.0
    drop_received: float = 0.0
