"""A running simulation with its cockpit, once for all tests; and a cockpit with nothing behind."""

from __future__ import annotations

import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from playwright.sync_api import Browser, Page

from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.target.selectors import colour_selector
from follower.flight.vision.video_sink import SeveralVideos
from follower.recording import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder
from follower.settings.settings import Settings, find_scenario, load_settings
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.ui.cockpit.publisher import FlightOperator, FlightPublisher, initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.ground_station.server import operators_finder
from follower.ui.ipc.messages import Message
from follower.ui.ipc.server_client import UiProcessClient
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track

WIDTH, HEIGHT = 320, 240
COLOUR = "#e0401c"
PATIENCE_MS = 120_000
_STARTS_WITHIN_S = 60.0
_LOOK_EVERY_MS = 50
_ON_TARGET_IOU = 0.3
_MARGIN_PX = 40


@pytest.fixture(scope="session")
def open_page() -> Callable[..., Page]:
    """Open a page that is waited for as long as a busy computer needs."""

    def opened(browser: Browser, **options: object) -> Page:
        page = browser.new_context(**options).new_page()
        page.set_default_timeout(PATIENCE_MS)
        return page

    return opened


@pytest.fixture(scope="session")
def picture() -> Callable[[Page, str], None]:
    """Keep a screenshot where somebody asks for it, to look at and for the docs."""
    folder = os.environ.get("FOLLOWER_SCREENSHOTS")

    def keep(page: Page, name: str) -> None:
        if folder:
            page.screenshot(path=Path(folder) / f"{name}.png")

    return keep


def circling_car(folder: Path) -> Path:
    """The winding road's car on a circle that is in view from where the drone takes off."""
    scenario = yaml.safe_load(find_scenario("winding").read_text("utf-8"))
    angles = np.arange(0, 80 * 2 * math.pi, math.pi / 6)
    points = [[12 - 12 * math.cos(a), 12 * math.sin(a)] for a in angles.tolist()]
    scenario["targets"][0]["path"] = {
        "points": points,
        "speeds": [{"at_s": 0.0, "speed_m_s": 2.0, "acceleration_m_s2": 1.0}],
    }
    scenario["camera"] |= {"width": WIDTH, "height": HEIGHT, "rate_hz": 15, "drop_probability": 0}
    scenario |= {
        "name": "circle",
        "title": "A car drives round and round.",
        "duration_s": 900,
        "scatter": [],
        "start": {"at": [-12, 0], "heading_deg": 0},
        "takeoff_height_m": 7,
    }
    scenario["ground"]["roads"] = []
    scenario.pop("expect", None)
    path = folder / "circle.yaml"
    path.write_text(yaml.safe_dump(scenario), "utf-8")
    return path


class Eye:
    """Keeps the newest frame, to see where the car is as a person would."""

    def __init__(self) -> None:
        self.frame: Frame | None = None

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        del tracks, lines
        self.frame = frame

    def car(self) -> Box | None:
        return None if self.frame is None else colour_selector(COLOUR)(self.frame)


class TimedOperator(FlightOperator):
    """Notes when a stop was received, on the flight's clock."""

    def __init__(self, flight: SimulatedFlight, clock: SimulatedClock) -> None:
        super().__init__(flight.requests, flight.stage.note_cockpit)
        self._clock = clock
        self.stops_s: list[float] = []
        self.objects = 0

    def ask(self, request: Message, by: str) -> Message | None:
        if request["kind"] == "stop":
            self.stops_s.append(self._clock.now())
        self.objects += request["kind"] == "select_object"
        return super().ask(request, by)


@dataclass
class Served:
    """Where a cockpit is."""

    port: int
    station: UiProcessClient
    said: Sequence[str] = ()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@dataclass
