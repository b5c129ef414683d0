"""The MAVLink camera: answers what is asked, and takes what a pilot draws onto the video.

Camera Protocol v2, as QGroundControl, ArduPilot and MAVSDK use it; docs/ground-station.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.ground_station import camera_messages as say
from follower.ground_station.endpoint import Endpoint
from follower.ground_station.flight_view import FlightView
from follower.ground_station.lens import Lens
from follower.ground_station.place import target_place
from follower.ground_station.repeats import Repeats
from follower.ground_station.settings import GroundStationSettings
from follower.ground_station.streams import Streams
from follower.target_wish import RectangleWish, RequestRefusedError, TargetRequest

_HEARTBEAT_S = 1.0
_EARLY_S = 0.02
_IMAGE_STATUS = int(mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS)
_GEO_STATUS = int(mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_GEO_STATUS)
_ACCEPTED = int(mavlink.MAV_RESULT_ACCEPTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_FAILED = int(mavlink.MAV_RESULT_FAILED)
_UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)
_OLD_REQUESTS = {
    mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION: mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_SETTINGS: mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION: mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS: mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: (
        mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION
    ),
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
}
_Handler = Callable[[Any], int]


class Camera:
    """One camera component; knows no thread and no clock.

    Args:
        settings: see there.
        endpoint: sends as the camera.
        view: of the flight.
        lens: what the frames and their stream are like.
        definition: where its definition file is.
        save: writes the changed settings to their file; raises `RequestRefusedError` if it cannot.
    """

    def __init__(
        self,
        settings: GroundStationSettings,
        endpoint: Endpoint,
        view: FlightView,
        lens: Lens,
        definition: say.Definition = say.NO_DEFINITION,
        save: Callable[[], str] | None = None,
    ) -> None:
        self._settings = settings
        self._endpoint = endpoint
        self._view = view
        self._lens = lens
        self._definition = definition
        self._save = save
        self._repeats = Repeats()
        usual_s = 1.0 / settings.image_rate_hz
        self._streams = Streams({_IMAGE_STATUS: usual_s, _GEO_STATUS: usual_s})
        self._pending: list[TargetRequest] = []
        self._beat_s = -math.inf
        self._now_s = 0.0
        self._handlers: dict[int, _Handler] = {
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._on_request,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._on_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._on_interval_asked,
            mavlink.MAV_CMD_CAMERA_TRACK_POINT: self._on_point,
            mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE: self._on_rectangle,
            mavlink.MAV_CMD_CAMERA_STOP_TRACKING: self._on_stop_tracking,
            mavlink.MAV_CMD_SET_CAMERA_MODE: self._on_mode,
            mavlink.MAV_CMD_VIDEO_START_STREAMING: self._on_streaming,
            mavlink.MAV_CMD_VIDEO_STOP_STREAMING: self._on_streaming,
            mavlink.MAV_CMD_PREFLIGHT_STORAGE: self._on_storage,
            **dict.fromkeys(_OLD_REQUESTS, self._on_old_request),
        }

    def hear(self, message: Any, now_s: float) -> None:
        """Take a COMMAND_LONG or COMMAND_INT; others' are passed over."""
        self._now_s = now_s
        if not self._endpoint.is_for(message):
            return
        result = self._repeats.known(message, now_s)
        handler = self._handlers.get(message.command)
        asks = handler in (self._on_request, self._on_old_request, self._on_interval_asked)
        # A target may have been chosen since the same stop before: none is passed over.
        if result is None or asks or handler == self._on_stop_tracking:
            result = _UNSUPPORTED if handler is None else self._handled(handler, message)
            self._repeats.note(message, result, now_s)
        if not asks:
            self._acknowledge(message, result)

    def step(self, now_s: float) -> None:
        """Send what is due."""
        self._now_s = now_s
        if now_s - self._beat_s >= _HEARTBEAT_S - _EARLY_S:
            self._beat_s = now_s
            self._endpoint.send(say.heartbeat())
        for message_id in self._streams.due(now_s):
            self._send(message_id)
        self._report()

    def _handled(self, handler: _Handler, message: Any) -> int:
        try:
            return handler(message)
        except RequestRefusedError as refusal:
            self._endpoint.say(str(refusal), mavlink.MAV_SEVERITY_WARNING)
            return _DENIED

    def _acknowledge(self, message: Any, result: int) -> None:
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._endpoint.acknowledge(message.command, result, *sender)

    def _on_request(self, message: Any) -> int:
        return self._answer(message, message.param1)

    def _on_old_request(self, message: Any) -> int:
        return self._answer(message, _OLD_REQUESTS[message.command])

    def _answer(self, message: Any, message_id: float) -> int:
        """Acknowledge, then send what is asked for."""
        known = math.isfinite(message_id) and self._message(int(message_id)) is not None
        result = _ACCEPTED if known else _DENIED
        self._acknowledge(message, result)
        if known:
            self._send(int(message_id))
        return result

    def _on_interval(self, message: Any) -> int:
        if not math.isfinite(message.param1):
            return _DENIED
        return _ACCEPTED if self._streams.set(int(message.param1), message.param2) else _DENIED

    def _on_interval_asked(self, message: Any) -> int:
        known = math.isfinite(message.param1) and 0 <= message.param1 < 2**16
        self._acknowledge(message, _ACCEPTED if known else _DENIED)
        if known:
            number = int(message.param1)
            interval_us = self._streams.interval_us(number)
            self._endpoint.send(mavlink.MAVLink_message_interval_message(number, interval_us))
        return _ACCEPTED if known else _DENIED

    def _on_point(self, message: Any) -> int:
        x, y = message.param1, message.param2
        self._pending.append(self._view.requests.select_point(x, y, _sender(message)))
        return _ACCEPTED

    def _on_rectangle(self, message: Any) -> int:
        corners = message.param1, message.param2, message.param3, message.param4
        RectangleWish(*corners).on(*self._view.size)  # too small a one is refused at once
        self._pending.append(self._view.requests.select_rectangle(*corners, _sender(message)))
        return _ACCEPTED

    def _on_stop_tracking(self, message: Any) -> int:
        self._pending.append(self._view.requests.stop_tracking(_sender(message)))
        return _ACCEPTED

    def _on_mode(self, message: Any) -> int:
        return _ACCEPTED if message.param2 == mavlink.CAMERA_MODE_VIDEO else _DENIED

    def _on_streaming(self, message: Any) -> int:
        """The stream runs all the time: starting it is granted, stopping it is not."""
        starts = message.command == mavlink.MAV_CMD_VIDEO_START_STREAMING
        return _ACCEPTED if starts and self._settings.video_uri else _DENIED

    def _on_storage(self, message: Any) -> int:
        if message.param1 != 1 or self._save is None:
            return _DENIED
        self._endpoint.say(self._save())
        return _ACCEPTED

    def _report(self) -> None:
        """Tell what became of wishes for a target."""
        settled = [request for request in self._pending if request.outcome is not None]
        for request in settled:
            self._pending.remove(request)
            outcome = request.outcome
            if outcome is not None and outcome.accepted:
                self._endpoint.say(f"Target: {outcome.text}")
            elif outcome is not None:
                self._endpoint.say(outcome.text, mavlink.MAV_SEVERITY_WARNING)

    def _send(self, message_id: int) -> None:
        message = self._message(message_id)
        if message is not None:
            self._endpoint.send(message)

    def _message(self, message_id: int) -> Any | None:
        """Return a message that can be had, None for any other."""
        settings, view, boot_ms = self._settings, self._view, round(1000 * self._now_s) % 2**32
        lens = self._lens
        match message_id:
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                return say.heartbeat()
            case mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION:
                return say.camera_information(settings, view.size, self._definition, boot_ms)
            case mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS:
                return say.camera_settings(boot_ms)
            case mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION:
                return say.storage_information(boot_ms)
            case mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS:
                return say.capture_status(boot_ms)
            case mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION if settings.video_uri:
                return say.video_stream_information(settings, view.size, lens)
            case mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS if settings.video_uri:
                return say.video_stream_status(view.size, lens)
            case mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS:
                track = view.track(self._now_s)
                return say.tracking_image_status(track, view.size, settings.active_only)
            case mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_GEO_STATUS:
                track, place = view.track(self._now_s), target_place(view, self._now_s)
                return say.tracking_geo_status(track, place, settings.active_only)
        return None


def _sender(message: Any) -> str:
    return f"ground station {message.get_srcSystem()}"
