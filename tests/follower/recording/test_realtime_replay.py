"""A flight in real time, a thread for each stage and the recorder's own, replays bit for bit."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.flight.target.selectors import box_selector
from follower.flight.threads import RealtimeRun, VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import close_tracker, make_tracker_with
from follower.links.vehicle_health import SensorHealth, VehicleHealth
from follower.recording import FlightConfig, Recorder, open_flight
from follower.recording.config import late_detection
from follower.settings.live import SettingChange
from follower.settings.settings import Settings
from follower_control.vehicle.state import (
    Attitude,
    Clearance,
    GimbalState,
    LocalPosition,
    RcChannels,
    VehicleState,
)
from follower_vision.clock import MonotonicClock
from follower_vision.detection import Detection
from follower_vision.fusion import BackgroundDetection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

AT_MOST_S = 40.0
PAUSE_S = 0.3
"""Between two acts of the operator."""


class Camera(ClosesItself):
    """Noise with a moving square, 60 times a second: more than vision may manage."""

    nominal_rate_hz = 60.0
    frame_count: int | None = None
    problem: str | None = None

    def __init__(self, clock: MonotonicClock) -> None:
        self._clock = clock
        self._rng = np.random.default_rng(3)
        self._number = 0

    def read(self) -> Frame:
        self._number += 1
        self._clock.sleep_until(self._number / 60)
        image = self._rng.integers(60, 120, (120, 160, 3), dtype=np.uint8)
        x = 60 + abs((self._number // 3 + 20) % 40 - 20)
        image[50:70, x : x + 24] = (40, 40, 230)
        image[50:70:4, x : x + 24] = (230, 230, 40)
        return Frame(image, self._clock.now() - 0.01, self._number)


class Link:
    """A vehicle that hovers and trembles, under trembling sticks and above a trembling gimbal.

    Telemetry comes when it comes, and the battery empties.
    """

    connected = True
    autopilot_name = "ardupilot"

    def __init__(self) -> None:
        self.health = VehicleHealth(sensors=SensorHealth(1, 1, 0.9, 0.0))
        self.state = VehicleState()
        self.attitudes: list[Attitude] = []
        self.sent: list[Any] = []
        self._rng = np.random.default_rng(4)

    def poll(self, now_s: float) -> None:
        angles = self._rng.normal(0, 0.01, 6).tolist()
        self.attitudes = [Attitude(*angles, now_s - 0.005)] if self._rng.random() < 0.8 else []
        position = LocalPosition(0.0, 0.0, -10.0, 0.0, 0.0, 0.0, now_s)
        attitude = self.attitudes[-1] if self.attitudes else self.state.attitude
        sticks = RcChannels(tuple(self._rng.integers(1440, 1640, 8).tolist()), now_s - 0.01)
        self.state = VehicleState(
            attitude,
            position,
            "GUIDED",
            obeys_setpoints=True,
            armed=True,
            landed=False,
            heartbeat_s=now_s,
            rc=sticks if self._rng.random() < 0.9 else None,
            gimbal=GimbalState(Attitude(*self._rng.normal(0, 0.01, 6).tolist(), now_s - 0.02)),
            clearance=Clearance(8.0 + self._rng.normal(0, 0.5), now_s),
            answered_s=now_s - 0.1,
        )
        if self._rng.random() < 0.1:
            self.health = VehicleHealth(sensors=SensorHealth(1, 1, 0.9 - 0.01 * now_s, now_s))

    def watch_health(self) -> None:
        pass

    def use_gimbal(self, device: int) -> None:
        pass

    def turn_gimbal(self, rates: Any) -> None:
        pass

    def take_notes(self) -> list[str]:
        return []

    def take_commands(self) -> list[Any]:
        return []

    def send(self, setpoint: Any) -> None:
        self.sent.append(setpoint)


class RedDetector:
    """What is red in an image, by another program; now and then slowly."""

    class_names = ("square",)

    def __init__(self) -> None:
        self._rng = np.random.default_rng(5)

    def detect(self, image: Any, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        time.sleep(self._rng.choice([0.0, 0.03]))
        rows, columns = np.nonzero(image[..., 2] > 200)
        if not len(rows):
            return []
        left, top = columns.min(), rows.min()
        size = columns.max() + 1 - left, rows.max() + 1 - top
        score = self._rng.uniform(0.5, 1.0)
        return [Detection(Box.from_xywh(*map(float, (left, top, *size))), 0, "square", score)]


WATCH = SettingChange.of("servo.mode", "watch")


class Operator:
    """Does each of a few things once, in the state for it, however busy the machine is."""

    def __init__(self, stage: ControlStage) -> None:
        self._stage, self._acted_s = stage, 0.0
        self._plan = [
            (SupervisorState.READY, lambda: stage.order(ConsentRequest.GIVE)),
            (SupervisorState.FOLLOWING, lambda: stage.repeat_changes([WATCH])),
            (SupervisorState.FOLLOWING, lambda: stage.order(ConsentRequest.WITHDRAW)),
            (SupervisorState.RELEASED, lambda: stage.order(ConsentRequest.GIVE)),
            (SupervisorState.FOLLOWING, stage.request_stop),
        ]

    def goes_on(self, now_s: float) -> bool:
        """Act if it is time; return whether there is more to come."""
        if now_s < self._acted_s + PAUSE_S:
            return True
        if self._plan and self._stage.supervisor.state is self._plan[0][0]:
            self._acted_s = now_s
            self._plan.pop(0)[1]()
        return bool(self._plan) or now_s < self._acted_s + PAUSE_S


@pytest.mark.slow
@pytest.mark.parametrize("detector", [None, RedDetector()], ids=["no detector", "another's"])
def test_what_many_threads_did_is_replayed_by_one(tmp_path: Path, detector: Any) -> None:
    settings = Settings.model_validate(
        {
            "recorder": {"video": "lossless", "keep_free_mb": 0},
            "consent": {"kind": "terminal"},
            "sticks": {"nudge": True},
            "gimbal": {"enabled": True},
        }
    )
    clock, link = MonotonicClock(), Link()
    run = {"detection": late_detection(settings), "detector": "another's" if detector else ""}
    config = FlightConfig.of("real", settings, run=run)
    with Recorder(tmp_path, config, clock, settings.recorder) as recorder:
        tracker = make_tracker_with(detector, settings, BackgroundDetection)
        stage = VisionStage(tracker)
        stage.select(box_selector(Box(73.0, 60.0, 24.0, 20.0)))
        vision = VisionLoop(stage, clock, recorder.log)
        control = ControlStage(settings, settings.camera.model(160, 120), recorder.log)
        loop: Any = ControlLoop(link, control, lambda: vision.tracks.newest, recorder.log)  # type: ignore[arg-type]
        threads = RealtimeRun(clock, Camera(clock), vision, loop, settings.control_rate_hz)

        operator = Operator(control)

        def watch() -> bool:
            now_s = clock.now()
            return operator.goes_on(now_s) and now_s < AT_MOST_S

        threads.run(watch)
        close_tracker(tracker)
    assert recorder.remarks == ()
    flight = open_flight(tmp_path)
    assert flight.remarks == []
    assert len(flight.log.controls) == len(recorder.log.controls) > 50
    reasons = {record.reason for record in flight.log.controls}
    assert {
        SupervisorReason.CONSENT_WITHDRAWN,
        SupervisorReason.STOP_REQUESTED,
        SupervisorReason.TARGET_SEEN,
    } <= reasons
    assert all(record.gimbal for record in flight.log.controls if record.state.steers)
    assert len([record for record in flight.log.controls if record.health]) > 3
    assert [record.changes for record in flight.log.controls if record.changes] == [(WATCH,)]
    seen = [one for record in flight.detections for one in record.detections]
    assert bool(seen) == (detector is not None)
    replay = Replay(flight, replay_settings(flight))
    compared = compare(flight.log, replay.run())
    assert replay.missed == 0
    assert compared.identical, [one.name for one in compared.differing]
