"""Shows a flight to its station, moment by moment."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Protocol

from follower.cockpit.live_settings import setting_list, setting_values
from follower.cockpit.moment import moment
from follower.cockpit.operator import FlightOperator
from follower.control_stage import ControlStage
from follower.flightlog import FlightLog
from follower.live_status import LiveStatus
from follower.operator_requests import OperatorRequests
from follower.preflight.check import Result
from follower.settings import Settings
from follower.station.station import Station
from follower.station.wire import Message
from follower_vision.framesource import ClosesItself

_EVERY_S = 0.1


class ShownFlight(Protocol):
    """A flight that a page can show and ask for something."""

    requests: OperatorRequests
    stage: ControlStage
    log: FlightLog


class FlightShow:
    """Connects one flight with its station.

    Args:
        station: of the flight.
        flight: that is beginning.
    """

    def __init__(self, station: Station, flight: ShownFlight) -> None:
        self._station = station
        self._flight = flight
        self._settings: Settings | None = None
        station.operator = FlightOperator(flight.requests, flight.stage.hear_cockpit)

    def show(self, status: LiveStatus) -> None:
        """Show the present moment."""
        settings = self._flight.requests.settings
        if settings is not self._settings:
            self._settings = settings
            self._station.tell_page({"values": setting_values(settings)})
        controls = self._flight.log.controls
        record = controls[-1] if controls else None
        self._station.show(moment(status, record))


class SteadyShow(ClosesItself):
    """Shows a flight ten times a second on a thread of its own.

    Whoever shows it besides may hang, as a terminal does whose network is gone: the page goes on.

    Args:
        show: shows the present moment.
    """

    def __init__(self, show: Callable[[], None]) -> None:
        self._show = show
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Show it no more."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(_EVERY_S):
            self._show()


def check_list(results: Iterable[Result]) -> list[Message]:
    """Return preflight checks as the page lists them."""
    return [
        {
            "name": one.check.name,
            "verdict": "warn" if one.skipped else str(one.finding.verdict),
            "text": " – ".join(text for text in (one.finding.why, one.finding.todo) if text),
        }
        for one in results
    ]


def first_page(mode: str, title: str, settings: Settings, folder: str = "") -> Message:
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
