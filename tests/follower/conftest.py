"""A synthetic flight: a car in curves, a vehicle behind it that loses it once; and a browser."""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from plugin_packages import Site, installed
from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console

from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower_control.servo.settings import ServoSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_sim.kinematics import BodyState, TruthSample
from follower_sim.scoring.score import PursuitGoal
from follower_vision.geometry.box import Box
from follower_vision.geometry.line_of_sight import LineOfSight, wrap_angle
from follower_vision.trackers.track import Track, TrackState

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SIZE_M = 2.4
GOAL = PursuitGoal(distance_m=15.0, elevation_rad=math.radians(-25))
CONTROL_S, FRAME_S, START_S = 0.02, 1 / 30, 1000.0


@dataclass(frozen=True)
class SyntheticFlight:
    log: FlightLog
    truth: list[TruthSample]
    goal: PursuitGoal
    servo: ServoSettings


MakeFlight = Callable[..., SyntheticFlight]


def state_at(t: float, end_s: float) -> tuple[SupervisorState, SupervisorReason]:
    table = (
        (1.0, SupervisorState.IDLE, SupervisorReason.NO_TARGET),
        (4.0, SupervisorState.TRACKING, SupervisorReason.NOT_FLYING),
        (5.0, SupervisorState.READY, SupervisorReason.WAITING_FOR_PILOT),
        (0.55 * end_s, SupervisorState.FOLLOWING, SupervisorReason.TARGET_SEEN),
        (0.55 * end_s + 0.8, SupervisorState.COASTING, SupervisorReason.TARGET_UNSEEN),
        (0.55 * end_s + 2.3, SupervisorState.SEARCHING, SupervisorReason.TARGET_LOST),
        (end_s - 1.0, SupervisorState.FOLLOWING, SupervisorReason.TARGET_SEEN),
    )
    for until, state, reason in table:
        if t < until:
            return state, reason
    return SupervisorState.RELEASED, SupervisorReason.STOP_REQUESTED


def target_at(t: float) -> tuple[np.ndarray, np.ndarray]:
    heading = 0.6 * math.sin(0.15 * t)
    velocity = 5.0 * np.array([math.cos(heading), math.sin(heading), 0.0])
    north = 5.0 * t * 0.92
    east = 5.0 * (0.6 / 0.15) * (1 - math.cos(0.15 * t))
    return np.array([north + 30, east, -0.8]), velocity


def make_flight(
    duration_s: float = 60.0, *, telemetry: bool = True, seed: int = 1
) -> SyntheticFlight:
    rng = np.random.default_rng(seed)
    log, truth = FlightLog(), []
    position, velocity, yaw = np.array([0.0, 0.0, -8.0]), np.zeros(3), -0.3
    asked = allowed = HOLD
    before: SupervisorState | None = None
    captured_s: float | None = None
    for step in range(round(duration_s / CONTROL_S)):
        t = step * CONTROL_S
        state, reason = state_at(t, duration_s)
        target, target_velocity = target_at(t)
        sight = LineOfSight.from_vector(target - position)
        range_m = float(np.linalg.norm(target - position))
        azimuth = wrap_angle(sight.azimuth_rad - yaw)
        while len(log.tracks) * FRAME_S <= t:
            log.tracks.append(track_record(len(log.tracks), state, azimuth, sight, range_m, rng))
            captured_s = log.tracks[-1].captured_s
        if state.steers:
            forward = 5.0 + 0.5 * (range_m - 15) + rng.normal(0, 0.1)
            climb = 0.8 * range_m * (sight.elevation_rad - GOAL.elevation_rad)
            asked = VelocitySetpoint(forward, 0.0, -climb, 1.5 * azimuth + 0.05 * math.sin(t))
        else:
            asked = HOLD
        allowed = follow(allowed, asked)
        world = heading_to_world(allowed, yaw)
        velocity = velocity + (world - velocity) * CONTROL_S / 0.4
        position = position + velocity * CONTROL_S
        yaw = wrap_angle(yaw + allowed.yaw_rate_rad_s * CONTROL_S)
        pitch = -0.05 * (allowed.forward_m_s - velocity[0])
        time_s = START_S + t
        body = BodyState(
            time_s,
            tuple(position.tolist()),
            tuple(velocity.tolist()),
            (0.05 * math.sin(t), pitch, yaw),
            (0.0, 0.0, allowed.yaw_rate_rad_s),
        )
        in_frame = 1.0 if abs(azimuth) < 0.6 else 0.0
        truth.append(
            TruthSample(
                time_s,
                body,
                tuple(target.tolist()),
                tuple(target_velocity.tolist()),
                in_frame,
                1.0,
                range_m,
                azimuth,
                sight.elevation_rad,
            )
        )
        estimate = None
        if state is not SupervisorState.IDLE:
            estimate = estimate_of(time_s, sight, yaw, range_m, telemetry, rng)
        log.controls.append(
            ControlRecord(
                time_s=time_s,
                late_s=abs(rng.normal(0, 1e-4)),
                busy_s=2e-4 + abs(rng.normal(0, 5e-5)),
                state=state,
                reason=reason,
                estimate=estimate,
                track_captured_s=captured_s,
                vehicle=vehicle_of(body) if telemetry else VehicleState(),
                asked=asked,
                allowed=allowed,
                limits=("acceleration",) if allowed != asked and step % 3 == 0 else (),
                sent=state.streams,
            )
        )
        if state is not before:
            log.note(time_s, "supervisor", f"{state}: {reason}")
            before = state
    log.note(START_S + 3, "autopilot", "Takeoff <complete> & hovering")
    log.events.sort(key=lambda event: event.time_s)
    return SyntheticFlight(log, truth, GOAL, ServoSettings(target_size_m=SIZE_M))


