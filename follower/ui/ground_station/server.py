"""Runs camera, parameters and the target's report on a thread of their own."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.ground_station.camera import Camera
from follower.ground_station.camera_definition import PATH, definition_version, definition_xml
from follower.ground_station.camera_messages import Definition
from follower.ground_station.endpoint import Endpoint
from follower.ground_station.file_server import FileServer
from follower.ground_station.flight_view import FlightView
from follower.ground_station.lens import Lens
from follower.ground_station.parameter_ext_server import ParameterExtServer
from follower.ground_station.parameter_server import ParameterServer
from follower.ground_station.settings import GroundStationSettings, TargetMessage
from follower.ground_station.target_report import TargetReport
from follower.links.autopilot_link import COMPONENT_ID
from follower.links.packets import Packet
from follower_vision.clock import Clock
from follower_vision.framesource import ClosesItself

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
_EXTENDED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_EXT_SET,
    }
)
_HEARTBEAT = int(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
_FILES = int(mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL)
HEARD = frozenset({*_COMMANDS, *_PARAMETERS, *_EXTENDED, _HEARTBEAT, _FILES})


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
        lens: Lens,
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
        self._extended: ParameterExtServer | None = None
        self._files: FileServer | None = None
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
        if self._extended is not None and not self._clashed:
            self._extended.step(now_s)
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
        definition = Definition(settings.definition_uri)
        if settings.parameters:
            computer = Endpoint(system, COMPONENT_ID, send)
            self._parameters = ParameterServer(computer, view.requests, self._save)
            self._extended = ParameterExtServer(endpoint, view.requests)
            definition = self._offer_definition(endpoint)
        self._camera = Camera(settings, endpoint, view, self._lens, definition, self._save)
        if settings.target is not TargetMessage.NONE:
            target = Endpoint(settings.target_system, COMPONENT_ID, send)
            self._target = TargetReport(settings, target, view)

    def _offer_definition(self, endpoint: Endpoint) -> Definition:
        """Return where the definition file is: at the given address, else with us."""
        data = definition_xml(self._view.requests.settings)
        version = definition_version(data)
        if self._settings.definition_uri:
            return Definition(self._settings.definition_uri, version)
        self._files = FileServer(endpoint, PATH, data)
        return Definition(f"mftp://[;comp={endpoint.component}]{PATH}", version)

    def _hear(self, packet: Packet, now_s: float) -> None:
        message = self._decoder.decode(bytearray(packet.data))
        number = packet.message_id
        if number == _HEARTBEAT:
            self._look_for_another(packet, message, now_s)
        if self._parameters is not None and (number == _HEARTBEAT or number in _PARAMETERS):
            self._parameters.hear(message, now_s)
        if self._clashed:
            return
        if number in _COMMANDS and self._camera is not None:
            self._camera.hear(message, now_s)
        elif number in _EXTENDED and self._extended is not None:
            self._extended.hear(message)
        elif number == _FILES and self._files is not None:
            self._files.hear(message)

    def _look_for_another(self, packet: Packet, message: Any, now_s: float) -> None:
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
            "if there is none, somebody pretends: sign the link (docs/links.md)"
        )
        self._view.requests.note((note,))
