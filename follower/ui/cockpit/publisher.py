"""Sends a flight's state to the UI process, and carries out what comes back."""

import math
import threading
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, Protocol

from pydantic import ValidationError

from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.status import LiveStatus
from follower.flight.target.request import RequestRefusedError, TargetRequest
from follower.settings.field_docs import setting_meaning, unit_of
from follower.settings.live import LIMITS, LiveKey, live_keys, value_at
from follower.settings.settings import Settings
from follower.ui.cockpit.requests import (
    REQUESTS,
    ConsentCommand,
    OperatorRequest,
    SelectBox,
    SelectObject,
    SelectPoint,
    SettingCommand,
    ShowRecording,
    StopCommand,
    StopTracking,
)
from follower.ui.ipc.messages import Message
from follower.ui.ipc.server_client import UiProcessClient
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.sources.frame_source import ClosesItself

_EVERY_S = 0.1
_LARGER_IS_SAFER = "min_"
_TIMES = 4.0


class FlightOperator:
    """Carries out requests in a flight; `ask` and `late_answers` are called on different threads.

    Whatever the station's process says is checked again here: it talks to a network.

    Args:
        requests: of the flight.
        hear: takes note that the client in control is there.
    """

    def __init__(self, requests: OperatorRequests, hear: Callable[[], None]) -> None:
        self._requests = requests
        self.heard = hear
        self._lock = threading.Lock()
        self._targets: dict[int, TargetRequest] = {}

    def ask(self, request: Message, by: str) -> Message | None:
        """Carry out a request; None if what comes of it is known only with the next frame."""
        number = request["number"]
        wanted = {key: value for key, value in request.items() if key != "number"}
        try:
            return self._carry_out(REQUESTS.validate_python(wanted), number, by or "cockpit")
        except ValidationError:
            return _answer(False, "the station asked for something that is no request")
        except RequestRefusedError as refusal:
            return _answer(False, str(refusal))

    def late_answers(self) -> Sequence[Message]:
        """Return what became of targets."""
        if not self._targets:
            return ()
        with self._lock:
            settled = {n: one for n, one in self._targets.items() if one.outcome is not None}
            for number in settled:
                del self._targets[number]
        return [
            {"kind": "answer", "number": number, **_answer(one.outcome.accepted, one.outcome.text)}
            for number, one in settled.items()
            if one.outcome is not None
        ]

    def _carry_out(self, request: OperatorRequest, number: int, by: str) -> Message | None:
        requests = self._requests
        match request:
            case StopCommand():
                requests.stop(by)
                return _answer(True, "stopping")
            case ConsentCommand(given=True):
                requests.give_consent("cockpit", by)
                return _answer(True, "consent given")
            case ConsentCommand():
                requests.withdraw_consent(by)
                return _answer(True, "consent withdrawn")
            case SettingCommand():
                requests.change(request.key, request.value, by)
                return _answer(True, f"{request.key} is {request.value} now")
            case ShowRecording():
                return _answer(False, "that is for a replay; this is a flight")
            case SelectPoint():
                target = requests.select_point(request.x, request.y, by)
            case SelectBox():
                target = requests.select_rectangle(*request.corners, by)
            case SelectObject():
                target = requests.select_object(*request.corners, by)
            case StopTracking():
                target = requests.stop_tracking(by)
        with self._lock:  # vision answers with its next frame
            self._targets[number] = target
        return None


def _answer(accepted: bool, text: str) -> Message:
    return {"accepted": accepted, "text": text}


def setting_list(settings: Settings) -> list[Message]:
    """Return every setting that may be changed in flight: key, value, range, unit and meaning."""
    return [_described(one, settings) for one in live_keys()]


def setting_values(settings: Settings) -> Message:
    """Return their values by key."""
    return {one.key: _plain(value_at(settings, one.key)) for one in live_keys()}


def _described(one: LiveKey, settings: Settings) -> Message:
    value = _plain(value_at(settings, one.key))
    entry: Message = {
        "key": one.key,
        "type": "choice" if issubclass(one.kind, Enum) else one.kind.__name__,
        "value": value,
        "unit": unit_of(one.key.rpartition(".")[2]),
        "about": setting_meaning(settings, one.key),
    }
    if issubclass(one.kind, Enum):
        choices = [_plain(choice) for choice in one.kind]
        added = value not in (None, *choices)  # a follow mode of a package
        entry["choices"] = [*choices, value] if added else choices
    elif isinstance(value, int | float) and one.kind is not bool:
        entry["low"], entry["high"] = _range(one.key, float(value))
    return entry


