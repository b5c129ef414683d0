"""`follower fly --cockpit`: the page's way in and out of a real flight's program."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from cockpit_client import PATIENCE_S, connect, get
from flying_vehicle import PATIENT
from plugin_packages import Site
from program import RunningProgram
from websockets.sync.client import ClientConnection

from follower.flight.supervision.flight_end import RELEASED_FOR_SAFETY
from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import open_flight

ROOT = Path(__file__).parents[4]
EXAMPLE = ROOT / "examples" / "follower-template-tracker" / "follower_template_tracker.py"
SQUARE = {"left": 0.58, "top": 0.4, "right": 0.73, "bottom": 0.6}
MakeVehicle = Callable[..., Any]
SETTINGS = (
    *("--set", "camera.fov_deg=70", "--set", "camera.pitch_deg=-20", "--set", "cockpit.port=0"),
    *("--set", "link.vehicle_id=1", "--set", "cockpit.when_lost=hold"),
    *("--set", "supervisor.frame_timeout_s=20", "--set", "supervisor.control_timeout_s=20"),
    *(argument for setting in PATIENT for argument in ("--set", setting)),
)


def program(link: str, video: Path, folder: Path, *options: str, **more: str) -> RunningProgram:
    arguments = ("fly", "--connect", link, "--camera", str(video), "--cockpit", *SETTINGS)
    return RunningProgram(*arguments, *options, cwd=folder, **more)


def url_of(flight: RunningProgram) -> str:
    return flight.wait_for(r"Cockpit: (http://127.0.0.1:\d+)")[1]


@pytest.fixture
def flight(port: int, video: Path, tmp_path: Path) -> Iterator[RunningProgram]:
    with closing(program(f"udpin:127.0.0.1:{port}", video, tmp_path)) as flight:
        yield flight


def told(client: ClientConnection, kind: str) -> dict[str, Any]:
    """Return the newest message of a kind, and say that we are there."""
    client.send('{"kind": "ping"}')
    while True:
        message = json.loads(client.recv(PATIENCE_S))
        if message["kind"] == kind:
            return dict(message)


def state(client: ClientConnection) -> dict[str, Any]:
    return told(client, "state")


@pytest.mark.slow
def test_choose_follow_and_lose_the_page(
    vehicle: MakeVehicle, flight: RunningProgram, tmp_path: Path, late_s: Callable[[], float]
) -> None:
    """The page chooses the target; when its process dies in flight, the vehicle holds, is released,
    and the program flies on."""
    there = vehicle("px4", 12.0)
    url = url_of(flight)
    flight.wait(lambda: "Following what the cockpit selects" in flight.said)
    checks = get(f"{url}/api/page").json()["preflight"]
    assert {"name": "camera", "verdict": "pass"}.items() <= named(checks, "camera").items()
    with connect(url.replace("http", "ws") + "/ws", origin=url) as client:
        flight.wait(lambda: "state" in state(client))
        client.send(json.dumps({"kind": "select_box", "id": 1, **SQUARE}))
        flight.wait(lambda: state(client)["state"] == "ready")
        flight.wait(lambda: there.autopilot.switch_mode(there.setpoint_mode))
        flight.wait(lambda: state(client)["state"] == "following")
        kill_station(flight.process.pid)
    flight.wait(lambda: "The station ended during the flight" in flight.said)
    flight.wait(lambda: "cockpit lost" in flight.said)
    flight.wait(lambda: "released" in flight.said)
    assert flight.process.poll() is None
    assert flight.end(signal.SIGINT) == RELEASED_FOR_SAFETY, flight.said
    assert "Released after a hold: cockpit lost" in flight.said
    records = open_flight(tmp_path / "runs" / "fly").log.controls
    states = [record.state for record in records]
    following = [record.state is SupervisorState.FOLLOWING for record in records]
    assert any(following)
    assert states[-1] is SupervisorState.RELEASED
    held = [r for r in records if r.state is SupervisorState.HOLDING]
    assert {str(record.reason) for record in held} == {"cockpit lost"}
    assert max(record.control_gap_s for record in map(situation, records)) < 1.0 + late_s()


@pytest.mark.slow
def test_the_page_shows_what_a_packages_tracker_follows(
    vehicle: MakeVehicle, port: int, video: Path, tmp_path: Path
) -> None:
    (tmp_path / "site").mkdir()
    site = Site(tmp_path / "site")
    site.add("follower-template-tracker", "trackers", "mine", EXAMPLE.read_text("utf-8"))
    vehicle("px4", 12.0)
    packages = os.pathsep.join([str(site.folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    link, options = f"udpin:127.0.0.1:{port}", ("--tracker", "mine")
    with closing(program(link, video, tmp_path, *options, PYTHONPATH=packages)) as flight:
        url = url_of(flight)
        flight.wait(lambda: "Following what the cockpit selects" in flight.said)
        with connect(url.replace("http", "ws") + "/ws", origin=url) as client:
            client.send(json.dumps({"kind": "select_box", "id": 1, **SQUARE}))
            flight.wait(lambda: state(client).get("track") == "tracking")
            flight.wait(lambda: targets(client) == [("tracking", "peak")])


def targets(client: ClientConnection) -> list[tuple[str, str]]:
    """Return the state of each track that the page is told next, and what found it."""
    return [(track["state"], track["by"]) for track in told(client, "track")["tracks"]]


def named(checks: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return next(check for check in checks if check["name"] == name)


def situation(record: Any) -> Any:
    return record.situation


def kill_station(parent: int) -> None:
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    (station,) = [
        int(pid)
        for pid in children
        if b"cockpit.process" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]
    os.kill(station, signal.SIGKILL)
