"""`follower replay --cockpit`: a recorded flight on the page, at its own pace."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console

from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.lockstep import Pacer
from follower.flight.log import TrackRecord
from follower.flight.status import LiveStatus
from follower.recording import RecordedFlight, open_flight
from follower.recording.messages import FrameRecord, StepRecord
from follower.recording.video_reader import FrameFinder, video_problem
from follower.recording.video_writer import VIDEO
from follower.settings.settings import Settings
from follower.ui.cockpit.publisher import initial_state, setting_values, state_message
from follower.ui.cockpit.recordings_api import RecordingFolder
from follower.ui.cockpit.requests import REQUESTS, ShowRecording
from follower.ui.cockpit.start import open_station
from follower.ui.ipc.messages import Message
from follower.ui.ipc.server_client import UiProcessClient
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import StopOnInterrupt
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Frame

_SHOW_EVERY_S = 0.1
_REFUSED: Message = {"accepted": False, "text": "this is a replay: the flight is over"}


def replay_on_page(folder: Path, overrides: Sequence[str] = ()) -> None:
    """Play a flight on the page, and then what users choose there, until Ctrl-C.

    Control's answers are those of today's code with these settings, from the recorded tracks.

    Raises:
        FlightFileError: the flight cannot be read.
        SettingsError: an override cannot be used.
    """
    flight = open_flight(folder)
    settings = replay_settings(flight, overrides)
    console, runs = Console(), flight.folder.resolve().parent

    def say(text: str) -> None:
        print_line(console, text)

    page = initial_state("replay", _title(flight), settings)
    station = open_station(settings, True, page, runs, say)
    if station is None:
        return
    player = Player(station, RecordingFolder(runs))
    station.operator = player
    with station, StopOnInterrupt(player.stop):
        say("Ctrl-C ends the replay.")
        player.play(flight, settings)
        while (name := player.chosen()) is not None:
            _play_other(player, station, runs / name, overrides)


def _play_other(
    player: Player, station: UiProcessClient, folder: Path, overrides: Sequence[str]
) -> None:
    try:
        flight = open_flight(folder)
        player.play(flight, replay_settings(flight, overrides))
    # The page has no other place to say what is wrong with a file.
    except (ValueError, OSError) as error:
        station.tell_page({"title": " ".join(str(error).split())})


class _EndedError(Exception):
    """Something else is to be played."""


class Player:
    """Plays flights, and takes the choice of another."""

    def __init__(self, station: UiProcessClient, flights: RecordingFolder) -> None:
        self._station = station
        self._flights = flights
        self._chosen: str | None = None
        self._ended = threading.Event()
        self._woken = threading.Event()

    def ask(self, request: Message, by: str) -> Message:
        """Take the choice of another flight; anything else is refused."""
        del by
        try:
            wanted = REQUESTS.validate_python({k: v for k, v in request.items() if k != "number"})
        except ValidationError:
            wanted = None
        if not isinstance(wanted, ShowRecording):
            return _REFUSED
        if wanted.flight not in {flight.name for flight in self._flights.listed()}:
            return {"accepted": False, "text": "there is no such flight"}
        self._chosen = wanted.flight
        self._woken.set()
        return {"accepted": True, "text": f"playing {wanted.flight}"}

    def late_answers(self) -> Sequence[Message]:
        """Return nothing: every answer is known at once."""
        return ()

    def heard(self) -> None:
        """Go on, whoever is there."""

    def stop(self) -> None:
        """End what is played, and the choosing."""
        self._ended.set()
        self._woken.set()

    def chosen(self) -> str | None:
        """Wait until somebody chooses a flight and return its name; None after `stop`."""
        self._woken.wait()
        self._woken.clear()
        name, self._chosen = self._chosen, None
        return None if self._ended.is_set() else name

    def play(self, flight: RecordedFlight, settings: Settings) -> None:
        """Play a flight to its end, or until something else is chosen."""
        self._station.tell_page({"title": _title(flight), "values": setting_values(settings)})
        show = _Showing(self._station, flight, self._woken)
        replay = Replay(flight, settings, tracks_recorded=True, on_message=show)
        show.replay = replay
        try:
            replay.run()
        except _EndedError:
            return


class _Showing:
    """Shows each message of a flight when its time has come."""

    def __init__(
        self, station: UiProcessClient, flight: RecordedFlight, woken: threading.Event
    ) -> None:
        self.replay: Replay | None = None
        self._station = station
        self._woken = woken
        readable = video_problem(flight.folder / VIDEO) is None
        self._pictures = FrameFinder(flight.pictures() if readable else iter(()))
        self._clock = SimulatedClock()
        self._pace: Pacer | None = None
        self._begin_s = self._shown_s = 0.0
        self._frame: Frame | None = None

    def __call__(self, time_s: float, message: object) -> None:
        if self._woken.is_set():
            raise _EndedError
        self._keep_pace(time_s)
        match message:
            case FrameRecord():
                self._frame = self._pictures.of(message)
            case TrackRecord():
                self._show_frame(message)
            case StepRecord() if self.replay and time_s - self._shown_s >= _SHOW_EVERY_S:
                self._shown_s = time_s
                self._show_state(self.replay)

    def _keep_pace(self, time_s: float) -> None:
        if self._pace is None:
            self._clock = SimulatedClock(time_s)
            self._pace = Pacer(self._clock)
            self._begin_s = self._shown_s = time_s
        while time_s > self._clock.now():  # in short waits: a gap in a flight may be an hour
            if self._woken.is_set():
                raise _EndedError
            self._clock.sleep_until(min(time_s, self._clock.now() + _SHOW_EVERY_S))
            self._pace.wait()

    def _show_frame(self, record: TrackRecord) -> None:
        if self._frame is not None and self._frame.sequence == record.sequence:
            tracks = () if record.track is None else (record.track,)
            self._station.add(self._frame, tracks, ())

    def _show_state(self, replay: Replay) -> None:
        log = replay.log
        status = LiveStatus.of(log, self._begin_s, None, replay.stage.servo.errors)
        self._station.show(state_message(status, log.controls[-1] if log.controls else None))


def _title(flight: RecordedFlight) -> str:
    title = flight.config.run.get("title") or flight.config.run.get("target") or ""
    name = flight.folder.resolve().name
    return f"{name}: {title}" if title else name
