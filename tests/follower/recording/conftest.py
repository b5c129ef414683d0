"""A small flight through the real stages, recorded: no simulator, a few seconds, small frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.control.stage import ControlStage
from follower.flight.log import FlightLog
from follower.flight.target.selectors import box_selector
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.recording import FlightConfig, Recorder, RecorderSettings, VideoKind
from follower.settings.settings import Settings
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame

WIDTH, HEIGHT = 160, 120
FRAME_S, STEP_S = 1 / 20, 1 / 50


@dataclass
class SmallFlight:
    """What was flown, as it was in memory."""

    folder: Path
    log: FlightLog
    remarks: tuple[str, ...] = ()
    frames: list[Frame] = field(default_factory=list)


FlySmall = Callable[..., SmallFlight]


def small_settings(video: str) -> Settings:
    recorder = RecorderSettings(video=VideoKind(video), keep_free_mb=0)
    return Settings(recorder=recorder)


def target_at(time_s: float) -> tuple[float, float]:
    return 70 + 25 * math.sin(0.9 * time_s), 60 + 6 * math.sin(0.5 * time_s)


def frame_at(number: int, ground: np.ndarray) -> Frame:
    """A striped square on a textured ground."""
    time_s = number * FRAME_S
    image = ground.copy()
    x, y = (round(value) for value in target_at(time_s))
    image[y - 8 : y + 8, x - 10 : x + 10] = (30, 60, 220)
    image[y - 8 : y + 8 : 4, x - 10 : x + 10] = (230, 220, 40)
    return Frame(image, time_s, number)


def vehicle_at(time_s: float) -> VehicleState:
    attitude = attitude_at(time_s)
    position = LocalPosition(0.1 * time_s, 0.0, -10.0, 0.1, 0.0, 0.0, time_s)
    return VehicleState(attitude, position, "OFFBOARD", True, True, False, math.floor(time_s))


def attitude_at(time_s: float) -> Attitude:
    roll, pitch = 0.05 * math.sin(time_s), -0.03 * math.cos(2 * time_s)
    return Attitude(roll, pitch, 0.1 * time_s, 0.05 * math.cos(time_s), 0.0, 0.1, time_s)


def fly(folder: Path, seconds: float = 3.0, video: str = "lossless", **config: Any) -> SmallFlight:
    folder.mkdir(parents=True, exist_ok=True)
    settings, clock = small_settings(video), SimulatedClock()
    ground = np.random.default_rng(5).integers(40, 160, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    described = FlightConfig.of("simulated", settings, **config)
    with Recorder(folder, described, clock, settings.recorder, threaded=False) as recorder:
        flight = SmallFlight(folder, recorder.log)
        stage = VisionStage(make_target_tracker(settings))
        vision = VisionLoop(stage, clock, recorder.log)
        control = ControlStage(settings, settings.camera.model(WIDTH, HEIGHT), recorder.log)
        ours, theirs = MemoryTransport.pair()
        link = recorder.transport(ours)
        own, autopilot = mavlink.MAVLink(None, 1, 191), mavlink.MAVLink(None, 1, 1)
        for step in range(round(seconds / STEP_S)):
            now_s = step * STEP_S
            clock.sleep_until(now_s)
            while len(flight.frames) * FRAME_S <= now_s:
                frame = frame_at(len(flight.frames), ground)
                flight.frames.append(frame)
                if len(flight.frames) == 3:
                    x, y = target_at(frame.captured_s)
                    stage.select(box_selector(Box(x, y, 20, 16)))
                vision.tracks.put(vision.step(frame, 0.01))
            theirs.send(attitude_message(now_s).pack(autopilot))
            link.receive()
            attitudes = [attitude_at(now_s - STEP_S / 2), attitude_at(now_s)]
            record = control.step(now_s, vision.tracks.newest, vehicle_at(now_s), attitudes, 1e-4)
            if record.sent:
                link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(own))
        recorder.log.note(clock.now(), "pilot", "touché: “ende”")
    flight.remarks = recorder.remarks
    return flight


def attitude_message(time_s: float) -> Any:
    a = attitude_at(time_s)
    rates = (a.roll_rate_rad_s, a.pitch_rate_rad_s, a.yaw_rate_rad_s)
    angles = (a.roll_rad, a.pitch_rad, a.yaw_rad)
    return mavlink.MAVLink_attitude_message(round(1000 * time_s), *angles, *rates)


@pytest.fixture(scope="session")
def fly_small() -> FlySmall:
    """Return the maker of small flights."""
    return fly


@pytest.fixture(scope="session")
def small_flight(tmp_path_factory: pytest.TempPathFactory) -> SmallFlight:
    """Return one that nobody changes: lossless, 3 s."""
    return fly(tmp_path_factory.mktemp("flights") / "small")
