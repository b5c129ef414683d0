"""Finds the time offset between a video and a telemetry log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from follower.telemetry import TelemetryLog
from follower_control.timeoffset import AngularRates, NoOverlapError, TimeOffset, find_offset
from follower_vision.camera import CameraModel, Vector
from follower_vision.framesource import FrameSource, SourceError
from follower_vision.imagerotation import CornerFlow, CornerFollower
from follower_vision.lineofsight import CameraMount, rotation

_AGAIN = 2
_DOWN = np.array([0.0, 0.0, 1.0])


def corner_flows(source: FrameSource, camera: CameraModel) -> Iterator[CornerFlow]:
    """Return how the corners moved from each frame to the next, up to the source's end."""
    follower = CornerFollower(camera)
    while (frame := source.read()) is not None:
        if (frame.width, frame.height) != (camera.width, camera.height):
            return
        flow = follower.step(frame)
        if flow is not None:
            yield flow


def align(flows: Sequence[CornerFlow], telemetry: TelemetryLog, mount: CameraMount) -> TimeOffset:
    """Return by how much the log's time is ahead of the video's, and how well that is known.

    At first the vehicle is taken to be level; with the offset found, the log's own attitude tells
    where the ground is, and so the vehicle's way over it from a turn.

    Raises:
        SourceError: too little is seen, or one of the two is too short.
    """
    try:
        found = find_offset(_rates(flows, mount, lambda _: (0.0, 0.0)), telemetry.rates)
        for _ in range(_AGAIN):
            tilt = _tilt_of(telemetry, found.offset_s)
            found = find_offset(_rates(flows, mount, tilt), telemetry.rates)
    except NoOverlapError as error:
        raise SourceError(f"the time offset cannot be found: {error}; give --offset") from error
    return found


def _rates(
    flows: Sequence[CornerFlow], mount: CameraMount, tilt: Callable[[float], tuple[float, float]]
) -> AngularRates:
    """Return the body's angular velocities as the image shows them."""
    to_body = mount.camera_to_body
    rows = []
    for flow in flows:
        roll, pitch = tilt((flow.start_s + flow.end_s) / 2)
        down = to_body.T @ (rotation(roll, pitch, 0.0).T @ _DOWN)
        turn = flow.rates_rad_s(down)
        if turn is not None:
            rows.append((flow.start_s, flow.end_s, *(to_body @ turn)))
    table: Vector = np.array(rows, np.float64).reshape(-1, 5)
    return AngularRates(table[:, 0], table[:, 1], table[:, 2:])


def _tilt_of(telemetry: TelemetryLog, offset_s: float) -> Callable[[float], tuple[float, float]]:
    time_s = np.array([one.time_s for one in telemetry.attitudes])
    roll = np.unwrap([one.roll_rad for one in telemetry.attitudes])
    pitch = np.array([one.pitch_rad for one in telemetry.attitudes])

    def tilt(video_s: float) -> tuple[float, float]:
        at = video_s + offset_s
        return float(np.interp(at, time_s, roll)), float(np.interp(at, time_s, pitch))

    return tilt
