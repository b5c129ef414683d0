"""The sign test with the real pipeline: MAVLink over UDP, frames, a vehicle turned by hand."""

from __future__ import annotations

import io
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink
from rich.console import Console

from follower.apps.preflight.camera_checks import CameraWatch
from follower.apps.preflight.sign_test import SignTest, SignTestResult, run
from follower.flight.target.selectors import colour_selector
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.links.connections import ConnectionFailedError
from follower.links.open import open_link
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.link import LinkSettings
from follower.settings.settings import Settings
from follower.ui.terminal.interrupt import InterruptFlag
from follower_control.common.transport import MemoryTransport, UdpTransport
from follower_vision.clock import MonotonicClock
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import along_camera_axes, rotation
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

WIDTH, HEIGHT, FOV_DEG = 320, 240, 70.0
SWING_RAD = math.radians(12)
COMMANDS = {
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_MODE,
    mavlink.MAVLINK_MSG_ID_PARAM_SET,
}


def angles_at(time_s: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a vehicle that hands sway to and fro."""
    pitch = SWING_RAD * math.sin(2 * math.pi * time_s / 3.1)
    return 0.0, pitch, 1.0 + SWING_RAD * math.sin(2 * math.pi * time_s / 2.0)


class HandHeld:
    """An autopilot that tells the attitude of a vehicle in somebody's hands."""

    def __init__(self, port: int, clock: MonotonicClock, armed: bool = False) -> None:
        self._transport = UdpTransport.connect("127.0.0.1", port)
        self._clock = clock
        self._codec = mavlink.MAVLink(None, 1, 1)
        self._mode_flags = 1 | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
        self._stop = threading.Event()
        self.heard: set[int] = set()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._transport.close()

    def _run(self) -> None:
        beat_s = -1.0
        while not self._stop.is_set():
            now_s = self._clock.now()
            for message in self._codec.parse_buffer(self._transport.receive()) or []:
                self.heard.add(message.get_msgId())
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    self._send(mavlink.MAVLink_timesync_message(int(now_s * 1e9), message.ts1))
            if now_s - beat_s >= 0.5:
                beat_s = now_s
                self._send(mavlink.MAVLink_heartbeat_message(2, 12, self._mode_flags, 0, 3, 3))
            boot_ms = int(1000 * now_s)
            angles = angles_at(boot_ms / 1000)
            self._send(mavlink.MAVLink_attitude_message(boot_ms, *angles, 0.0, 0.0, 0.0))
            time.sleep(0.012)

    def _send(self, message: mavlink.MAVLink_message) -> None:
        self._transport.send(message.pack(self._codec))


class CameraOnIt(ClosesItself):
    """Sees a red square in the distance from the swaying vehicle; `spoil` alters its pictures."""

    nominal_rate_hz = 30.0
    frame_count = None
    problem = None

    def __init__(self, clock: MonotonicClock, spoil: Callable[[np.ndarray], np.ndarray]) -> None:
        self._clock = clock
        self._spoil = spoil
        self._model = CameraModel.from_fov(WIDTH, HEIGHT, math.radians(FOV_DEG))
        self._target = rotation(*angles_at(0.0)) @ np.array([1.0, 0.06, 0.04])
        noise = np.random.default_rng(3).integers(80, 150, (HEIGHT // 8, WIDTH // 8, 3))
        self._ground = cv2.resize(noise.astype(np.uint8), (WIDTH, HEIGHT))
        self._sequence = 0

    def read(self) -> Frame | None:
        time.sleep(1 / 30)
        now_s = self._clock.now()
        seen = along_camera_axes(rotation(*angles_at(now_s))).T @ self._target
        x, y = (round(float(v)) for v in self._model.pixels(seen)[0])
        image = self._ground.copy()
        cv2.rectangle(image, (x - 14, y - 14), (x + 14, y + 14), (32, 32, 208), -1)
        cv2.rectangle(image, (x - 8, y - 8), (x + 2, y), (210, 210, 40), -1)
        self._sequence += 1
        return Frame(np.ascontiguousarray(self._spoil(image)), now_s, self._sequence)

    def close(self) -> None:
        pass


@contextmanager
def hand_held(
    clock: MonotonicClock, armed: bool = False
) -> Iterator[tuple[UdpTransport, HandHeld]]:
    ours = UdpTransport.listen("127.0.0.1", 0)
    held = HandHeld(ours.port, clock, armed)
    try:
        yield ours, held
    finally:
        held.close()


def sign_tested(
    spoil: Callable[[np.ndarray], np.ndarray],
    armed: bool = False,
    kind: str = "pymavlink",
    **camera: float,
) -> tuple[SignTestResult, set[int], str]:
    clock, printed = MonotonicClock(), io.StringIO()
    settings = Settings.model_validate({"camera": {"fov_deg": FOV_DEG, **camera}})
    with hand_held(clock, armed) as (ours, held):
        link_settings = LinkSettings(kind=kind, vehicle_id=1)  # type: ignore[arg-type]
        with (
            closing(open_link(ours, link_settings, clock, 10**18)) as link,
            CameraOnIt(clock, spoil) as source,
            CameraWatch(source, "a test", clock) as watch,
        ):
            tracker = make_target_tracker(settings)
            selector = colour_selector("#d02020")
            test = SignTest(settings, link, tracker, selector, (WIDTH, HEIGHT))
            console = Console(file=printed, width=200)
            result = run(test, link, watch, clock, console, InterruptFlag())
        assert not result.interrupted
        return result, held.heard, printed.getvalue()


def as_it_is(image: np.ndarray) -> np.ndarray:
    return image


def mirrored(image: np.ndarray) -> np.ndarray:
    return image[:, ::-1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pymavlink", pytest.param("mavsdk", marks=pytest.mark.slow)])
def test_a_right_camera_passes_and_nothing_is_sent_that_moves_the_vehicle(kind: str) -> None:
    result, heard, printed = sign_tested(as_it_is, kind=kind)
    assert result.passed, result.text
    assert "would turn against your hand" in result.text
    assert mavlink.MAVLINK_MSG_ID_HEARTBEAT in heard
    assert not heard & COMMANDS
    assert "target " in printed
    assert " -> would " in printed


@pytest.mark.slow
def test_a_mirrored_camera_fails_and_is_named() -> None:
    result, _, printed = sign_tested(mirrored)
    assert not result.passed
    assert "mirrored left to right" in result.text
    assert "WRONG" in printed


def test_an_armed_vehicle_is_refused_at_once() -> None:
    result, heard, _ = sign_tested(as_it_is, armed=True)
    assert not result.passed
    assert "armed" in result.text
    assert not heard & COMMANDS


def test_without_an_autopilot_it_ends_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("follower.apps.preflight.sign_test._ANSWER_WITHIN_S", 0.3)
    clock = MonotonicClock()
    settings = Settings.model_validate({"camera": {"fov_deg": FOV_DEG}})
    transport = UdpTransport.listen("127.0.0.1", 0)
    with (
        closing(open_link(transport, LinkSettings(), clock, 10**18)) as link,
        CameraOnIt(clock, as_it_is) as source,
        CameraWatch(source, "a test", clock) as watch,
    ):
        tracker = make_target_tracker(settings)
        test = SignTest(settings, link, tracker, colour_selector("#d02020"), (WIDTH, HEIGHT))
        with pytest.raises(ConnectionFailedError, match="no heartbeat of a vehicle received"):
            run(test, link, watch, clock, Console(file=io.StringIO()), InterruptFlag())


def test_a_camera_that_dies_is_not_taken_for_a_target_that_is_not_seen() -> None:
    ours, theirs = MemoryTransport.pair()
    settings = Settings.model_validate({"camera": {"fov_deg": FOV_DEG}})
    link, codec = MavlinkLink(ours, LinkSettings(vehicle_id=1)), mavlink.MAVLink(None, 1, 1)
    never = colour_selector("#d02020")
    test = SignTest(settings, link, make_target_tracker(settings), never, (WIDTH, HEIGHT))
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for second in range(6):
        theirs.send(mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3).pack(codec))
        frame = Frame(picture, float(second), second) if second < 2 else None
        assert test.step(float(second), frame) is None
        dead = second > 4
        said = "no frames come: look after the camera" if dead else "the target is not seen"
        assert test.lines(float(second)) == [said]
