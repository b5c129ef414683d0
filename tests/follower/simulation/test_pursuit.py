"""The whole loop on a simulated clock: pixels in, MAVLink out, a vehicle that moves."""

import hashlib
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import pytest

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.flight.vision.video_sink import FlightVideo
from follower.settings.settings import load_settings
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.ground_truth import score_flight
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings
from follower_sim.world.render import Renderer
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.track import Track

pytestmark = pytest.mark.slow

FLAVOURS = ("px4", "ardupilot")
FOLLOW = {
    "servo": {"distance_m": 14.0, "target_size_m": 2.2, "elevation_deg": -25},
    "supervisor": {"search_s": 2.0, "hold_s": 1.0},
}
STANDING: dict[str, Any] = {"points": [[0, 0], [1, 0]]}
DRIVING: dict[str, Any] = {
    "points": [[0, 0], [60, 5], [120, 0]],
    "speeds": [{"at_s": 12, "speed_m_s": 3.5, "acceleration_m_s2": 1.0}],
}


def scenario(path: dict[str, Any], heading_deg: float = 0.0, **more: Any) -> Scenario:
    """A red car on a meadow, a drone behind it, a small camera."""
    return Scenario.model_validate(
        {
            "name": "test",
            "title": "A car on a meadow.",
            "duration_s": 26,
            "seed": 3,
            "targets": [{"kind": "car", "colour": "#e0401c", "path": path}],
            "camera": {"width": 320, "height": 240, "fov_deg": 90, "pitch_deg": -14, "rate_hz": 25},
            "start": {"at": [-18, 0], "heading_deg": heading_deg},
            "takeoff_height_m": 8,
            "select": {"colour": "#e0401c", "search": {"max_growth_ratio": 0.1}},
            "follow": FOLLOW,
            **more,
        }
    )


class Run:
    """A flight on a simulated clock, flown to its end."""

    def __init__(
        self,
        wanted: Scenario,
        flavour: str,
        seed: int | None = None,
        overrides: Sequence[str] = (),
        video: FlightVideo | None = None,
    ) -> None:
        self.clock = SimulatedClock()
        settings = load_settings(base=base_settings(wanted), overrides=overrides)
        ends = MemoryTransport.pair()
        extras = FlightOptions(video=video)
        world = World(wanted, seed)
        self.flight = SimulatedFlight(world, settings, flavour, self.clock, ends, extras)

    def fly(self, meddle: Any = lambda: None) -> "Run":
        fly_lockstep(self.flight, self.clock, meddle)
        return self

    @property
    def controls(self) -> list[ControlRecord]:
        return self.flight.log.controls

    def first(self, state: SupervisorState) -> ControlRecord:
        return next(record for record in self.controls if record.state is state)

    def speed(self) -> float:
        return math.hypot(*self.flight.vehicle.state.velocity_m_s)


@pytest.mark.parametrize(("flavour", "heading_deg"), [("px4", -30.0), ("ardupilot", 30.0)])
def test_the_vehicle_turns_to_the_target_and_closes_in(flavour: str, heading_deg: float) -> None:
    run = Run(scenario(STANDING, heading_deg), flavour).fly()
    began = run.first(SupervisorState.FOLLOWING).time_s
    turning = [r for r in run.controls if began + 0.5 < r.time_s < began + 1.0]
    for record in turning:  # the target is left of a heading turned right, and the reverse
        assert record.allowed.yaw_rate_rad_s * -heading_deg > 0
    end = run.flight.truth[-1]
    assert abs(math.degrees(end.azimuth_rad)) < 3
    assert end.range_m == pytest.approx(14.0, rel=0.15)
    north, _, _ = run.flight.vehicle.state.position_m
    assert north > -17


@pytest.mark.parametrize(
    ("flavour", "wanted_deg", "climbs"), [("px4", -38, True), ("ardupilot", -12, False)]
)
def test_a_target_above_the_wanted_direction_makes_it_climb(
    flavour: str, wanted_deg: float, climbs: bool
) -> None:
    """It hovers with the target at about -23 degrees: above the one wish, below the other."""
    follow = {"servo": {**FOLLOW["servo"], "elevation_deg": wanted_deg, "distance_m": 18.0}}
    run = Run(scenario(STANDING, duration_s=19, follow=follow), flavour).fly()
    began = run.first(SupervisorState.FOLLOWING).time_s
    heights = {
        round(sample.time_s - began, 2): -sample.vehicle.position_m[2]
        for sample in run.flight.truth
    }
    gained = heights[3.0] - heights[0.0]
    assert gained > 1.0 if climbs else gained < -1.0


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_driving_car_is_followed(flavour: str) -> None:
    run = Run(scenario(DRIVING), flavour).fly()
    flight = run.flight
    score = score_flight(flight.log, flight.truth, flight.goal, chosen_s=flight.chosen_s)
    assert score.losses == 0
    assert score.in_frame_share is not None
    assert score.in_frame_share > 0.99
    assert score.line_of_sight_rms_deg is not None
    assert score.line_of_sight_rms_deg < 4
    assert score.range_error_median is not None
    assert score.range_error_median < 0.2


