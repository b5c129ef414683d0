"""The MAVLink messages of the camera: its properties, its video and its target."""

import math
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.settings.ui import GroundStationSettings
from follower.ui.ground_station.flight_view import CameraOptics, GeoPosition
from follower_vision.trackers.track import Track, TrackState

_CHUNK = 50


class Endpoint:
    """Sends messages as one component of a system.

    Args:
        system: MAVLink system id.
        component: MAVLink component id.
        send: takes packed messages.
    """

    def __init__(self, system: int, component: int, send: Callable[[bytes], None]) -> None:
        self.system = system
        self.component = component
        self._codec = mavlink.MAVLink(None, system, component)
        self._send = send
        self._texts = 0

    def send(self, message: Any) -> None:
        """Pack and send a message."""
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        self._send(data)

    def is_for(self, message: Any) -> bool:
        """Whether a message is addressed to this component and no other."""
        return (message.target_system, message.target_component) == (self.system, self.component)

    def acknowledge(self, command: Any, result: int) -> None:
        """Answer a COMMAND_LONG or COMMAND_INT with a MAV_RESULT."""
        sender = command.get_srcSystem(), command.get_srcComponent()
        self.send(mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *sender))

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Send a line for the pilot to read; one of more than 50 bytes goes in parts.

        A part that is not full is the last one, if need be an empty one.
        """
        data = text.encode()
        if len(data) <= _CHUNK:
            self.send(mavlink.MAVLink_statustext_message(severity, data))
            return
        self._texts = self._texts % 0xFFFF + 1
        for number, at in enumerate(range(0, len(data) + 1, _CHUNK)):
            part = data[at : at + _CHUNK]
            self.send(mavlink.MAVLink_statustext_message(severity, part, self._texts, number))


_NAN = math.nan
_NOWHERE = 2**31 - 1
_VIDEO_MODE = int(mavlink.CAMERA_MODE_VIDEO)
_TRACKS = (
    mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_POINT
    | mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE
    | mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_GEO_STATUS
)
STREAM = 1
_ACTIVE = mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE
_COASTING = mavlink.CAMERA_TRACKING_STATUS_FLAGS_COASTING
_ERROR = mavlink.CAMERA_TRACKING_STATUS_FLAGS_ERROR


def heartbeat() -> Any:
    """Return the camera's heartbeat."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_CAMERA,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavlink.MAV_STATE_ACTIVE,
        3,
    )


def camera_information(settings: GroundStationSettings, size: tuple[int, int], boot_ms: int) -> Any:
    """Return CAMERA_INFORMATION; there is no camera definition file."""
    video = mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM if settings.video_uri else 0
    return mavlink.MAVLink_camera_information_message(
        boot_ms,
        _text("follower"),
        _text("tracking camera"),
        _firmware_version(),
        *(_NAN, _NAN, _NAN),
        *size,
        0,
        _TRACKS | video,
        0,
        b"",
    )


def camera_settings(boot_ms: int) -> Any:
    """Return CAMERA_SETTINGS: it films, and has neither zoom nor focus."""
    return mavlink.MAVLink_camera_settings_message(boot_ms, _VIDEO_MODE, _NAN, _NAN)


def storage_information(boot_ms: int) -> Any:
    """Return STORAGE_INFORMATION: recordings are the follower's, not the camera's."""
    unsupported = mavlink.STORAGE_STATUS_NOT_SUPPORTED
    return mavlink.MAVLink_storage_information_message(boot_ms, 0, 0, unsupported, *([0.0] * 5))


def capture_status(boot_ms: int) -> Any:
    """Return CAMERA_CAPTURE_STATUS: nothing is captured on request."""
    return mavlink.MAVLink_camera_capture_status_message(boot_ms, 0, 0, 0.0, 0, 0.0)


def video_stream_information(
    settings: GroundStationSettings, size: tuple[int, int], lens: CameraOptics
) -> Any:
    """Return VIDEO_STREAM_INFORMATION of the one stream; the size is the frames'."""
    kind, uri = _stream_of(settings.video_uri)
    return mavlink.MAVLink_video_stream_information_message(
        STREAM,
        1,
        kind,
        mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING,
        lens.rate_hz,
        *(lens.stream_size or size),
        lens.bitrate_bit_s,
        0,
        round(lens.fov_deg),
        b"follower",
        uri.encode(),
        mavlink.VIDEO_STREAM_ENCODING_H264,
    )


