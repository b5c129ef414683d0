"""What operators ask for in flight: carried out at once, recorded, replayed without them."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.recording import FlightConfig, Recorder, open_flight
from follower.settings.recorder import RecorderSettings, VideoKind
from follower.settings.settings import Settings
from follower_control.servo.settings import FollowMode
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Frame

WIDTH, HEIGHT = 160, 120
FRAMES_PER_STEP, STEP_S = 2, 0.02
GROUND = np.random.default_rng(5).integers(40, 160, (HEIGHT, WIDTH, 3), dtype=np.uint8)
Asks = dict[float, Callable[[OperatorRequests], object]]


def places(time_s: float) -> list[tuple[float, float]]:
    """Where the two squares are."""
    return [(60 + 12 * math.sin(2 * time_s), 50.0), (115.0, 80 + 10 * math.cos(2 * time_s))]


def frame_at(number: int, time_s: float) -> Frame:
    image = GROUND + np.uint8(number % 5)
    for (cx, cy), colour in zip(places(time_s), ((30, 60, 220), (220, 160, 30)), strict=True):
        x, y = round(cx), round(cy)
        image[y - 8 : y + 8, x - 10 : x + 10] = colour
        image[y - 8 : y + 8 : 4, x - 10 : x + 10] = (230, 220, 40)
    return Frame(image, time_s, number)


def vehicle_at(time_s: float) -> VehicleState:
    attitude = Attitude(0.02 * math.sin(time_s), 0.0, 0.05 * time_s, 0.0, 0.0, 0.05, time_s)
    position = LocalPosition(0.0, 0.01 * math.sin(time_s), -10.0, 0.0, 0.0, 0.0, time_s)
    return VehicleState(attitude, position, "OFFBOARD", True, True, False, math.floor(time_s))


def fly(folder: Path, seconds: float, asks: Asks) -> FlightLog:
    settings = Settings(recorder=RecorderSettings(video=VideoKind("lossless"), keep_free_mb=0))
    clock, requests, waiting = SimulatedClock(), OperatorRequests(settings), sorted(asks)
    config = FlightConfig.of("simulated", settings)
    with Recorder(folder, config, clock, settings.recorder, threaded=False) as recorder:
        stage = VisionStage(make_target_tracker(settings), requests)
        vision = VisionLoop(stage, clock, recorder.log)
        camera = settings.camera.model(WIDTH, HEIGHT)
        control = ControlStage(settings, camera, recorder.log, requests=requests)
        for step in range(round(seconds / STEP_S)):
            now_s = step * STEP_S
            clock.sleep_until(now_s)
            while waiting and waiting[0] <= now_s:
                asks[waiting.pop(0)](requests)
            if step % FRAMES_PER_STEP == 0:
                frame = frame_at(step // FRAMES_PER_STEP, now_s)
                vision.tracks.put(vision.step(frame, 0.01))
            vehicle = vehicle_at(now_s)
            assert vehicle.attitude is not None
            control.step(now_s, vision.tracks.newest, vehicle, [vehicle.attitude])
        return recorder.log


def select(which: int, at_s: float) -> Callable[[OperatorRequests], object]:
    x, y = places(at_s)[which]
    shares = (x - 10) / WIDTH, (y - 8) / HEIGHT, (x + 10) / WIDTH, (y + 8) / HEIGHT
    return lambda requests: requests.select_rectangle(*shares, "a test")


def at(log: FlightLog, time_s: float) -> ControlRecord:
    return next(record for record in log.controls if record.time_s >= time_s - 1e-9)


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FlightLog]:
    """Return a flight in which much is asked for."""
    folder = tmp_path_factory.mktemp("busy")
    asks: Asks = {
        0.2: select(0, 0.2),
        0.8: lambda requests: requests.change_all(
            {"servo.azimuth.kp": 0.7, "servo.distance_m": 12.3456789}, "a test"
        ),
        1.0: lambda requests: requests.change("envelope.max_speed_m_s", 3.3, "a test"),
        1.2: select(1, 1.2),
        1.6: lambda requests: requests.change("servo.mode", FollowMode.ORBIT, "a test"),
        2.0: lambda requests: requests.stop_tracking("a test"),
        2.3: select(0, 2.3),
        2.7: lambda requests: requests.stop("a test"),
        2.9: select(1, 2.9),
        3.2: lambda requests: requests.give_consent("command", "a test"),
    }
    return folder, fly(folder, 3.6, asks)


@pytest.mark.slow
def test_all_of_it_happened(busy: tuple[Path, FlightLog]) -> None:
    _, log = busy
    assert at(log, 0.7).state is SupervisorState.FOLLOWING
    assert [change.key for change in at(log, 0.8).changes] == [
        "servo.azimuth.kp",
        "servo.distance_m",
    ]
    assert not at(log, 0.82).changes
    assert at(log, 1.5).state is SupervisorState.FOLLOWING
    assert at(log, 2.2).reason is SupervisorReason.NO_TARGET
    assert at(log, 2.2).state is SupervisorState.HOLDING
    assert at(log, 2.6).state is SupervisorState.FOLLOWING
    stopped = at(log, 2.7)
    assert (stopped.state, stopped.reason) == (
        SupervisorState.RELEASED,
        SupervisorReason.STOP_REQUESTED,
    )
    assert at(log, 3.1).state is SupervisorState.RELEASED, "a target alone does not undo a stop"
    assert at(log, 3.3).state is SupervisorState.FOLLOWING
    said = [event.text for event in log.events if event.source == "operator"]
    assert any("servo.azimuth.kp: 1.5 -> 0.7, by a test" in text for text in said)


@pytest.mark.slow
def test_another_target_is_steered_after_at_once_and_without_a_step(
    busy: tuple[Path, FlightLog],
) -> None:
    _, log = busy
    before, after = at(log, 1.18), at(log, 1.22)
    assert after.estimate.azimuth_rad - before.estimate.azimuth_rad > 0.2
    assert abs(after.asked.yaw_rate_rad_s - before.asked.yaw_rate_rad_s) < 0.05


@pytest.mark.slow
def test_the_replay_is_the_flight_to_the_last_bit(busy: tuple[Path, FlightLog]) -> None:
    flight = open_flight(busy[0])
    assert sum(selection.box is None for selection in flight.selections) == 1
    replay = Replay(flight, replay_settings(flight))
    replay.run()
    compared = compare(flight.log, replay.log)
    assert compared.identical, [one.name for one in compared.differing]
    assert [one.changes for one in replay.log.controls] == [one.changes for one in busy[1].controls]
