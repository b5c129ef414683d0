"""The setpoints that would be sent if a recording were a flight."""

from __future__ import annotations

from dataclasses import replace

from follower.control_stage import ControlStage
from follower.flightlog import FlightLog, TrackRecord
from follower.settings import Settings
from follower_control.envelope import EnvelopeSettings
from follower_control.vehicle import VehicleState
from follower_vision.frame import Frame


class RecordedControl:
    """Steps control through a recording, on the recording's own time.

    There is no telemetry: the estimator works on the body's axes, and the envelope does without
    the limits that need a height or a position. The vehicle is taken to stand still and to allow
    following all the time.

    Args:
        settings: all of them; the camera's have to fit the recording.
        log: takes the control records.
        first: the frame in which the target is chosen.
    """

    def __init__(self, settings: Settings, log: FlightLog, first: Frame) -> None:
        settings = settings.model_copy(update={"envelope": _without_position(settings)})
        camera = settings.camera.model(first.width, first.height)
        self._control = ControlStage(settings, camera, log, needs_telemetry=False)
        self._period_s = 1.0 / settings.control_rate_hz
        self._due_s = first.captured_s

    def step(self, newest: TrackRecord, next_frame_s: float | None) -> None:
        """Step control at its own rate up to the next frame, once more after the last one."""
        end_s = self._due_s + self._period_s / 2 if next_frame_s is None else next_frame_s
        while self._due_s < end_s:
            here = VehicleState(
                mode="recorded", obeys_setpoints=True, armed=True, heartbeat_s=self._due_s
            )
            self._control.step(self._due_s, newest, here)
            self._due_s += self._period_s


def _without_position(settings: Settings) -> EnvelopeSettings:
    return replace(settings.envelope, min_height_m=None, ceiling_m=None, fence_radius_m=None)