def video_stream_status(size: tuple[int, int], lens: CameraOptics) -> Any:
    """Return VIDEO_STREAM_STATUS of the one stream; the size is the frames'."""
    return mavlink.MAVLink_video_stream_status_message(
        STREAM,
        mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING,
        lens.rate_hz,
        *(lens.stream_size or size),
        lens.bitrate_bit_s,
        0,
        round(lens.fov_deg),
    )


def tracking_status(track: Track | None, active_only: bool) -> int:
    """Return CAMERA_TRACKING_STATUS_FLAGS.

    A target that is lost has no box: some ground stations draw one for every flag but idle.
    """
    if track is None:
        return 0
    if track.state is TrackState.TRACKING:
        return int(_ACTIVE)
    if track.state is TrackState.COASTING:
        return int(_ACTIVE if active_only else _ACTIVE | _COASTING)
    return 0 if active_only else int(_ERROR)


def tracking_image_status(track: Track | None, size: tuple[int, int], active_only: bool) -> Any:
    """Return CAMERA_TRACKING_IMAGE_STATUS: a rectangle, also for a target chosen by a point."""
    status = tracking_status(track, active_only)
    if track is None or not status:
        nothing = (_NAN,) * 7
        none = mavlink.CAMERA_TRACKING_MODE_NONE
        return mavlink.MAVLink_camera_tracking_image_status_message(status, none, 0, *nothing)
    box, (width, height) = track.box, size
    return mavlink.MAVLink_camera_tracking_image_status_message(
        status,
        mavlink.CAMERA_TRACKING_MODE_RECTANGLE,
        mavlink.CAMERA_TRACKING_TARGET_DATA_IN_STATUS,
        box.cx / width,
        box.cy / height,
        box.scale / 2 / width,
        box.left / width,
        box.top / height,
        box.right / width,
        box.bottom / height,
    )


def tracking_geo_status(track: Track | None, place: GeoPosition | None, active_only: bool) -> Any:
    """Return CAMERA_TRACKING_GEO_STATUS; without a place all its numbers are unknown."""
    status = tracking_status(track, active_only)
    if place is None or not status:
        unknown = (_NOWHERE, _NOWHERE, *([_NAN] * 10))
        return mavlink.MAVLink_camera_tracking_geo_status_message(status, *unknown)
    fix = place.fix
    north, east, down = fix.velocity_m_s
    return mavlink.MAVLink_camera_tracking_geo_status_message(
        status,
        round(place.latitude_deg * 1e7),
        round(place.longitude_deg * 1e7),
        place.altitude_m,
        fix.horizontal_m,
        fix.vertical_m,
        *(north, east, down),
        fix.speed_m_s,
        fix.range_m,
        math.atan2(east, north) % math.tau,
        _heading_deviation(fix.speed_m_s, math.hypot(north, east)),
    )


def _heading_deviation(deviation_m_s: float, speed_m_s: float) -> float:
    """Standard deviation of a course, at most half a turn."""
    return min(deviation_m_s / speed_m_s, math.pi) if speed_m_s > 0 else math.pi


def _stream_of(uri: str) -> tuple[int, str]:
    """Return the kind of stream and its address as QGroundControl wants it."""
    if uri.startswith("rtsp://"):
        return int(mavlink.VIDEO_STREAM_TYPE_RTSP), uri
    port = uri.rpartition(":")[2]
    return int(mavlink.VIDEO_STREAM_TYPE_RTPUDP), uri if uri.startswith("udp://") else port


def _text(text: str) -> list[int]:
    return list(text.encode().ljust(32, b"\0")[:32])


def _firmware_version() -> int:
    """Return the version as CAMERA_INFORMATION packs it: major in the lowest byte."""
    numbers = [int(part) for part in version("drone-target-follower").split(".") if part.isdigit()]
    return sum((number & 0xFF) << (8 * place) for place, number in enumerate(numbers[:4]))
