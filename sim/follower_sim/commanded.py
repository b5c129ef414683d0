"""How hard the commanded velocities change."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_control.setpoint import VelocitySetpoint

_Array = npt.NDArray[np.float64]

_ENGAGED = frozenset({"following", "coasting", "searching", "holding"})


@dataclass(frozen=True, slots=True)
class PursuitStep:
    """One step of the control loop, as far as the score needs it.

    Attributes:
        time_s: when the step ran, on the system's clock.
        state: the supervisor's state by its name: "idle", "tracking", "ready", "following",
            "coasting", "searching", "holding" or "released".
        setpoint: what was sent to the autopilot, None if nothing was.
        limits: names of the envelope's limits that changed it.
    """

    time_s: float
    state: str
    setpoint: VelocitySetpoint | None
    limits: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CommandedPeaks:
    """The largest change of what was commanded, all in the heading frame; 0 if nothing was.

    Acceleration is the difference of two setpoints sent one after the other over the time between
    them; jerk is the difference of two such accelerations over the later one's time, which is how
    the envelope counts it. Horizontal is the length of the vector (forward, right); the turning of
    the heading itself is not counted. Setpoints with unsent steps between them are not compared,
    nor is the last hold before following with the first setpoint of it, which begins at the
    vehicle's own velocity.
    """

    horizontal_acceleration_m_s2: float
    vertical_acceleration_m_s2: float
    yaw_acceleration_deg_s2: float
    horizontal_jerk_m_s3: float
    vertical_jerk_m_s3: float
    yaw_jerk_deg_s3: float


def commanded_peaks(steps: Sequence[PursuitStep]) -> CommandedPeaks:
    """Return the largest accelerations and jerks of the setpoints sent, in the order of time."""
    peaks = np.zeros((2, 3))
    for run in _unbroken(steps):
        peaks = np.maximum(peaks, _run_peaks(run))
    (acceleration, vertical, yaw), (jerk, vertical_jerk, yaw_jerk) = peaks.tolist()
    return CommandedPeaks(
        acceleration, vertical, math.degrees(yaw), jerk, vertical_jerk, math.degrees(yaw_jerk)
    )


def _unbroken(steps: Sequence[PursuitStep]) -> Iterable[_Array]:
    """Yield runs of steps that were all sent: rows of (time, forward, right, down, yaw rate)."""
    run: list[tuple[float, ...]] = []
    engaged = False
    for step in steps:
        engages = step.state in _ENGAGED and not engaged
        engaged = step.state in _ENGAGED
        if step.setpoint is None or engages:
            yield np.array(run)
            run = []
        if step.setpoint is not None and (not run or step.time_s > run[-1][0]):
            run.append((step.time_s, *step.setpoint.values))
    yield np.array(run)


def _run_peaks(run: _Array) -> _Array:
    """Return the peaks of one run: rows acceleration, jerk; columns horizontal, vertical, yaw."""
    if len(run) < 2:
        return np.zeros((2, 3))
    interval = np.diff(run[:, 0])[:, None]
    acceleration = np.diff(run[:, 1:], axis=0) / interval
    jerk = np.diff(acceleration, axis=0) / interval[1:]
    return np.array([_largest(acceleration), _largest(jerk)])


def _largest(change: _Array) -> _Array:
    """Return the largest horizontal, vertical and yaw component, shape (3,), of (N, 4)."""
    if not len(change):
        return np.zeros(3)
    horizontal = np.hypot(change[:, 0], change[:, 1])
    return np.array(
        [horizontal.max(), np.abs(change[:, 2]).max(), np.abs(change[:, 3]).max()], np.float64
    )