class FlyingSimulation(Served):
    """A simulation that goes on while tests look at it."""

    flight: SimulatedFlight = field(kw_only=True)
    clock: SimulatedClock = field(kw_only=True)
    eye: Eye = field(kw_only=True)
    operator: TimedOperator = field(kw_only=True)
    folder: Path = field(kw_only=True)
    began: Settings = field(kw_only=True)
    end: Callable[[], None] = field(kw_only=True)
    stands: threading.Event = field(kw_only=True)
    stood: threading.Event = field(kw_only=True)

    @contextmanager
    def standing_still(self) -> Iterator[None]:
        """Stop the world while a person points at something, however slow the computer is."""
        self.stood.clear()
        self.stands.set()
        try:
            assert self.stood.wait(PATIENCE_MS / 1000)
            yield
        finally:
            self.stands.clear()

    def is_on_target(self) -> bool:
        """Whether what is followed is the car, as a person would see it."""
        car, tracks = self.eye.car(), self.flight.log.tracks
        track = tracks[-1].track if tracks else None
        return car is not None and track is not None and car.iou(track.box) > _ON_TARGET_IOU

    def car_well_in_view(self) -> Box | None:
        """Return the car while it is no moment from leaving the picture."""
        car = self.eye.car()
        near_edge = (
            car is None or min(car.left, WIDTH - car.right, HEIGHT - car.bottom) < _MARGIN_PX
        )
        return None if near_edge else car

    def is_following_target(self) -> bool:
        """Whether the vehicle is steered after the car."""
        return (
            self.flight.stage.supervisor.state is SupervisorState.FOLLOWING and self.is_on_target()
        )

    def wait_for(self, page: Page, condition: Callable[[], Any], what: str) -> Any:
        """Wait until something is so, and return it."""
        for _ in range(PATIENCE_MS // _LOOK_EVERY_MS):
            if found := condition():
                return found
            page.wait_for_timeout(_LOOK_EVERY_MS)
        pytest.fail(f"waited in vain: {what}")

    def comes_within(self, page: Page, condition: Callable[[], Any], seconds: float) -> bool:
        """Say whether something is so within some seconds of the world's time."""
        end_s = self.clock.now() + seconds
        while self.clock.now() < end_s:
            if condition():
                return True
            page.wait_for_timeout(_LOOK_EVERY_MS)
        return False


@dataclass
class Said:
    """What a station said, and where it is."""

    lines: list[str] = field(default_factory=list)
    port: int = 0
    known: threading.Event = field(default_factory=threading.Event)

    def __call__(self, line: str) -> None:
        self.lines.append(line)
        found = re.search(r"Cockpit: https?://[^/]*:(\d+)", line)
        if found:
            self.port = int(found[1])
            self.known.set()


def start_station(settings: Settings, page: Message, runs: Path) -> tuple[UiProcessClient, Said]:
    said = Said()
    station = open_station(settings, True, page, runs, said)
    assert station is not None
    if not said.known.wait(_STARTS_WITHIN_S):
        station.close()
        pytest.fail(f"no cockpit within {_STARTS_WITHIN_S} s; it said {said.lines}")
    return station, said


@pytest.fixture(scope="session")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FlyingSimulation]:
    with flying(tmp_path_factory.mktemp("cockpit_runs")) as simulation:
        yield simulation


@pytest.fixture(scope="module")
def seeing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FlyingSimulation]:
    """A simulation with the detector that comes along."""
    with flying(tmp_path_factory.mktemp("seeing_runs"), "detector=embedded") as simulation:
        yield simulation


@contextmanager
def flying(runs: Path, *wanted: str) -> Iterator[FlyingSimulation]:
    """Fly a simulation with a cockpit and these settings."""
    folder = runs / "circle"
    folder.mkdir()
    scenario = load_scenario(circling_car(runs))
    overrides = ["cockpit.port=0", "recorder.video=none", *wanted]
    settings = load_settings(None, base_settings(scenario), overrides)
    world, clock, eye = World(scenario, 3), SimulatedClock(), Eye()
    _ = world.ground, world.sky, world.scenery_batch
    page = initial_state("sim", scenario.title, settings, folder.name)
    station, said = start_station(settings, page, runs)
    camera = scenario.camera.model
    config = FlightConfig.of("simulated", settings, camera=camera, epoch_ns=LOCKSTEP_EPOCH_NS)
    with station, Recorder(folder, config, clock, settings.recorder, threaded=True) as recorder:
        ends, videos = MemoryTransport.pair(), SeveralVideos((eye, station))
        finder = operators_finder(settings, cockpit=True)
        extras = FlightOptions(video=videos, recorder=recorder, finder=finder)
        flight = SimulatedFlight(world, settings, "px4", clock, ends, extras)
        flight.operate()
        show = FlightPublisher(station, flight)
        stands, stood = threading.Event(), threading.Event()

        def shown() -> None:
            show.show(flight.status())
            while stands.is_set() and not flight.finished:
                stood.set()
                time.sleep(0.02)
                show.show(flight.status())

        operator = TimedOperator(flight, clock)
        station.operator = operator
        thread = threading.Thread(
            target=fly_lockstep,
            args=(flight, clock, shown, True),
            daemon=True,
        )
        thread.start()

        def end() -> None:
            flight.stop()
            thread.join(60)
            recorder.close()

        yield FlyingSimulation(
            said.port,
            station,
            said.lines,
            flight=flight,
            clock=clock,
            eye=eye,
            operator=operator,
            folder=folder,
            began=settings,
            end=end,
            stands=stands,
            stood=stood,
        )
        flight.stop()
        thread.join(60)
        flight.close()


@dataclass
class Script:
    """An operator that notes what it is asked for."""

    asked: list[Message] = field(default_factory=list)
    heard_times: int = 0
    answers: bool = True

    def ask(self, request: Message, by: str) -> Message | None:
        self.asked.append({**request, "by": by})
        return {"accepted": True, "text": "noted"} if self.answers else None

    def late_answers(self) -> Sequence[Message]:
        return ()

    def heard(self) -> None:
        self.heard_times += 1


Serve = Callable[..., Served]


@pytest.fixture(scope="session")
def serve(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serve]:
    """Make cockpits with a scripted operator behind, that live as long as the tests."""
    stations: list[UiProcessClient] = []
    runs = tmp_path_factory.mktemp("served_runs")

    def make(*overrides: str) -> Served:
        settings = load_settings(None, None, ("cockpit.port=0", *overrides))
        page = initial_state("fly", "a test", settings, "")
        station, said = start_station(settings, page, runs)
        station.operator = Script()
        stations.append(station)
        return Served(said.port, station, said.lines)

    yield make
    for station in stations:
        station.close()


@pytest.fixture(scope="session")
def served(serve: Serve) -> Served:
    return serve()
