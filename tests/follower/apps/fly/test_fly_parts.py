"""The small parts of `follower fly`: words, keyboard, camera, signals, example settings."""

from __future__ import annotations

import io
import os
import pty
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import numpy as np
import pytest

from follower.apps.command_settings import lens_is_given
from follower.apps.fly.flight import RealFlight, waiting_for
from follower.apps.preflight.camera_checks import CameraWatch
from follower.apps.video_input import DeadCamera, SteadySource
from follower.flight.log import ControlRecord, FlightLog
from follower.flight.supervision.autonomy import AutonomyPhase
from follower.flight.supervision.inputs import ConsentRequest, SupervisorInputs
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.settings import Settings, load_settings
from follower.ui.terminal.cli_options import typed_command
from follower.ui.terminal.interrupt import Keyboard, StopOnInterrupt
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import VehicleState
from follower_vision.clock import SimulatedClock
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself
from follower_vision.trackers.correlation import CorrelationTracker

CONFIGS = Path(__file__).parents[4] / "configs" / "fly"


def record(state: SupervisorState, reason: SupervisorReason, obeys: bool = False) -> ControlRecord:
    vehicle = VehicleState(mode="OFFBOARD", obeys_setpoints=obeys, armed=True, heartbeat_s=1.0)
    return ControlRecord(1.0, 0.0, 0.0, state, reason, None, None, vehicle, HOLD, HOLD, (), False)


@pytest.mark.parametrize(
    ("state", "reason", "consent", "words"),
    [
        (SupervisorState.IDLE, SupervisorReason.NO_TARGET, {}, "looking for a cow"),
        (SupervisorState.TRACKING, SupervisorReason.NOT_FLYING, {}, "take off"),
        (SupervisorState.TRACKING, SupervisorReason.FRAMES_STALE, {}, "camera"),
        (SupervisorState.READY, SupervisorReason.WAITING_FOR_PILOT, {}, "switch to GUIDED"),
        (
            SupervisorState.READY,
            SupervisorReason.WAITING_FOR_CONSENT,
            {"kind": "rc"},
            "switch on the transmitter",
        ),
        (
            SupervisorState.READY,
            SupervisorReason.WAITING_FOR_CONSENT,
            {"kind": "terminal"},
            "press Enter",
        ),
        (SupervisorState.FOLLOWING, SupervisorReason.TARGET_SEEN, {}, "leave GUIDED to take over"),
        (SupervisorState.SEARCHING, SupervisorReason.TARGET_LOST, {}, "leave GUIDED to take over"),
        (
            SupervisorState.RELEASED,
            SupervisorReason.PILOT_TOOK_OVER,
            {},
            "consent (Enter, or on the page)",
        ),
        (
            SupervisorState.RELEASED,
            SupervisorReason.PILOT_TOOK_OVER,
            {"again": "mode"},
            "go back to GUIDED",
        ),
        (
            SupervisorState.RELEASED,
            SupervisorReason.STOP_REQUESTED,
            {"again": "mode"},
            "consent (Enter",
        ),
        (
            SupervisorState.READY,
            SupervisorReason.WAITING_FOR_CONSENT,
            {"kind": "cockpit"},
            "on the page",
        ),
        (SupervisorState.RELEASED, SupervisorReason.PILOT_TOOK_OVER, {"kind": "rc"}, "transmitter"),
    ],
)
def test_the_terminal_says_what_has_to_happen_next(
    state: SupervisorState, reason: SupervisorReason, consent: dict[str, str], words: str
) -> None:
    settings = Settings.model_validate({"consent": consent})
    assert words in waiting_for(record(state, reason), "ardupilot", "a cow", settings)


@pytest.mark.parametrize(
    "reason", [SupervisorReason.CONSENT_WITHDRAWN, SupervisorReason.PILOT_TOOK_OVER]
)
@pytest.mark.parametrize(
    ("given", "words"), [(True, "go back to GUIDED"), (False, "consent (Enter")]
)
def test_after_a_withdrawal_the_pilots_mode_alone_is_not_said_to_begin_anew(
    reason: SupervisorReason, given: bool, words: str
) -> None:
    settings = Settings.model_validate({"consent": {"again": "mode"}})
    situation = SupervisorInputs(
        *(True, 0.0, True, 0.0, 0.0, 0.0, 0.02, False, True, False, False, 9.0),
        consent_given=given,
    )
    released = replace(record(SupervisorState.RELEASED, reason), situation=situation)
    assert words in waiting_for(released, "ardupilot", "a cow", settings)


