"""Reads the CSV form of recorded steps: a row a sample, with the setpoint that was streamed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from follower.identify.recording import Recording, VehicleAxis, in_heading, is_excited
from follower_control.tuning.rational import Array
from follower_control.tuning.response_data import ResponseData, TooLittleError
from follower_sim.recorded_step import RecordedStep

_WORLD_FRAMES = (1, 7)
_TURNING_RAD_S = 0.1
_LONGEST_GAP_S = 0.3


def read_steps(path: Path) -> Recording:
    """Read one file.

    Raises:
        TooLittleError: it is no such file, or nothing was asked for in it.
    """
    try:
        step = RecordedStep.load(path)
    except KeyError as error:
        raise TooLittleError(
            f"no recorded steps: the column {error} is missing; the README of "
            "autopilot_steps describes the form"
        ) from None
    except (ValueError, OSError) as error:
        raise TooLittleError(f"cannot be read as recorded steps: {error}") from None
    _check_times(step.time_s)
    if len(step.sent) < 2:
        return Recording(step.name, {}, remarks=(f"{step.name}: no setpoint changes in it",))
    return Recording(step.name, _axes(step), remarks=())


def _check_times(time_s: Array) -> None:
    """Refuse times by which a fit would be wrong without showing it.

    Raises:
        TooLittleError: a time is missing, in another unit, or follows on a gap.
    """
    missing = np.flatnonzero(~np.isfinite(time_s))
    if len(missing):
        raise TooLittleError(f"the time is missing in row {_row(int(missing[0]))}")
    if len(time_s) < 2:
        raise TooLittleError("there is one row alone")
    steps_s = np.diff(time_s)
    usual_s = float(np.median(steps_s))
    if usual_s > _LONGEST_GAP_S:
        raise TooLittleError(
            f"there are {usual_s:g} s from row to row: t_boot is in seconds, and the fit "
            f"needs at least a row each {_LONGEST_GAP_S:g} s"
        )
    longest = int(np.argmax(steps_s))
    if steps_s[longest] > _LONGEST_GAP_S:
        raise TooLittleError(
            f"{steps_s[longest]:.2f} s are missing before row {_row(longest + 1)}: cut the "
            "file in two there"
        )


def _row(index: int) -> int:
    """Return a row's number as a spreadsheet counts, with the heading as the first one."""
    return index + 2


def _axes(step: RecordedStep) -> dict[VehicleAxis, list[ResponseData]]:
    asked = np.array([(*one.velocity_m_s, one.yaw_rate_rad_s) for one in step.sent]).T
    times = np.array([one.time_s for one in step.sent])
    yaw = np.interp(times, step.time_s, np.unwrap(step.attitude_rad[2]))
    if step.sent[0].frame in _WORLD_FRAMES:
        asked[0], asked[1] = in_heading(asked[0], asked[1], yaw)
    outputs = (*step.heading_velocity_m_s, step.yaw_rate_rad_s)
    turns = float(np.abs(asked[3]).max()) > _TURNING_RAD_S
    found: dict[VehicleAxis, list[ResponseData]] = {}
    for axis, inputs, output in zip(VehicleAxis, asked, outputs, strict=True):
        record = _record(step, times, inputs, output)
        # While the nose turns, a velocity in its frame is more than this axis' answer.
        if is_excited(record, axis) and (axis.is_turn or not turns):
            found[axis] = [record]
    return found


def _record(step: RecordedStep, times: Array, inputs: Array, output: Array) -> ResponseData:
    # One clock value may come twice where telemetry repeated itself.
    fresh = np.concatenate([[True], np.diff(step.time_s) > 0])
    first = np.concatenate([np.diff(times) > 0, [True]])
    name = step.name
    return ResponseData(name, times[first], inputs[first], step.time_s[fresh], output[fresh])
