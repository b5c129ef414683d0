"""`follower replay --cockpit`: recorded flights on the page, which changes nothing."""

import json
import shutil
import signal
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from cockpit_client import PATIENCE_S, connect, get
from program import RunningProgram

from follower.apps.replay.playback_page import Player
from follower.apps.replay.replay import replay_settings
from follower.recording import open_flight
from follower.ui.cockpit.recordings_api import RecordingFolder


class Station:
    """Counts what it is shown."""

    moments = 0

    def tell_page(self, news: Any) -> None:
        pass

    def add(self, *picture: Any) -> None:
        pass

    def show(self, _moment: Any) -> None:
        self.moments += 1


def test_an_end_between_two_flights_ends_it(small_flight: Any, tmp_path: Path) -> None:
    station: Any = Station()
    player = Player(station, RecordingFolder(tmp_path))
    player.stop()
    flight = open_flight(small_flight.folder)
    player.play(flight, replay_settings(flight))
    assert station.moments == 0
    assert player.chosen() is None


@pytest.mark.slow
def test_an_end_in_a_gap_of_the_flight_ends_it(small_flight: Any, tmp_path: Path) -> None:
    flight = open_flight(small_flight.folder)
    first, *rest = flight._messages
    flight._messages = [first, *((time_s + 3600.0, message) for time_s, message in rest)]
    station: Any = Station()
    player = Player(station, RecordingFolder(tmp_path))
    settings = replay_settings(flight)
    playing = threading.Thread(target=player.play, args=(flight, settings), daemon=True)
    playing.start()
    time.sleep(1.0)
    assert playing.is_alive()
    player.stop()
    playing.join(PATIENCE_S)
    assert not playing.is_alive()


@pytest.mark.slow
def test_a_flight_is_played_and_then_the_one_that_is_chosen(
    small_flight: Any, tmp_path: Path
) -> None:
    for name in ("first", "second"):
        shutil.copytree(small_flight.folder, tmp_path / name)
    command = ("replay", "first", "--cockpit", "--set", "cockpit.port=0")
    with closing(RunningProgram(*command, cwd=tmp_path)) as program:
        watch(program.wait_for(r"Cockpit: (http://127.0.0.1:\d+)")[1])
        assert program.end(signal.SIGINT) == 0, program.said


def watch(url: str) -> None:
    names = {flight["name"] for flight in get(f"{url}/api/flights").json()}
    assert {"first", "second"} <= names
    with connect(url.replace("http", "ws") + "/ws", origin=url) as client:
        wait(client, lambda m: m["kind"] == "hello" and m["page"]["mode"] == "replay")
        for wish in ({"kind": "stop"}, {"kind": "change", "key": "servo.distance_m", "value": 3}):
            client.send(json.dumps({**wish, "id": 1}))
            answer = wait(client, lambda m: m["kind"] == "answer")
            assert not answer["accepted"]
            assert "replay" in answer["text"]
        client.send(json.dumps({"kind": "show", "flight": "nowhere", "id": 2}))
        assert not wait(client, lambda m: m["kind"] == "answer")["accepted"]
        client.send(json.dumps({"kind": "show", "flight": "second", "id": 3}))
        assert wait(client, lambda m: m["kind"] == "answer")["accepted"]
        wait(client, lambda m: m["kind"] == "page" and m["page"]["title"].startswith("second"))
        seen = wait(client, lambda m: m["kind"] == "track" and bool(m["tracks"]))
        assert seen["size"] == [160, 120]
        moment = wait(client, lambda m: m["kind"] == "state" and m.get("time_s", 0) > 0.5)
        assert moment["state"] != ""


def wait(client: Any, condition: Any) -> dict[str, Any]:
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        message = json.loads(client.recv(PATIENCE_S))
        if condition(message):
            return dict(message)
    raise AssertionError("it did not come")
