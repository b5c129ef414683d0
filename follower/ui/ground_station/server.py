"""Offers camera, parameters and the target's position to ground stations, on its own thread."""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.flight.target.request import TargetFinder
from follower.flight.vision.tracker_factory import make_settings_detector
from follower.links.link import COMPONENT_ID
from follower.links.packet_parser import MavlinkPacket
from follower.settings.settings import Settings
from follower.settings.ui import GroundStationSettings, TargetMessage, fitted_size
from follower.ui.ground_station.camera import Camera
from follower.ui.ground_station.camera_messages import Endpoint
from follower.ui.ground_station.flight_view import (
    CameraOptics,
    FlightView,
    GeoPosition,
    target_place,
)
from follower.ui.ground_station.parameters import ParameterServer
from follower_vision.clock import Clock
from follower_vision.sources.frame_source import ClosesItself

_POSITION, _VELOCITY = 1 << 0, 1 << 1
_SEEN_WITHIN_S = 1.0
_LARGEST = 2**15 - 1


class TargetReport:
    """Sends the target's position as a system of its own, while it is seen; no thread, no clock.

    Args:
        settings: which messages, and how often.
        endpoint: sends as the target.
        view: of the flight.
    """

    def __init__(
        self, settings: GroundStationSettings, endpoint: Endpoint, view: FlightView
    ) -> None:
        self._settings = settings
        self._endpoint = endpoint
        self._view = view
        self._told_s = -math.inf

    def step(self, now_s: float) -> None:
        """Send what is due at `now_s`, in seconds."""
        if now_s - self._told_s < 0.95 / self._settings.target_rate_hz:
            return
        place = target_place(self._view, now_s)
        step = self._view.step(now_s)
        if place is None or step is None or step.estimate is None:
            return
        if step.estimate.age_s > _SEEN_WITHIN_S:
            return
        self._told_s = now_s
        boot_ms = round(1000 * place.fix.time_s)
        kind = self._settings.target
        if kind in (TargetMessage.FOLLOW_TARGET, TargetMessage.BOTH):
            self._endpoint.send(follow_target(place, boot_ms))
        if kind in (TargetMessage.GLOBAL_POSITION, TargetMessage.BOTH):
            self._endpoint.send(global_position(place, boot_ms))


def follow_target(place: GeoPosition, boot_ms: int) -> Any:
    """Return FOLLOW_TARGET; its covariance is horizontal and vertical deviation in metres."""
    fix = place.fix
    return mavlink.MAVLink_follow_target_message(
        boot_ms,
        _POSITION | _VELOCITY,
        round(place.latitude_deg * 1e7),
        round(place.longitude_deg * 1e7),
        place.altitude_m,
        list(fix.velocity_m_s),
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [fix.horizontal_m, fix.vertical_m, 0.0],
        0,
    )


def global_position(place: GeoPosition, boot_ms: int) -> Any:
    """Return GLOBAL_POSITION_INT, which has no place for covariance; the heading is the course."""
    north, east, down = place.fix.velocity_m_s
    course_deg = math.degrees(math.atan2(east, north)) % 360.0
    return mavlink.MAVLink_global_position_int_message(
        boot_ms % 2**32,
        round(place.latitude_deg * 1e7),
        round(place.longitude_deg * 1e7),
        round(place.altitude_m * 1000),
        round(place.above_home_m * 1000),
        *(min(max(round(100 * v), -_LARGEST), _LARGEST) for v in (north, east, down)),
        round(course_deg * 100) % 36000,
    )


