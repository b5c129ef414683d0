"""The MAVLink camera: answers what is asked, and takes what a pilot draws onto the video.

Camera Protocol v2, as QGroundControl, ArduPilot and MAVSDK use it; docs/how-to/ground-station.md.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.flight.target.request import BoxSelection, RequestRefusedError, TargetRequest
from follower.settings.ui import GroundStationSettings
from follower.ui.ground_station import camera_messages as say
from follower.ui.ground_station.camera_messages import Endpoint
from follower.ui.ground_station.flight_view import CameraOptics, FlightView, target_place

_SAME_WITHIN_S = 1.0
_REPEATS_WITHIN_S = 10.0
_MOST = 32
_FASTEST_S = 0.02
_SLOWEST_US = 2e9
"""MESSAGE_INTERVAL has it as signed 32 bits, in microseconds."""
_STOP, _USUAL = -1.0, 0.0
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


class CommandDeduplicator:
    """Remembers what commands were answered with.

    A command that repeats an earlier one is answered alike and not carried out again: the same
    rectangle a second later shows something else.
    """

    def __init__(self) -> None:
        self._answers: dict[tuple[Any, ...], tuple[float, int]] = {}

    def known(self, message: Any, now_s: float) -> int | None:
        """Return the result that this command was answered with, None for a new one."""
        repeats = getattr(message, "confirmation", 0) > 0
        within_s = _REPEATS_WITHIN_S if repeats else _SAME_WITHIN_S
        answered_s, result = self._answers.get(_key(message), (float("-inf"), 0))
        return result if now_s - answered_s <= within_s else None

    def note(self, message: Any, result: int, now_s: float) -> None:
        """Remember an answer."""
        self._answers.pop(_key(message), None)
        self._answers[_key(message)] = now_s, result
        while len(self._answers) > _MOST:
            del self._answers[next(iter(self._answers))]


def _key(message: Any) -> tuple[Any, ...]:
    # A NaN differs from itself; its text does not.
    numbers = repr([getattr(message, f"param{number}") for number in range(1, 5)])
    return message.get_srcSystem(), message.get_srcComponent(), message.command, numbers


class PeriodicMessages:
    """The intervals of messages.

    Args:
        usual_s: each message that can be had, and its usual interval in seconds.
    """

    def __init__(self, usual_s: Mapping[int, float]) -> None:
        self._usual_s = dict(usual_s)
        self._interval_s: dict[int, float] = {}
        self._sent_s: dict[int, float] = {}

    def set(self, message_id: int, interval_us: float) -> bool:
        """Take an interval as MAV_CMD_SET_MESSAGE_INTERVAL gives it; whether it could be."""
        usual_s = self._usual_s.get(message_id)
        if usual_s is None or not math.isfinite(interval_us):
            return False
        if interval_us == _STOP:
            self._interval_s.pop(message_id, None)
            return True
        if not 0 <= interval_us <= _SLOWEST_US:
            return False
        wanted_s = usual_s if interval_us == _USUAL else interval_us / 1e6
        self._interval_s[message_id] = max(wanted_s, _FASTEST_S)
        return True

    def interval_us(self, message_id: int) -> int:
        """Return MESSAGE_INTERVAL in microseconds: -1 is never, 0 cannot be had."""
        if message_id not in self._usual_s:
            return 0
        interval_s = self._interval_s.get(message_id)
        return -1 if interval_s is None else round(1e6 * interval_s)

    def due(self, now_s: float) -> Iterator[int]:
        """Give the messages that are to be sent at `now_s`, in seconds."""
        for message_id, interval_s in list(self._interval_s.items()):
            # Half a wait of the thread early is nearer to the rate than half a wait late.
            if now_s - self._sent_s.get(message_id, -math.inf) >= 0.95 * interval_s:
                self._sent_s[message_id] = now_s
                yield message_id


class Camera:
    """One camera component; knows no thread and no clock.

    Args:
        settings: see there.
        endpoint: sends as the camera.
        view: of the flight.
        lens: what the frames and their stream are like.
    """

    def __init__(
        self,
        settings: GroundStationSettings,
        endpoint: Endpoint,
        view: FlightView,
        lens: CameraOptics,
    ) -> None:
        self._settings = settings
        self._endpoint = endpoint
        self._view = view
        self._lens = lens
        self._repeats = CommandDeduplicator()
        usual_s = 1.0 / settings.image_rate_hz
        self._streams = PeriodicMessages({_IMAGE_STATUS: usual_s, _GEO_STATUS: usual_s})
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
            **dict.fromkeys(_OLD_REQUESTS, self._on_request),
        }

    def hear(self, message: Any, now_s: float) -> None:
        """Take a COMMAND_LONG or COMMAND_INT; others' are passed over."""
        self._now_s = now_s
        if not self._endpoint.is_for(message):
            return
        result = self._repeats.known(message, now_s)
        handler = self._handlers.get(message.command)
        asks = handler in (self._on_request, self._on_interval_asked)
        # A target may have been chosen since the same stop before: none is passed over.
        if result is None or asks or handler == self._on_stop_tracking:
            result = _UNSUPPORTED if handler is None else self._handled(handler, message)
            self._repeats.note(message, result, now_s)
        if not asks:
            self._endpoint.acknowledge(message, result)

    def step(self, now_s: float) -> None:
        """Send what is due at `now_s`, in seconds."""
        self._now_s = now_s
        if now_s - self._beat_s >= _HEARTBEAT_S - _EARLY_S:
            self._beat_s = now_s
            self._endpoint.send(say.heartbeat())
        for message_id in self._streams.due(now_s):
            self._endpoint.send(self._message(message_id))
        self._report()

    def _handled(self, handler: _Handler, message: Any) -> int:
        try:
            return handler(message)
        except RequestRefusedError as refusal:
            self._endpoint.say(str(refusal), mavlink.MAV_SEVERITY_WARNING)
            return _DENIED

    def _on_request(self, message: Any) -> int:
        """Acknowledge, then send what is asked for."""
        message_id = _OLD_REQUESTS.get(message.command, message.param1)
        found = self._message(int(message_id)) if math.isfinite(message_id) else None
        result = _DENIED if found is None else _ACCEPTED
        self._endpoint.acknowledge(message, result)
        if found is not None:
            self._endpoint.send(found)
        return result

    def _on_interval(self, message: Any) -> int:
        if not math.isfinite(message.param1):
            return _DENIED
        return _ACCEPTED if self._streams.set(int(message.param1), message.param2) else _DENIED

    def _on_interval_asked(self, message: Any) -> int:
        known = math.isfinite(message.param1) and 0 <= message.param1 < 2**16
        self._endpoint.acknowledge(message, _ACCEPTED if known else _DENIED)
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
        BoxSelection(*corners).on(*self._view.size)  # too small a one is refused at once
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

    def _report(self) -> None:
        """Report the outcome of requests for a target."""
        waiting, self._pending = self._pending, []
        for request in waiting:
            outcome = request.outcome  # set on another thread
            if outcome is None:
                self._pending.append(request)
            elif outcome.accepted:
                self._endpoint.say(f"Target: {outcome.text}")
            else:
                self._endpoint.say(outcome.text, mavlink.MAV_SEVERITY_WARNING)

    def _message(self, message_id: int) -> Any | None:
        """Return a message that can be had, None for any other."""
        settings, view, boot_ms = self._settings, self._view, round(1000 * self._now_s) % 2**32
        lens = self._lens
        match message_id:
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                return say.heartbeat()
            case mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION:
                return say.camera_information(settings, view.size, boot_ms)
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