@pytest.mark.parametrize(
    "reason",
    [
        *(
            SupervisorReason.LINK_SILENT,
            SupervisorReason.TELEMETRY_STALE,
            SupervisorReason.FRAMES_STALE,
            SupervisorReason.CONTROL_LATE,
        ),
        *(
            SupervisorReason.NAVIGATION_POOR,
            SupervisorReason.BATTERY_LOW,
            SupervisorReason.TARGET_UNSEEN,
            SupervisorReason.NOT_FLYING,
        ),
        *(SupervisorReason.AUTOPILOT_FAILSAFE, SupervisorReason.COCKPIT_LOST),
    ],
)
def test_each_trouble_before_following_has_its_words(reason: SupervisorReason) -> None:
    words = waiting_for(record(SupervisorState.TRACKING, reason), "px4", "a cow", Settings())
    assert len(words) > 10


def test_before_the_autopilot_and_after_the_end() -> None:
    settings = Settings()
    assert waiting_for(None, "unknown", "a cow", settings) == "waiting for the autopilot"
    released = record(SupervisorState.RELEASED, SupervisorReason.STOP_REQUESTED, obeys=True)
    assert "standing still" in waiting_for(released, "px4", "a cow", settings)
    assert waiting_for(released, "px4", "a cow", settings, ending=True) == (
        "ending; pilot: leave OFFBOARD to take over"
    )


@contextmanager
def terminal() -> Iterator[tuple[int, TextIO]]:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as stream:
        yield ours, stream
        os.close(ours)


def test_enter_consents_and_whatever_else_is_typed_withdraws() -> None:
    with terminal() as (typing, stream):
        keyboard = Keyboard(stream)
        assert keyboard.order() is ConsentRequest.NONE
        os.write(typing, b"\n")
        assert keyboard.order() is ConsentRequest.GIVE
        assert keyboard.order() is ConsentRequest.NONE
        for typed in (b"n\n", b"stop\n", b"STOP NOW\n", b"abort\n", b"y\n", b"\nn\n", b"n\n\n"):
            os.write(typing, typed)
            assert keyboard.order() is ConsentRequest.WITHDRAW, typed
        os.write(typing, b" \n")
        assert keyboard.order() is ConsentRequest.GIVE


def test_what_is_no_terminal_gives_no_orders() -> None:
    assert Keyboard(io.StringIO("\n\n")).order() is ConsentRequest.NONE
    closed = io.StringIO()
    closed.close()
    assert Keyboard(closed).order() is ConsentRequest.NONE


class Pictures(ClosesItself):
    nominal_rate_hz = 30.0
    frame_count = None
    problem = None

    def __init__(self, *widths: int) -> None:
        self._widths = list(widths)

    def read(self) -> Frame | None:
        if not self._widths:
            return None
        image = np.zeros((240, self._widths.pop(0), 3), np.uint8)
        return Frame(image, 1.0, 0)

    def close(self) -> None:
        self._widths.clear()


def test_frames_that_change_their_size_are_left_out_and_the_end_is_noticed() -> None:
    source = SteadySource(Pictures(320, 640, 640, 320), (320, 240))
    frames = [source.read(), source.read()]
    assert [frame.width for frame in frames if frame is not None] == [320, 320]
    assert source.problem is None
    assert not source.ended
    assert source.read() is None
    assert source.ended
    wrong = SteadySource(Pictures(640), (320, 240))
    assert wrong.read() is None
    assert wrong.problem == "frames are 640x240 now, not 320x240"


class Ticking(Pictures):
    """Gives frames at times that are handed in, and moves the clock along."""

    def __init__(self, clock: SimulatedClock, times_s: list[float]) -> None:
        super().__init__(*[64] * len(times_s))
        self._clock, self._times_s = clock, times_s

    def read(self) -> Frame | None:
        frame = super().read()
        if frame is None:
            return None
        captured_s = self._times_s.pop(0)
        self._clock.sleep_until(captured_s + 0.04)
        noise = np.random.default_rng(len(self._times_s)).integers(0, 255, frame.image.shape)
        return Frame(noise.astype(np.uint8), captured_s, 0)


def test_a_camera_is_measured_and_an_early_gap_forgiven() -> None:
    clock = SimulatedClock()
    times_s = [0.0, 2.0, *(2.0 + 0.05 * n for n in range(1, 101))]
    with CameraWatch(Ticking(clock, times_s), "a test", clock) as camera:
        while camera.frames.wait(1.0) is not None and times_s:
            pass
    reading = camera.reading()
    assert reading.frames == 102
    assert reading.interval_s == pytest.approx(0.05)
    assert reading.worst_interval_s == pytest.approx(0.05, abs=1e-6)
    assert reading.age_s == pytest.approx(0.04)
    assert reading.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert reading.repeats == 0
    assert reading.contrast > 30
    clock.sleep_until(clock.now() + 1.0)
    assert camera.reading().worst_interval_s == pytest.approx(1.0, abs=0.01)