_WAIT_S = 0.02
_THERE_FIRST_S = 3.0
"""Who sends heartbeats as our camera so early was there before: they come once a second."""
_COMMANDS = frozenset({mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT})
_PARAMETERS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_SET,
    }
)
_HEARTBEAT = int(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
HEARD = frozenset({*_COMMANDS, *_PARAMETERS, _HEARTBEAT})


class GroundStation(ClosesItself):
    """What a ground station sees of the follower, on the link to the autopilot.

    It begins when the link has found its vehicle, under whose system id it speaks. The link's own
    thread hands packets over and goes on; everything else is done here.

    Args:
        settings: see there.
        view: of the flight.
        lens: what the camera is like.
        clock: the system's.
        save: writes the changed settings to their file and says where; None without a file.
    """

    def __init__(
        self,
        settings: GroundStationSettings,
        view: FlightView,
        lens: CameraOptics,
        clock: Clock,
        save: Callable[[], str] | None = None,
    ) -> None:
        self._settings = settings
        self._view = view
        self._lens = lens
        self._clock = clock
        self._save = save
        self._decoder = mavlink.MAVLink(None)
        self._port = view.link.open_port(HEARD)
        self._camera: Camera | None = None
        self._parameters: ParameterServer | None = None
        self._target: TargetReport | None = None
        self._begun_s = math.inf
        self._clashed = self._warned = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ground station", daemon=True)

    def start(self) -> None:
        """Begin to answer, on a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def step(self, now_s: float, wait_s: float = 0.0) -> None:
        """Answer what has come and send what is due; what the thread does again and again."""
        packets = self._port.wait(wait_s)
        if self._camera is None and self._view.link.vehicle_id is not None:
            self._begun_s = now_s
            self._begin(self._view.link.vehicle_id)
        if self._camera is None:
            return
        for packet in packets:
            self._hear(packet, now_s)
        if not self._clashed:
            self._camera.step(now_s)
        if self._parameters is not None:
            self._parameters.step(now_s)
        if self._target is not None:
            self._target.step(now_s)

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self.step(self._clock.now(), _WAIT_S)
        finally:
            if not self._stop.is_set():
                self._view.requests.note(("nobody answers ground stations any more: an error",))

    def _begin(self, system: int) -> None:
        settings, view, send = self._settings, self._view, self._port.send
        endpoint = Endpoint(system, settings.camera_component, send)
        if settings.parameters:
            computer = Endpoint(system, COMPONENT_ID, send)
            self._parameters = ParameterServer(computer, view.requests, self._save)
        self._camera = Camera(settings, endpoint, view, self._lens)
        if settings.target is not TargetMessage.NONE:
            target = Endpoint(settings.target_system, COMPONENT_ID, send)
            self._target = TargetReport(settings, target, view)

    def _hear(self, packet: MavlinkPacket, now_s: float) -> None:
        message = self._decoder.decode(bytearray(packet.data))
        number = packet.message_id
        if number == _HEARTBEAT:
            self._look_for_another(packet, message, now_s)
        if self._parameters is not None and (number == _HEARTBEAT or number in _PARAMETERS):
            self._parameters.hear(message, now_s)
        if number in _COMMANDS and self._camera is not None and not self._clashed:
            self._camera.hear(message, now_s)

    def _look_for_another(self, packet: MavlinkPacket, message: Any, now_s: float) -> None:
        """Be silent as a camera where another one was there first with the same number.

        One that comes later, real or forged, does not take the pilot's tracking away.
        """
        number = self._settings.camera_component
        ours = self._view.link.vehicle_id, number
        if (packet.system, packet.component) != ours or self._warned:
            return
        self._warned = True
        self._clashed = now_s - self._begun_s < _THERE_FIRST_S
        who = f"another camera (type {message.type}) has component {number}"
        note = (
            f"{who} already: ours is silent; set ground_station.camera_component"
            if self._clashed
            else f"{who} now, too: ours goes on. Give one of them another number; "
            "if there is none, somebody pretends: sign the link (docs/reference/links.md)"
        )
        self._view.requests.note((note,))


@contextmanager
def open_ground_station(
    settings: Settings,
    view: FlightView,
    rate_hz: float,
    clock: Clock,
    save: Callable[[], str] | None = None,
) -> Iterator[None]:
    """Answer ground stations while entered; nothing happens unless it is enabled.

    Args:
        settings: of the flight.
        view: of it.
        rate_hz: of its frames.
        clock: the system's, which runs by itself.
        save: writes the changed settings to their file; None without one.
    """
    if not settings.ground_station.enabled:
        yield
        return
    lens = lens_of(settings, view.size, rate_hz)
    with GroundStation(_with_stream(settings), view, lens, clock, save) as station:
        station.start()
        yield


def lens_of(settings: Settings, size: tuple[int, int], rate_hz: float) -> CameraOptics:
    """Return the optics for frames of this size in pixels, and what is known of our own stream."""
    camera, video = settings.camera.model(*size), settings.video
    fov_deg = math.degrees(2 * math.atan(camera.width / (2 * camera.fx)))
    if not video.on:
        return CameraOptics(fov_deg, rate_hz)
    stream = fitted_size(*size, video.max_width_px)
    return CameraOptics(fov_deg, rate_hz, stream, 1000 * video.bitrate_kbit_s)


def operators_finder(settings: Settings, cockpit: bool) -> TargetFinder | None:
    """Return a finder whose points snap to detections, None where nobody can point.

    Its detector is its own: the tracker's may be at work on another thread.

    Raises:
        ModelError: the detector's network is missing or broken.
    """
    if not (settings.ground_station.enabled or cockpit):
        return None
    return TargetFinder(make_settings_detector(settings))


def _with_stream(settings: Settings) -> GroundStationSettings:
    """Return the settings with the address of our own video where none is given."""
    ground, video = settings.ground_station, settings.video
    if ground.video_uri:
        return ground
    if video.rtsp is not None and not video.rtsp.startswith(("0.0.0.0", "[::]")):  # noqa: S104
        return replace(ground, video_uri=f"rtsp://{video.rtsp}/live")
    if video.udp is not None:
        return replace(ground, video_uri=f"udp://0.0.0.0:{video.udp.rpartition(':')[2]}")
    return ground
