"""Flies the setpoints of a recording again, on a simulated autopilot, through MAVLink."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.scoring.recorded_step import RecordedStep, SentSetpoint
from follower_sim.vehicle.vehicle import WindField

_HEIGHT_M = 30.0
_SEND_S = 0.05
_TICK_S = 0.01
_LEAD_S = 1.0


class Companion:
    """A bare sender of setpoints and mode changes, for steps and tests."""

    def __init__(self, transport: MemoryTransport) -> None:
        self._transport = transport
        self._codec = mavlink.MAVLink(None, 1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._codec.robust_parsing = True

    def send(self, message: Any) -> None:
        """Send one message."""
        self._transport.send(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256

    def hear(self) -> list[Any]:
        """Return what has arrived."""
        return self._codec.parse_buffer(self._transport.receive()) or []

    def set_mode(self, custom_mode: int) -> None:
        """Send SET_MODE."""
        self.send(mavlink.MAVLink_set_mode_message(1, 1, custom_mode))

    def stream(self, sent: SentSetpoint) -> None:
        """Send SET_POSITION_TARGET_LOCAL_NED once."""
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                *(0, 1, 1, sent.frame, sent.type_mask),
                *(0.0, 0.0, 0.0),
                *sent.velocity_m_s,
                *(0.0, 0.0, 0.0),
                0.0,
                sent.yaw_rate_rad_s,
            )
        )


def fly_again(
    flavour: str,
    recorded: RecordedStep,
    wind: WindField | None = None,
    by_recorded_heading: bool = False,
) -> RecordedStep:
    """Return what the simulated autopilot does with a recording's setpoints, at its times.

    Args:
        flavour: "px4" or "ardupilot".
        recorded: what was flown.
        wind: the air's velocity at a time of the recording.
        by_recorded_heading: turn velocities of the heading frame into the world by the recorded
            heading. Flown open loop for minutes, the simulated heading drifts from it, and the
            wind and the velocity loops' integrals do not turn with it.
    """
    ours, theirs = MemoryTransport.pair()
    yaw = float(recorded.attitude_rad[2, 0])
    start = BodyState(-_LEAD_S, (0.0, 0.0, -_HEIGHT_M), attitude_rad=(0.0, 0.0, yaw))
    autopilot = SimAutopilot(flavour, theirs, start, wind)
    companion = Companion(ours)
    first = recorded.sent[0]
    _engage(flavour, autopilot, companion, first)
    states, sent, next_send = [], first, 0.0
    due = list(recorded.sent[1:])
    for tick in range(int(recorded.time_s[-1] / _TICK_S) + 1):
        now = tick * _TICK_S
        if due and now >= due[0].time_s - 1e-9:
            sent, next_send = due.pop(0), now
        if now >= next_send - 1e-9:
            companion.stream(_in_world(sent, recorded, now) if by_recorded_heading else sent)
            next_send += _SEND_S
        autopilot.step(now)
        states.append(autopilot.state)
    return _recorded(recorded, states)


def _in_world(sent: SentSetpoint, recorded: RecordedStep, now_s: float) -> SentSetpoint:
    row = min(int(np.searchsorted(recorded.time_s, now_s)), len(recorded.time_s) - 1)
    yaw = float(recorded.attitude_rad[2, row])
    (forward, right, down), c, s = sent.velocity_m_s, math.cos(yaw), math.sin(yaw)
    velocity = (c * forward - s * right, s * forward + c * right, down)
    return replace(sent, frame=mavlink.MAV_FRAME_LOCAL_NED, velocity_m_s=velocity)


def _engage(
    flavour: str, autopilot: SimAutopilot, companion: Companion, first: SentSetpoint
) -> None:
    companion.stream(first)
    autopilot.step(-_LEAD_S)
    autopilot.switch_mode("OFFBOARD" if flavour == "px4" else "GUIDED")
    for tick in range(round(_LEAD_S / _SEND_S)):
        companion.stream(first)
        autopilot.step(-_LEAD_S + tick * _SEND_S)


def _recorded(recorded: RecordedStep, states: list[BodyState]) -> RecordedStep:
    return RecordedStep(
        recorded.name,
        np.array([state.time_s for state in states]),
        np.array([state.velocity_m_s for state in states]).T,
        np.array([state.attitude_rad for state in states]).T,
        np.array([state.rates_rad_s[2] for state in states]),
        np.array([-state.position_m[2] for state in states]),
        recorded.sent,
    )