def test_a_camera_is_read_while_its_first_frame_is_being_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, equal, seen = SimulatedClock(), np.array_equal, list[int]()
    watch = CameraWatch(Ticking(clock, [1.0, 2.0]), "a test", clock)

    def asked_meanwhile(one: np.ndarray, other: np.ndarray) -> bool:
        seen.append(watch.reading().frames)
        return equal(one, other)

    monkeypatch.setattr(np, "array_equal", asked_meanwhile)
    with watch:
        assert watch.frames.wait(10.0) is not None
    assert seen[0] == 0


class Slow(Pictures):
    """Takes its time for each frame, and knows whether one is being taken."""

    def __init__(self) -> None:
        super().__init__(*[64] * 1000)
        self.begun, self.reading = threading.Event(), False

    def read(self) -> Frame | None:
        self.reading = True
        self.begun.set()
        time.sleep(0.05)
        self.reading = False
        return super().read()


def test_ctrl_c_while_the_watching_begins_leaves_nobody_reading(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = Slow()
    watch = CameraWatch(source, "a test", SimulatedClock())
    start = threading.Thread.start

    def interrupted(thread: threading.Thread) -> None:
        start(thread)
        assert source.begun.wait(10)
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with pytest.raises(KeyboardInterrupt), watch:
        pass
    assert not source.reading


def test_a_camera_that_cannot_be_opened_is_one_without_frames() -> None:
    with DeadCamera("no such device") as camera:
        assert camera.read() is None
        assert camera.problem == "no such device"


def test_the_first_signal_stops_and_a_second_ctrl_c_interrupts() -> None:
    stops: list[int] = []
    before = signal.getsignal(signal.SIGTERM)
    with StopOnInterrupt(lambda: stops.append(1)) as interrupt:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
        assert stops == [1]
        assert interrupt.interrupted
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before


def made_flight(settings: Settings, clock: SimulatedClock) -> RealFlight:
    link, tracker = MavlinkLink(MemoryTransport.pair()[0]), FusionTracker(CorrelationTracker())
    source = SteadySource(DeadCamera("none"), (64, 48))
    return RealFlight(settings, source, (64, 48), link, tracker, clock, FlightLog())


def test_a_flight_whose_control_hangs_ends_six_seconds_after_its_last_step() -> None:
    clock = SimulatedClock()
    flight = made_flight(Settings(), clock)
    clock.sleep_until(7.0)
    assert not flight.finished
    flight._control.step(7.0)
    flight.stop()
    clock.sleep_until(12.9)
    assert not flight.finished
    clock.sleep_until(13.1)
    assert flight.finished


@pytest.mark.parametrize(
    ("phase", "taken"),
    [
        (AutonomyPhase.CONNECTING, False),
        (AutonomyPhase.ARMING, False),
        (AutonomyPhase.TAKING_OFF, False),
        (AutonomyPhase.AIRBORNE, True),
        (AutonomyPhase.FOLLOWING, True),
        (AutonomyPhase.DONE, True),
    ],
)
def test_with_full_autonomy_a_target_waits_for_the_take_off_and_for_nothing_else(
    phase: AutonomyPhase, taken: bool
) -> None:
    flight = made_flight(Settings(autonomy="full"), SimulatedClock())
    assert flight._autonomy is not None
    flight._autonomy.phase = phase
    flight.select(lambda _: Box(32, 24, 20, 20))
    noise = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    record = flight._vision.step(Frame(noise, 0.0, 0))
    assert (record.track is not None) is taken


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_example_settings_can_be_flown_with_once_the_lens_is_told(path: Path) -> None:
    assert not lens_is_given(path), "the lens is the user's to give"
    assert lens_is_given(path, ["camera.fov_deg=70"])
    settings = load_settings(path, overrides=["camera.fov_deg=70"])
    assert settings.autonomy == "pilot"
    assert settings.envelope.max_speed_m_s <= 5
    assert settings == load_settings(path)


def test_a_lens_counts_as_given_only_if_somebody_gave_it() -> None:
    assert not lens_is_given()
    assert not lens_is_given(overrides=["camera.pitch_deg=-20"])
    assert not lens_is_given(overrides=["camera.fov_deg=null"])
    assert lens_is_given(overrides=["camera.focal_px=500"])


def test_the_command_line_can_be_given_again_without_the_password(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = ["follower", "fly", "--camera", "rtsp://me:secret@cam/live", "--select", "person:2"]
    monkeypatch.setattr(sys, "argv", given)
    assert typed_command() == "follower fly --camera rtsp://cam/live --select person:2"