def follow(now: VelocitySetpoint, asked: VelocitySetpoint) -> VelocitySetpoint:
    most = np.array([2.5, 2.5, 2.5, 2.0]) * CONTROL_S
    values = np.array(now.values) + np.clip(np.subtract(asked.values, now.values), -most, most)
    return VelocitySetpoint(*np.clip(values, [-3, -3, -2, -1], [8, 3, 1.5, 1]).tolist())


def heading_to_world(setpoint: VelocitySetpoint, yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    forward, right, down, _ = setpoint.values
    return np.array([c * forward - s * right, s * forward + c * right, down])


def track_record(
    number: int,
    state: SupervisorState,
    azimuth: float,
    sight: LineOfSight,
    range_m: float,
    rng: np.random.Generator,
) -> TrackRecord:
    captured_s = START_S + number * FRAME_S - 0.05
    track = None
    if state is not SupervisorState.IDLE:
        seen = {
            SupervisorState.COASTING: TrackState.COASTING,
            SupervisorState.SEARCHING: TrackState.LOST,
        }
        side = 420 * SIZE_M / range_m
        box = Box(320 + 420 * azimuth, 240 - 420 * (sight.elevation_rad + 0.44), side * 1.2, side)
        kind = seen.get(state, TrackState.TRACKING)
        confidence = 0.85 + rng.normal(0, 0.03) if kind is TrackState.TRACKING else 0.2
        confidence = float(np.clip(confidence, 0, 1))
        track = Track(box, kind, confidence, "correlation", captured_s, number)
    busy_s = 0.004 + abs(float(rng.normal(0, 0.001)))
    return TrackRecord(track, number, captured_s, captured_s + 0.05, captured_s + 0.055, busy_s)


def estimate_of(
    time_s: float,
    sight: LineOfSight,
    yaw: float,
    range_m: float,
    telemetry: bool,
    rng: np.random.Generator,
) -> TargetEstimate:
    azimuth = sight.azimuth_rad if telemetry else wrap_angle(sight.azimuth_rad - yaw)
    return TargetEstimate(
        time_s=time_s,
        azimuth_rad=azimuth + float(rng.normal(0, 0.004)),
        elevation_rad=sight.elevation_rad + float(rng.normal(0, 0.004)),
        log_scale=math.log(SIZE_M / range_m) + float(rng.normal(0, 0.02)),
        azimuth_rate_rad_s=0.0,
        elevation_rate_rad_s=0.0,
        log_scale_rate_s=0.0,
        covariance=np.eye(6) * 1e-5,
        last_seen_s=time_s,
        frame=BearingFrame.WORLD if telemetry else BearingFrame.BODY,
    )


def vehicle_of(body: BodyState) -> VehicleState:
    return VehicleState(
        attitude=Attitude(*body.attitude_rad, *body.rates_rad_s, body.time_s),
        position=LocalPosition(*body.position_m, *body.velocity_m_s, body.time_s),
        mode="OFFBOARD",
        obeys_setpoints=True,
        armed=True,
        landed=False,
        heartbeat_s=body.time_s,
    )


@pytest.fixture(scope="session")
def fly() -> MakeFlight:
    """Return the generator of synthetic flights."""
    return make_flight


KeepTerminal = Callable[[Console, str, str], None]
_WEB_FONTS = re.compile(r"@font-face \{\{.*?\}\}\s*", re.DOTALL)


@pytest.fixture
def keep_terminal() -> KeepTerminal:
    """Keep what a recording console was shown as a picture, where somebody asks for it."""

    def keep(console: Console, title: str, name: str) -> None:
        wanted = os.environ.get("FOLLOWER_PICTURES")  # `docs/pictures`, for the guides
        if wanted:
            pattern = _WEB_FONTS.sub("", CONSOLE_SVG_FORMAT)
            svg = console.export_svg(title=title, code_format=pattern, unique_id=name)
            (Path(wanted) / f"{name}.svg").write_text(svg, "utf-8")

    return keep


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """A folder of installed packages that Python finds."""
    with installed(tmp_path / "site") as site:
        yield site


@pytest.fixture(scope="session")
def chromium() -> str:
    """Return the browser's path; what needs one is skipped where there is none."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    return path


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright  # not in the environment of ROS's tests

    arguments = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=arguments)
        yield browser
        browser.close()
