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
        deaf: nothing that arrives is heard.
        drop_sent, drop_received: probability that a packet is lost.
    """

    silent: bool = False
    telemetry_stopped: bool = False
    attitude_frozen: bool = False
    attitude_nan: bool = False
    deaf: bool = False
    drop_sent: float = 0.0
    drop_received: float = 0.0
