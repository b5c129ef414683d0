"""The setpoints that would be sent if a recording were a flight."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

from follower.flight.control.stage import ControlStage
from follower.flight.log import FlightLog, TrackRecord
from follower.settings.settings import Settings
from follower_control.vehicle.state import Attitude, VehicleState
from follower_vision.images.frame import Frame

_LONGEST_GAP_S = 10.0
"""So much of what lies between two frames is stepped through; all answers are old by then."""

TelemetryAt: TypeAlias = Callable[[float], tuple[VehicleState, Sequence[Attitude]]]
"""Returns the newest of everything at a time, and the attitudes since the last call."""


class RecordedControl:
    """Steps control through a recording, on the recording's own time.

    Without telemetry the estimator works on the body's axes, and the vehicle is taken to stand
    still. Without positions the envelope does without the limits that need a height or a place.
    The vehicle is taken to allow following all the time.

    Args:
        settings: all of them; the camera's have to fit the recording.
        log: takes the control records.
        first: the frame from which on control runs.
        telemetry: what was recorded beside the video, on its time; None if nothing was.
        has_position: whether local positions are part of it.
    """

    def __init__(
        self,
        settings: Settings,
        log: FlightLog,
        first: Frame,
        telemetry: TelemetryAt | None = None,
        has_position: bool = False,
    ) -> None:
        if not has_position:
            settings = recorded_settings(settings)
        camera = settings.camera.model_of("the video", first.width, first.height)
        self._log = log
        self._telemetry = telemetry or _standing_still
        self._control = ControlStage(settings, camera, log, needs_telemetry=has_position)
        self._period_s = 1.0 / settings.control_rate_hz
        self._due_s = first.captured_s

    def step(self, newest: TrackRecord | None, next_frame_s: float | None) -> None:
        """Step control at its own rate up to the next frame, once more after the last one.

        After a gap of more than ten seconds it goes on at that frame: time stamps may jump by days.
        """
        end_s = self._due_s + self._period_s / 2 if next_frame_s is None else next_frame_s
        left_out_s = end_s - self._due_s - _LONGEST_GAP_S
        if left_out_s > 0:
            self._step_to(newest, self._due_s + _LONGEST_GAP_S)
            gap_s = left_out_s + _LONGEST_GAP_S
            said = f"no frame for {gap_s:.0f} s: setpoints are listed for the first 10 s of them"
            self._log.note(self._due_s, "video", said)
            self._due_s = end_s
        else:
            self._step_to(newest, end_s)

    def _step_to(self, newest: TrackRecord | None, end_s: float) -> None:
        while self._due_s < end_s:
            vehicle, attitudes = self._telemetry(self._due_s)
            self._control.step(self._due_s, newest, vehicle, attitudes)
            self._due_s += self._period_s


def recorded_settings(settings: Settings) -> Settings:
    """Return the settings without the limits that need a height or a position."""
    free = replace(settings.envelope, min_height_m=None, ceiling_m=None, fence_radius_m=None)
    return settings.model_copy(update={"envelope": free})


def _standing_still(now_s: float) -> tuple[VehicleState, Sequence[Attitude]]:
    return VehicleState(mode="recorded", obeys_setpoints=True, armed=True, heartbeat_s=now_s), ()