def _range(key: str, value: float) -> tuple[float, float]:
    """Return a slider's ends; the settings' own limits are checked when it is moved.

    A limit of the envelope or the supervisor can be tightened in flight, not loosened.
    """
    section, _, name = key.partition(".")
    if section in LIMITS:
        safer_above = name.startswith(_LARGER_IS_SAFER)
        return (value, max(1.0, _TIMES * value)) if safer_above else (0.0, value)
    reach = max(1.0, _TIMES * abs(value))
    return (-reach if value < 0 else 0.0, reach)


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def state_message(status: LiveStatus, record: ControlRecord | None) -> Message:
    """Return the flight's present state as plain values; m, m/s, angles in degrees."""
    azimuth, elevation = status.azimuth_error_rad, status.elevation_error_rad
    return {
        "time_s": _finite(status.elapsed_s),
        "total_s": status.total_s,
        "state": status.state,
        "reason": status.reason,
        "phase": status.phase,
        "azimuth_deg": None if azimuth is None else _finite(math.degrees(azimuth)),
        "elevation_deg": None if elevation is None else _finite(math.degrees(elevation)),
        "range_m": _finite(status.range_m),
        "asked": _velocity(status.asked),
        "allowed": _velocity(status.allowed),
        "flown": _velocity(status.flown),
        "limits": [] if record is None else list(record.limits),
        "track": status.track,
        "confidence": _finite(status.confidence),
        "frame_rate_hz": _finite(status.frame_rate_hz),
        "vision_ms": _finite(None if status.vision_s is None else 1000 * status.vision_s),
        "control_ms": _finite(None if status.control_s is None else 1000 * status.control_s),
        "link": status.link,
        **_vehicle(record),
    }


def _vehicle(record: ControlRecord | None) -> Message:
    if record is None:
        return {"mode": "", "armed": False, "height_m": None, "consent": False, "stopped": False}
    vehicle, situation = record.vehicle, record.situation
    return {
        "mode": vehicle.mode or "",
        "armed": bool(vehicle.armed),
        "height_m": None if vehicle.position is None else _finite(vehicle.position.height_m),
        "consent": situation is not None and situation.consent_given,
        "stopped": situation is not None and situation.stop_requested,
    }


def _velocity(setpoint: VelocitySetpoint | None) -> list[float] | None:
    """Return forward, right and down in m/s, yaw rate in degrees a second."""
    if setpoint is None:
        return None
    yaw_deg_s = math.degrees(setpoint.yaw_rate_rad_s)
    values = (setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s, yaw_deg_s)
    return [round(value, 4) for value in values] if all(map(math.isfinite, values)) else None


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 4)


class PublishedFlight(Protocol):
    """A flight that a page can show and ask for something."""

    requests: OperatorRequests
    stage: ControlStage
    log: FlightLog


class FlightPublisher:
    """Connects one flight with its station."""

    def __init__(self, station: UiProcessClient, flight: PublishedFlight) -> None:
        self._station = station
        self._flight = flight
        self._settings: Settings | None = None
        station.operator = FlightOperator(flight.requests, flight.stage.note_cockpit)

    def show(self, status: LiveStatus) -> None:
        """Show the flight's present state."""
        settings = self._flight.requests.settings
        if settings is not self._settings:
            self._settings = settings
            self._station.tell_page({"values": setting_values(settings)})
        controls = self._flight.log.controls
        record = controls[-1] if controls else None
        self._station.show(state_message(status, record))


class PeriodicPublisher(ClosesItself):
    """Shows a flight ten times a second on a thread of its own.

    Whoever shows it besides may hang, as a terminal does whose network is gone: the page goes on.
    """

    def __init__(self, show: Callable[[], None]) -> None:
        self._show = show
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(_EVERY_S):
            self._show()


def initial_state(mode: str, title: str, settings: Settings, folder: str = "") -> Message:
    """Return what a page knows from the start.

    Args:
        mode: "fly", "sim" or "replay".
        title: of what is flown.
        settings: that it begins with.
        folder: name of the flight's recording, "" if it is not recorded.
    """
    return {
        "mode": mode,
        "title": title,
        "settings": setting_list(settings),
        "consent": settings.consent.kind,
        "when_lost": settings.cockpit.when_lost,
        "objects": settings.detector is not None,
        "recording": folder,
        "preflight": [],
    }
