"""The flight's end of the cockpit: puts a client's request where every front end puts them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from pydantic import ValidationError

from follower.cockpit.requests import (
    REQUESTS,
    Change,
    Consent,
    OperatorRequest,
    SelectBox,
    SelectObject,
    SelectPoint,
    Show,
    Stop,
    StopTracking,
)
from follower.operator_requests import OperatorRequests
from follower.station.wire import Message
from follower.target_wish import RequestRefusedError, TargetRequest


class FlightOperator:
    """Carries out requests in a flight; `ask` and `late_answers` are called on different threads.

    Whatever the station's process says is checked again here: it talks to a network.

    Args:
        requests: of the flight.
        hear: takes note that the client in control is there.
    """

    def __init__(self, requests: OperatorRequests, hear: Callable[[], None]) -> None:
        self._requests = requests
        self._hear = hear
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

    def heard(self) -> None:
        """Take note that the client in control is there."""
        self._hear()

    def _carry_out(self, request: OperatorRequest, number: int, by: str) -> Message | None:
        match request:
            case Stop():
                self._requests.stop(by)
                return _answer(True, "stopping")
            case Consent(given=True):
                self._requests.give_consent("cockpit", by)
                return _answer(True, "consent given")
            case Consent():
                self._requests.withdraw_consent(by)
                return _answer(True, "consent withdrawn")
            case Change():
                self._requests.change(request.key, request.value, by)
                return _answer(True, f"{request.key} is {request.value} now")
            case Show():
                return _answer(False, "that is for a replay; this is a flight")
            case SelectPoint() | SelectBox() | SelectObject() | StopTracking():
                self._point_out(request, number, by)
                return None

    def _point_out(
        self,
        request: SelectPoint | SelectBox | SelectObject | StopTracking,
        number: int,
        by: str,
    ) -> None:
        """Ask for a target, or for none; vision answers with its next frame."""
        match request:
            case SelectPoint():
                target = self._requests.select_point(request.x, request.y, by)
            case SelectBox():
                corners = (request.left, request.top, request.right, request.bottom)
                target = self._requests.select_rectangle(*corners, by)
            case SelectObject():
                corners = (request.left, request.top, request.right, request.bottom)
                target = self._requests.select_object(*corners, by)
            case StopTracking():
                target = self._requests.stop_tracking(by)
        with self._lock:
            self._targets[number] = target


def _answer(accepted: bool, text: str) -> Message:
    return {"accepted": accepted, "text": text}
