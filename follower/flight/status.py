"""What an operator wants to see of a flight while it goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import takewhile

from follower.flight.log import FlightLog, TrackRecord
from follower_control.servo.pursuit_state import ServoErrors
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_control.vehicle.state import VehicleState, heading_velocity

_RATE_OVER_S = 1.0


@dataclass(frozen=True, slots=True)
class LiveStatus:
    """The present state of a flight; None where nothing is known.

    Attributes:
        elapsed_s: since the flight's start, on the system's clock.
        total_s: how long it is to last.
        state: the supervisor's.
        reason: and why.
        phase: how far the flight without a pilot has come, "" with one.
        azimuth_error_rad: target right of the nose is positive.
        elevation_error_rad: target above where it is wanted is positive.
        range_m: distance to the target as the servo believes it.
        asked: what the servo wants.
        allowed: what the envelope lets through.
        flown: the vehicle's motion as telemetry says, in the same frame.
        track: vision's state of the target: "tracking", "coasting", "lost".
        confidence: of the track, 0 to 1.
        frame_rate_hz: frames answered for in the last second.
        vision_s: vision's work on the newest frame.
        control_s: the control step's own work.
        late_s: how late that step began.
        link: how the link to the autopilot is, in a line.
    """

    elapsed_s: float
    total_s: float | None = None
    state: str = "idle"
    reason: str = ""
    phase: str = ""
    azimuth_error_rad: float | None = None
    elevation_error_rad: float | None = None
    range_m: float | None = None
    asked: VelocitySetpoint | None = None
    allowed: VelocitySetpoint | None = None
    flown: VelocitySetpoint | None = None
    track: str = ""
    confidence: float | None = None
    frame_rate_hz: float | None = None
    vision_s: float | None = None
    control_s: float | None = None
    late_s: float | None = None
    link: str = ""

    @classmethod
    def of(
        cls,
        log: FlightLog,
        start_s: float,
        total_s: float | None = None,
        errors: ServoErrors | None = None,
        phase: str = "",
        link: str = "",
    ) -> LiveStatus:
        """Return the log's newest state.

        Args:
            log: may be growing on other threads meanwhile.
            start_s: the flight's start on the system's clock.
            total_s: how long it is to last.
            errors: what the servo saw last; shown only while it steers.
            phase: see the class.
            link: see the class.
        """
        track = log.tracks[-1] if log.tracks else None
        if not log.controls:
            return cls(0.0, total_s, phase=phase, frame_rate_hz=_frame_rate(log), link=link)
        record = log.controls[-1]
        if track is not None and record.time_s - track.done_s > _RATE_OVER_S:
            track = None  # what vision said last is not how things are
        seen = errors if record.state.steers else None
        return cls(
            elapsed_s=record.time_s - start_s,
            total_s=total_s,
            state=str(record.state),
            reason=str(record.reason),
            phase=phase,
            azimuth_error_rad=None if seen is None else seen.azimuth_rad,
            elevation_error_rad=None if seen is None else seen.elevation_rad,
            range_m=None if seen is None else seen.range_m,
            asked=record.asked if record.sent else None,
            allowed=record.allowed if record.sent else None,
            flown=_flown(record.vehicle),
            track="" if track is None or track.track is None else str(track.track.state),
            confidence=None if track is None or track.track is None else track.track.confidence,
            frame_rate_hz=_frame_rate(log, record.time_s),
            vision_s=None if track is None else track.busy_s,
            control_s=record.busy_s,
            late_s=record.late_s,
            link=link,
        )


def _flown(vehicle: VehicleState) -> VelocitySetpoint | None:
    known = vehicle.position is not None and vehicle.attitude is not None
    return heading_velocity(vehicle) if known else None


def _frame_rate(log: FlightLog, now_s: float = -math.inf) -> float | None:
    """Return the answers of the last second, counted back from now, or from the newest if later."""
    if not log.tracks:
        return None
    newest_s = max(log.tracks[-1].done_s, now_s)

    def is_recent(record: TrackRecord) -> bool:
        return record.done_s > newest_s - _RATE_OVER_S

    return sum(1 for _ in takewhile(is_recent, reversed(log.tracks))) / _RATE_OVER_S
