"""A flight's log as NumPy structured arrays: a column each, its unit in its name."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower_control.target.estimate import TargetEstimate
from follower_control.vehicle.state import VehicleState

Table: TypeAlias = npt.NDArray[np.void]

_NAN = math.nan
_SETPOINT = ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s")


def arrays(log: FlightLog) -> dict[str, Table]:
    """Return "tracks", "controls" and "events", a row a record; `pandas.DataFrame` takes each.

    A number that is not known is NaN, a text "". Times are seconds on the flight's clock.
    "controls" has the setpoints in the heading frame, the estimate's direction (from north, or
    from the nose without telemetry; up is positive) and log of the angular size, and telemetry in
    north, east, down.
    """
    return {
        "tracks": _table([_track_row(one) for one in log.tracks], _TRACK),
        "controls": _table([_control_row(one) for one in log.controls], _CONTROL),
        "events": _table([(one.time_s, one.source, one.text) for one in log.events], _EVENT),
    }


_TRACK = {
    **dict.fromkeys(("sequence",), np.int64),
    **dict.fromkeys(("captured_s", "received_s", "done_s", "busy_s"), np.float64),
    **dict.fromkeys(("cx_px", "cy_px", "width_px", "height_px", "confidence"), np.float64),
    **dict.fromkeys(("state", "produced_by"), str),
}
_CONTROL = {
    **dict.fromkeys(("time_s", "late_s", "busy_s", "track_captured_s"), np.float64),
    **dict.fromkeys((f"asked_{name}" for name in _SETPOINT), np.float64),
    **dict.fromkeys((f"allowed_{name}" for name in _SETPOINT), np.float64),
    **dict.fromkeys(("azimuth_rad", "elevation_rad", "log_scale"), np.float64),
    **dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), np.float64),
    **dict.fromkeys(("north_m", "east_m", "down_m"), np.float64),
    **dict.fromkeys((f"velocity_{name}_m_s" for name in ("north", "east", "down")), np.float64),
    **dict.fromkeys(("state", "reason", "limits", "mode"), str),
    **dict.fromkeys(("sent", "armed"), np.bool_),
}
_EVENT = {"time_s": np.float64, "source": str, "text": str}


def _table(rows: Sequence[tuple[Any, ...]], columns: Mapping[str, Any]) -> Table:
    """Return rows as a structured array; a column of text is as wide as its longest."""
    kinds = [
        (name, f"U{max((len(row[place]) for row in rows), default=1) or 1}")
        if kind is str
        else (name, kind)
        for place, (name, kind) in enumerate(columns.items())
    ]
    return np.array(rows, dtype=kinds)


def _track_row(record: TrackRecord) -> tuple[Any, ...]:
    times = (record.captured_s, record.received_s, record.done_s, record.busy_s)
    track = record.track
    if track is None:
        return (record.sequence, *times, *(_NAN,) * 5, "", "")
    box = (track.box.cx, track.box.cy, track.box.width, track.box.height)
    said = (track.confidence, str(track.state), track.produced_by)
    return (record.sequence, *times, *box, *said)


def _control_row(record: ControlRecord) -> tuple[Any, ...]:
    captured_s = _NAN if record.track_captured_s is None else record.track_captured_s
    return (
        *(record.time_s, record.late_s, record.busy_s, captured_s),
        *record.asked.values,
        *record.allowed.values,
        *_direction(record.estimate),
        *_motion(record.vehicle),
        *(str(record.state), str(record.reason), "|".join(record.limits), record.vehicle.mode),
        *(record.sent, record.vehicle.armed),
    )


def _direction(estimate: TargetEstimate | None) -> tuple[float, ...]:
    if estimate is None:
        return (_NAN,) * 3
    return estimate.azimuth_rad, estimate.elevation_rad, estimate.log_scale


def _motion(vehicle: VehicleState) -> tuple[float, ...]:
    """Return roll, pitch and yaw, then position and velocity north, east, down."""
    unknown = (_NAN,) * 6
    attitude = unknown if vehicle.attitude is None else vehicle.attitude.numbers
    position = unknown if vehicle.position is None else vehicle.position.numbers
    return *attitude[:3], *position
