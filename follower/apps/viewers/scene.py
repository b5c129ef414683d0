"""What viewers show of a flight: poses, the target's place, pictures; SI units, NED."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
from pymavlink.quaternion import QuaternionBase

from follower.flight.log import ControlRecord
from follower.recording import FlightFileError, RecordedFlight
from follower.recording.recorded_flight import check_not_of
from follower.settings.settings import Settings, as_recorded, load_settings
from follower_control.common.strict_config import SettingsError
from follower_control.servo.position_fix import TargetPosition, target_fix
from follower_control.vehicle.gimbal import camera_to_world
from follower_vision.disk import room_said
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import rotation

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_JPEG_QUALITY = 85
_SHOW_TARGET_S = 1.0
COLOURS = {"tracking": (40, 200, 60), "coasting": (240, 180, 30), "lost": (230, 50, 40)}
"""Of a track's box by its state: red, green, blue."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where something is and how it is turned against north, east, down.

    Attributes:
        position_m: north, east, down.
        turn: unit quaternion x, y, z, w: from its own axes to north, east, down.
    """

    position_m: Point
    turn: Quaternion


class FlightScene:
    """Computes what viewers draw from a recorded flight.

    Raises:
        FlightFileError: its settings are not understood.
    """

    def __init__(self, recorded: RecordedFlight) -> None:
        self._recorded = recorded
        try:
            settings = load_settings(None, as_recorded(recorded.config.settings))
        except SettingsError as error:
            raise FlightFileError(f"{recorded.folder}: its settings: {error}") from error
        self._settings: Settings = settings

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, None of a flight without frames."""
        if self._recorded.config.camera is not None or not self._recorded.frames:
            return self._recorded.config.camera
        first = self._recorded.frames[0]
        return self._settings.camera.model(first.width, first.height)

    def body(self, record: ControlRecord) -> Pose | None:
        """Return the vehicle's pose, its axes forward, right, down; None if it is not known."""
        attitude = record.vehicle.attitude
        place = _place(record)
        if place is None or attitude is None:
            return None
        return Pose(place, quaternion(rotation(*attitude.numbers[:3])))

    def eye(self, record: ControlRecord) -> Pose | None:
        """Return the camera's pose, its axes right, down, forward; None if it is not known."""
        attitude, gimbal = record.vehicle.attitude, record.vehicle.gimbal
        place = _place(record)
        if place is None or attitude is None:
            return None
        if gimbal is not None:
            return Pose(place, quaternion(camera_to_world(gimbal, attitude)))
        body = rotation(*attitude.numbers[:3])
        return Pose(place, quaternion(body @ self._settings.camera.mount.camera_to_body))

    def target(self, record: ControlRecord) -> Point | None:
        """Return where the target is by the estimate, unless it was not seen for a second."""
        estimate = record.estimate
        if estimate is None or estimate.age_s > _SHOW_TARGET_S:
            return None
        fix = self.fix(record)
        return None if fix is None else fix.position_m

    def fix(self, record: ControlRecord) -> TargetPosition | None:
        """Return where the estimate has the target, however long ago it was seen."""
        estimate = record.estimate
        if estimate is None:
            return None
        return target_fix(estimate, record.vehicle, self._settings.servo)

    def path(self) -> list[Point]:
        """Return the vehicle's places, at most ten a second."""
        places = (_place(record) for record in self._recorded.log.controls[::5])
        return [place for place in places if place is not None]

    def true_path(self) -> list[Point]:
        """Return the target's true places, of a simulated flight.

        The autopilot's origin is where the vehicle stood at first.
        """
        truth = self._recorded.truth
        if not truth:
            return []
        north, east, down = truth[0].vehicle.position_m
        places = (sample.target_position_m for sample in truth[::5])
        return [(x - north, y - east, z - down) for x, y, z in places]

    def pictures(self) -> Iterator[tuple[float, bytes]]:
        """Give each picture's time of capture in seconds, and the picture as JPEG.

        Nothing is given where the flight has no video; a remark of the flight says so.
        """
        try:
            for frame in self._recorded.pictures():
                quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
                yield frame.captured_s, cv2.imencode(".jpg", frame.image, quality)[1].tobytes()
        except FlightFileError as error:
            self._recorded.remarks.append(f"No pictures: {error}.")


def _place(record: ControlRecord) -> Point | None:
    position = record.vehicle.position
    if position is None:
        return None
    return position.north_m, position.east_m, position.down_m


def quaternion(turn: Vector) -> Quaternion:
    """Return the unit quaternion x, y, z, w of a rotation, a 3x3 matrix."""
    w, x, y, z = QuaternionBase(turn).q.tolist()
    return x, y, z, w


@contextmanager
def emptied(out: Path, recorded: RecordedFlight) -> Iterator[Path]:
    """Make a file empty, and its folder if need be, for a viewer's library to fill.

    The libraries' own errors name no file. If one comes, nothing of the file is left.

    Raises:
        OSError: it cannot be written, or is one of the flight's own.
    """
    check_not_of(recorded, out)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.open("wb").close()
    try:
        yield out
    except RuntimeError as error:
        said = f"{room_said(out)}: cannot be written: {error}"
        if out.is_file():
            out.unlink()
        raise OSError(said) from error
