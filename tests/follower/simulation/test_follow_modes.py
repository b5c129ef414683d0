"""The ways of following, pixels in and MAVLink out, on a simulated clock; judged by the truth."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.recording import open_flight
from follower.settings.live import SettingChange
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import SimulationOptions, VisionSource, simulation_settings
from follower.simulation.run import simulate
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_control.servo.settings import FollowMode
from follower_sim.scenario.scenario import Scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

pytestmark = pytest.mark.slow

CAR: dict[str, Any] = {
    "kind": "car",
    "colour": "#e0401c",
    "path": {
        "points": [[0, 0], [60, 0], [120, 4]],
        "speeds": [{"at_s": 9, "speed_m_s": 3.0, "acceleration_m_s2": 1.0}],
    },
}
PERSON: dict[str, Any] = {
    "kind": "person",
    "colour": "#d0202c",
    "path": {"points": [[0, 0], [1, 0]]},
}


def scenario(target: dict[str, Any], servo: dict[str, Any], **more: Any) -> Scenario:
    camera = {"fov_deg": 90, "pitch_deg": -20, "width": 320, "height": 240, "rate_hz": 15}
    return Scenario.model_validate(
        {
            "name": "test",
            "title": "A target on a meadow.",
            "duration_s": 24,
            "targets": [target],
            "camera": {**camera, "noise": 1.0, "latency_s": 0.03, **more.pop("camera", {})},
            "start": {"at": [-12, 4]},
            "takeoff_height_m": 7,
            "select": {"colour": target["colour"], "search": {"max_growth_ratio": 0.1}},
            "follow": {"servo": servo, **more.pop("follow", {})},
            **more,
        }
    )


def flown(
    wanted: Scenario, flavour: str, changes: dict[float, FollowMode] | None = None
) -> np.ndarray:
    """Return the truth of a flight, a row a control step.

    Time, the vehicle from the target (north, east, up), the target's azimuth off the nose, its
    share in the frame, and the vehicle's speed.
    """
    clock = SimulatedClock()
    settings = simulation_settings(wanted)
    flight = SimulatedFlight(World(wanted), settings, flavour, clock, MemoryTransport.pair())
    waiting = dict(changes or {})

    def show() -> None:
        if waiting and clock.now() >= min(waiting):
            mode = waiting.pop(min(waiting))
            flight.stage.repeat_changes([SettingChange.of("servo.mode", mode)])

    fly_lockstep(flight, clock, show)
    flight.close()
    rows = []
    for sample in flight.truth:
        away = np.subtract(sample.vehicle.position_m, sample.target_position_m) * (1, 1, -1)
        speed = float(np.linalg.norm(sample.vehicle.velocity_m_s))
        rows.append([sample.time_s, *away, sample.azimuth_rad, sample.in_frame_share, speed])
    return np.array(rows)


def late(rows: np.ndarray, from_s: float, until_s: float = 24.0) -> np.ndarray:
    return rows[(rows[:, 0] > from_s) & (rows[:, 0] < until_s)]


PAGE = Path(__file__).parents[3] / "docs" / "reference" / "follow-modes.md"
ROW = re.compile(r"\| (\w+)[^|]* \| (\w+) \| ([\d.]+)° \| ([\d.]+) % \|")
MEASURED = [
    (name, autopilot, (float(sight_deg), float(range_percent)))
    for name, autopilot, sight_deg, range_percent in ROW.findall(PAGE.read_text("utf-8"))
]
OTHERS = ("sides", "px4"), ("orbit", "ardupilot"), ("watch", "px4"), ("watch", "ardupilot")


# A camera that is fixed to PX4 looks past a car below: it leans by 27 degrees.
@pytest.mark.parametrize(
    ("name", "autopilot", "figures"), [*MEASURED, *((*one, None) for one in OTHERS)]
)
def test_the_shipped_scenario_of_each_mode_is_flown_within_its_limits_and_as_the_page_says(
    tmp_path: Path, name: str, autopilot: str, figures: tuple[float, float] | None
) -> None:
    options = SimulationOptions(
        name, autopilot, lockstep=True, out=tmp_path, video=False, vision=VisionSource.TRUTH
    )
    result = simulate(options)
    assert result.exit_code == 0, result.end.sentence
    if figures is not None:
        assert (result.score.in_frame_share, result.score.losses) == (1.0, 0)
        flown = result.score.line_of_sight_rms_deg, 100 * result.score.range_error_median
        assert flown == pytest.approx(figures, abs=0.06)


def test_the_page_has_the_flights_of_each_mode_with_a_distance() -> None:
    assert {name for name, _, _ in MEASURED} == {"sides", "orbit", "overhead", "gimbal"}


def test_beside_a_car_it_is_on_its_right() -> None:
    """The car drives north; the drone is to be in the east of it."""
    servo = {"mode": "side", "distance_m": 13, "range_from": "ground", "elevation_deg": -28}
    rows = late(flown(scenario(CAR, {**servo, "target_middle_m": 0.7}), "ardupilot"), 21.0)
    bearing = np.degrees(np.arctan2(rows[:, 2], rows[:, 1]))
    assert np.abs(bearing - 90).max() < 20
    assert np.abs(np.hypot(rows[:, 1], rows[:, 2]) / 11.5 - 1).max() < 0.3
    assert rows[:, 5].min() > 0.95


def test_round_a_person_it_circles_and_then_only_watches() -> None:
    servo = {
        "mode": "orbit",
        "orbit_m_s": 3.0,
        "distance_m": 10,
        "range_from": "ground",
        "target_middle_m": 1.3,
        "elevation_deg": -28,
    }
    rows = flown(scenario(PERSON, servo), "px4", {19.0: FollowMode.WATCH})
    circling, watching = late(rows, 13.0, 19.0), late(rows, 22.0)
    bearing = np.unwrap(np.arctan2(circling[:, 2], circling[:, 1]))
    rate_deg = math.degrees((bearing[-1] - bearing[0]) / (circling[-1, 0] - circling[0, 0]))
    assert rate_deg == pytest.approx(math.degrees(3.0 / 8.8), rel=0.25)
    assert np.abs(circling[:, 4]).max() < math.radians(6)
    # PX4 lets the last of a velocity go slowly.
    assert watching[:, 6].max() < 0.8
    assert np.abs(watching[:, 4]).max() < math.radians(3)


def test_above_a_car_it_stays_above() -> None:
    servo = {"mode": "overhead", "distance_m": 15, "range_from": "ground"}
    later = {**CAR["path"], "speeds": [{"at_s": 14, "speed_m_s": 3.0, "acceleration_m_s2": 1.0}]}
    wanted = scenario(
        {**CAR, "path": later}, servo, camera={"pitch_deg": -90}, start={"at": [-3, 1]}
    )
    rows = late(flown(wanted.model_copy(update={"takeoff_height_m": 13.0}), "ardupilot"), 20.0)
    assert np.hypot(rows[:, 1], rows[:, 2]).max() < 2.5
    assert np.abs(rows[:, 3] - 14.3).max() < 1.5


def test_a_gimbal_keeps_a_fast_car_in_a_narrow_view_and_is_replayed_bit_for_bit(
    tmp_path: Path,
) -> None:
    fast = {**CAR["path"], "speeds": [{"at_s": 9, "speed_m_s": 7.0, "acceleration_m_s2": 2.0}]}
    wanted = scenario(
        {**CAR, "path": fast},
        {"distance_m": 14, "range_from": "ground", "elevation_deg": -26},
        camera={"fov_deg": 45, "gimbal": {"max_rate_deg_s": 90}},
        follow={"gimbal": {"enabled": True}},
        duration_s=18,
    )
    path = tmp_path / "test.yaml"
    path.write_text(wanted.model_dump_json(exclude_defaults=True), "utf-8")
    simulate(SimulationOptions(str(path), "ardupilot", lockstep=True, out=tmp_path, video=False))
    flight = open_flight(tmp_path / "test")
    seen = [sample.in_frame_share for sample in flight.truth if sample.time_s > 9.0]
    assert np.mean(np.array(seen) > 0.95) > 0.98
    moved = [abs(record.gimbal.pitch_rad_s) for record in flight.log.controls if record.gimbal]
    assert max(moved) > 0.05
    replay = Replay(flight, replay_settings(flight), tracks_recorded=True)
    assert not compare(flight.log, replay.run()).control[0].count
    assert compare(flight.log, replay.log).identical