@pytest.mark.parametrize(
    ("flavour", "fault"),
    [
        ("px4", "black"),
        ("ardupilot", "frozen"),
        ("px4", "silent"),
        ("ardupilot", "target_removed"),
    ],
)
def test_a_camera_that_fails_ends_in_a_hold_and_a_release(flavour: str, fault: str) -> None:
    failing = {"kind": fault, "from_s": 17.0}
    run = Run(scenario(DRIVING, faults=[failing], duration_s=23), flavour).fly()
    assert run.first(SupervisorState.FOLLOWING).time_s < 16.0
    states = [run.controls[0].state]
    for record in run.controls:
        if record.time_s > 17.0 and record.state is not states[-1]:
            states.append(record.state)
        if record.time_s > 17.0 + 2.0:
            assert record.asked.values[:3] == (0.0, 0.0, 0.0)
            searching = record.state is SupervisorState.SEARCHING  # it may turn after the target
            assert searching or record.asked.yaw_rate_rad_s == 0.0
    assert SupervisorState.HOLDING in states
    assert states[-1] is SupervisorState.RELEASED
    assert run.flight.stage.supervisor.reason is SupervisorReason.HOLD_TIMED_OUT
    assert run.speed() < 0.5


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_without_full_autonomy_nothing_is_armed_and_no_mode_changed(flavour: str) -> None:
    small = scenario(STANDING, duration_s=4)
    modes: set[str] = set()
    run = Run(small, flavour, overrides=["autonomy=pilot"])
    autopilot = run.flight.autopilot
    start = autopilot.mode
    run.fly(lambda: modes.add(autopilot.mode))
    assert modes == {start}
    assert not autopilot.armed
    assert not any(record.sent for record in run.controls)


def fingerprint(seed: int) -> str:
    soon = {**DRIVING, "speeds": [{**DRIVING["speeds"][0], "at_s": 8}]}
    windy = scenario(soon, wind={"mean_m_s": 2, "gust_m_s": 1}, duration_s=11)
    run = Run(windy, "px4", seed).fly()
    assert run.first(SupervisorState.FOLLOWING).time_s < 8
    digest = hashlib.sha256()
    for record in run.controls:
        digest.update(repr((record.time_s, record.asked.values, record.allowed.values)).encode())
    return digest.hexdigest()


def test_the_same_seed_gives_the_same_setpoints_bit_for_bit() -> None:
    """In this process after other flights, and in a new one with other threads."""
    here = fingerprint(1)
    assert here != fingerprint(2)
    script = f"import sys; sys.path.insert(0, {sys.path[0]!r})\n" + _ELSEWHERE
    elsewhere = subprocess.run(
        [sys.executable, "-c", script, __file__],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OMP_NUM_THREADS": "3"},
    )
    assert elsewhere.stdout.strip() == here


_ELSEWHERE = """
import importlib.util
spec = importlib.util.spec_from_file_location("pursuit", sys.argv[1])
pursuit = importlib.util.module_from_spec(spec)
spec.loader.exec_module(pursuit)
print(pursuit.fingerprint(1))
"""


class Watcher:
    """Looks at each picture."""

    def __init__(self) -> None:
        self.dark = 0

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:  # noqa: ARG002
        """Count the pictures that show nothing."""
        self.dark += not frame.image.any()


def test_pictures_are_drawn_for_those_who_look_and_a_watcher_changes_no_setpoint(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: list[float] = []
    render = Renderer.render

    def counted(self: Renderer, time_s: float, body: BodyState, exposure_s: float = 0.0) -> Image:
        drawn.append(time_s)
        return render(self, time_s, body, exposure_s)

    monkeypatch.setattr(Renderer, "render", counted)
    alone = Run(scenario(DRIVING, duration_s=12), "px4").fly()
    chosen_s, unwatched = alone.flight.chosen_s, len(drawn)
    assert chosen_s is not None
    assert min(drawn) > chosen_s - 0.2
    watcher = Watcher()
    watched = Run(scenario(DRIVING, duration_s=12), "px4", video=watcher).fly()
    assert len(drawn) - unwatched > unwatched + 100
    assert watcher.dark == 0
    assert [one.sent for one in watched.controls] == [one.sent for one in alone.controls]
    assert [one.allowed for one in watched.controls] == [one.allowed for one in alone.controls]
