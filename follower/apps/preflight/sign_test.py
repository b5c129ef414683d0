"""`follower preflight --sign-test`: link and camera in, a verdict out; nothing is moved."""

import math
from contextlib import ExitStack
from dataclasses import dataclass

import cv2
from rich.console import Console
from rich.live import Live
from rich.text import Text

from follower.apps.preflight.camera_checks import LENS_ADVICE, CameraWatch
from follower.apps.preflight.session import opened_link
from follower.apps.preflight.sign_estimator import (
    DryRun,
    DryRunCommand,
    Reaction,
    Sign,
    SignEvidence,
    SignJudgement,
    gain_remark,
)
from follower.apps.target_choice import TargetChoice
from follower.apps.video_input import VideoInput
from follower.flight.target.selectors import Selector, first_selected
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_settings_detector, make_target_tracker
from follower.links.connections import ConnectionFailedError
from follower.links.link import Link
from follower.settings.settings import Settings
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import InterruptFlag, stop_signals
from follower_control.common.strict_config import SettingsError
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.geometry.line_of_sight import CameraMount, LineOfSight
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import SourceError
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import Track, TrackState

_STILL_DEG_S, _STILL_M_S, _CENTRED_DEG = 2.0, 0.1, 2.0
_WRONG_FOR_S = 3.0
_SILENT_S = 3.0
_PASSED, _FAILED, _INTERRUPTED = 0, 1, 130
_STEP_S = 0.02
_FIRST_FRAME_S = 10.0
_ANSWER_WITHIN_S = 15.0
_SHOW_S, _PLAIN_S = 0.1, 2.0
_MOVES = {
    "yaw": "turn the vehicle left and right by hand, 15 degrees each way",
    "pitch": "raise and lower its nose by hand, 15 degrees each way",
    "roll": "roll it by hand, 15 degrees each way",
}

_DIAGNOSES = {
    (Sign.REVERSED, Sign.RIGHT): "the image is mirrored left to right: switch off mirroring in the "
    "camera or its driver",
    (Sign.RIGHT, Sign.REVERSED): "up and down are exchanged: switch off flipping in the camera, or "
    "the camera looks backwards (camera.yaw_deg: 180)",
    (Sign.REVERSED, Sign.REVERSED): "the camera is upside down: add 180 to camera.roll_deg",
    (Sign.TURNED_RIGHT, Sign.TURNED_RIGHT): "the image is turned a quarter clockwise: subtract 90 "
    "from camera.roll_deg",
    (Sign.TURNED_LEFT, Sign.TURNED_LEFT): "the image is turned a quarter anticlockwise: add 90 to "
    "camera.roll_deg",
}


def where(direction: LineOfSight) -> str:
    """Return where the target is: "12° right of the nose, 5° below the horizon"."""
    azimuth, elevation = map(math.degrees, (direction.azimuth_rad, direction.elevation_rad))
    side = "right of the nose" if azimuth > 0 else "left of the nose"
    height = "above the horizon" if elevation > 0 else "below the horizon"
    parts = [f"{abs(azimuth):.0f}° {side}" if abs(azimuth) >= _CENTRED_DEG else "ahead"]
    parts += [f"{abs(elevation):.0f}° {height}"] if abs(elevation) >= _CENTRED_DEG else ["level"]
    return "target " + ", ".join(parts)


def intent(setpoint: VelocitySetpoint) -> str:
    """Return what would be flown: "would yaw RIGHT (clockwise) 18°/s, SINK 0.4 m/s"."""
    yaw_deg = math.degrees(setpoint.yaw_rate_rad_s)
    parts = []
    if abs(yaw_deg) >= _STILL_DEG_S:
        side = "RIGHT (clockwise)" if yaw_deg > 0 else "LEFT (anticlockwise)"
        parts.append(f"yaw {side} {abs(yaw_deg):.0f}°/s")
    for speed, positive, negative in (
        (setpoint.down_m_s, "SINK", "CLIMB"),
        (setpoint.forward_m_s, "go FORWARD", "BACK OFF"),
        (setpoint.right_m_s, "go RIGHT", "go LEFT"),
    ):
        if abs(speed) >= _STILL_M_S:
            parts.append(f"{positive if speed > 0 else negative} {abs(speed):.1f} m/s")
    return "would " + (", ".join(parts) if parts else "stay as it is")


def movers(mount: CameraMount) -> tuple[str, str]:
    """Return which turn of the body moves the image across, and which one moves it down."""
    axes = {"roll": (1.0, 0.0, 0.0), "pitch": (0.0, 1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
    right, down, _ = mount.camera_to_body.T
    # Turning about the camera's down axis moves the image across, about its right axis, down.
    across = max(axes, key=lambda name: abs(float(down @ axes[name])))
    along = max(axes, key=lambda name: abs(float(right @ axes[name])))
    return across, along


def progress(judgement: SignJudgement, mount: CameraMount) -> list[str]:
    """Return for each direction what is known, or what is to be done."""
    directions = {"across": judgement.across, "up and down": judgement.down}
    lines = []
    for (name, one), mover in zip(directions.items(), movers(mount), strict=True):
        if one.sign is Sign.WAITING:
            lines.append(f"{name}: {_MOVES[mover]} ({one.share:.0%})")
        elif one.sign is Sign.RIGHT:
            remark = gain_remark(one.gain)
            lines.append(f"{name}: agrees with the attitude" + (f"; {remark}" if remark else ""))
        else:
            lines.append(f"{name}: {one.sign}")
    if judgement.attitude_stands:
        lines.append(
            "the image moves and the attitude does not: move the vehicle, not the target; if you "
            "do, this is not that vehicle's autopilot"
        )
    return lines


def diagnosis(judgement: SignJudgement) -> str:
    """Return what is wrong with the camera and what to set, "" if nothing is known to be."""
    if not judgement.is_wrong:
        return ""
    if judgement.signs in _DIAGNOSES:
        return _DIAGNOSES[judgement.signs]
    if Sign.WAITING in judgement.signs:
        return "one direction is wrong; make the other movement, too, to find out how"
    return (
        "the image does not move as the attitude says: does the target stand still, is it far "
        "enough (5 m), are camera.pitch_deg, yaw_deg and roll_deg right?"
    )


@dataclass(frozen=True, slots=True)
class SignTestResult:
    """How a sign test ended.

    Attributes:
        passed: everything agrees.
        text: what was found, and what to do.
        interrupted: the user ended it early.
    """

    passed: bool
    text: str
    interrupted: bool = False


class SignTest:
    """Stepped by whoever has the frames; see docs/how-to/fly.md for what it finds and how.

    Args:
        settings: all of them.
        link: to the autopilot; polled, never asked to move anything.
        tracker: fresh.
        selector: finds the target.
        size: width and height of the frames.
    """

    def __init__(
        self,
        settings: Settings,
        link: Link,
        tracker: TargetTracker,
        selector: Selector,
        size: tuple[int, int],
    ) -> None:
        self._mount = settings.camera.mount
        self._link = link
        self._vision = VisionStage(tracker)
        self._vision.select(selector)
        self._dry_run = DryRun(settings, settings.camera.model(*size))
        self._evidence = SignEvidence(self._mount)
        self._reaction = Reaction()
        self._turns = "yaw" in movers(self._mount)
        self._track: Track | None = None
        self._command: DryRunCommand | None = None
        self._frame_s = -math.inf
        self._wrong_since_s = math.inf

    def step(self, now_s: float, frame: Frame | None) -> SignTestResult | None:
        """Do one step with a new frame, or with none; return the result once there is one."""
        self._link.poll(now_s)
        vehicle = self._link.state
        if vehicle.armed:
            return SignTestResult(
                False, "the vehicle is armed: disarm it, take the propellers off, and begin again"
            )
        if frame is not None:
            self._frame_s = now_s
            self._track = self._vision.step(frame)
        self._command, seen = self._dry_run.step(now_s, self._track, vehicle, self._link.attitudes)
        if seen is not None:
            self._evidence.add(*seen)
            if self._command is not None and vehicle.attitude is not None:
                setpoint, _ = self._command
                self._reaction.add(now_s, vehicle.attitude.yaw_rad, setpoint.yaw_rate_rad_s)
        return self._result(now_s)

    def lines(self, now_s: float) -> list[str]:
        """Return what to show: what would be flown, what is known and what to do."""
        seen = self._track is not None and self._track.state is TrackState.TRACKING
        if self._link.state.heartbeat_age_s(now_s) > _SILENT_S:
            return ["waiting for the autopilot"]
        if now_s - self._frame_s > _SILENT_S:
            return ["no frames come: look after the camera"]
        if not seen or self._command is None:
            return ["the target is not seen"]
        judgement = self._evidence.judge()
        setpoint, direction = self._command
        lines = [f"{where(direction)} -> {intent(setpoint)}"]
        lines += progress(judgement, self._mount)
        lines += [self._turning()] if self._turns else []
        wrong = diagnosis(judgement)
        return [*lines, f"WRONG: {wrong}"] if wrong else lines

    def summary(self) -> str:
        """Return what is known, for somebody who ends the test early."""
        return "; ".join([*progress(self._evidence.judge(), self._mount), self._turning()])

    def _turning(self) -> str:
        return {
            Sign.WAITING: "turning back: turn the vehicle left and right by hand",
            Sign.RIGHT: "turning back: would turn against your hand, towards the target",
            Sign.REVERSED: "turning back: WRONG, would turn with your hand, away from the target",
        }.get(self._reaction.judge(), "turning back: unclear, does the target stand still?")

    def _result(self, now_s: float) -> SignTestResult | None:
        judgement, turn = self._evidence.judge(), self._reaction.judge()
        if judgement.passed and (turn is Sign.RIGHT or not self._turns):
            return SignTestResult(True, "the camera sees as the settings say; " + self.summary())
        if not judgement.is_wrong and turn is not Sign.REVERSED:
            self._wrong_since_s = math.inf
            return None
        self._wrong_since_s = min(self._wrong_since_s, now_s)
        if Sign.WAITING not in judgement.signs and now_s - self._wrong_since_s >= _WRONG_FOR_S:
            return SignTestResult(False, diagnosis(judgement) or self._turning())
        return None


def sign_test(
    settings: Settings, target: TargetChoice, source: VideoInput, connect: str, lens_given: bool
) -> int:
    """Run the sign test to its end, and return the exit code: 0 passed, 1 failed.

    Args:
        settings: that would be flown with.
        target: stands still, 5 m away or farther.
        source: the camera.
        connect: where the autopilot speaks MAVLink.
        lens_given: the settings name a field of view or a focal length.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    if not target.given:
        raise SettingsError("which target? give --select, --colour or --target")
    if not lens_given:
        raise SettingsError(f"the sign test needs to know the lens: {LENS_ADVICE}")
    if settings.gimbal.enabled:
        raise SettingsError(
            "the sign test is for a camera that is fixed to the vehicle: a gimbal turns against "
            "the hand; lock it and give --set gimbal.enabled=false and its angles as camera.*_deg"
        )
    selector = first_selected(target.selector(make_settings_detector(settings)))
    tracker = make_target_tracker(settings)
    console, clock = Console(), MonotonicClock()
    cv2.setNumThreads(1)
    with stop_signals() as pressed, ExitStack() as stack:
        link = stack.enter_context(opened_link(connect, settings, clock))
        frames = stack.enter_context(source.open(clock))
        camera = stack.enter_context(CameraWatch(frames, source.shown, clock))
        first = camera.frames.wait(_FIRST_FRAME_S)
        if first is None:
            raise SourceError(f"{source.shown}: {frames.problem or 'no frame came'}")
        test = SignTest(settings, link, tracker, selector, (first.width, first.height))
        result = run(test, link, camera, clock, console, pressed)
    style = "bold green" if result.passed else "bold red"
    print_line(console, f"{'Passed' if result.passed else 'Failed'}: {result.text}", style)
    if result.interrupted:
        return _INTERRUPTED
    return _PASSED if result.passed else _FAILED


def run(
    test: SignTest,
    link: Link,
    camera: CameraWatch,
    clock: Clock,
    console: Console,
    pressed: InterruptFlag,
) -> SignTestResult:
    """Step a test until it has a result, or the user ends it.

    Raises:
        ConnectionFailedError: no autopilot answered.
    """
    start_s, shown_s = clock.now(), -math.inf
    with Live(console=console, auto_refresh=False, transient=True) as live:
        try:
            while True:
                pressed.check()
                now_s = clock.now()
                result = test.step(now_s, camera.frames.wait(0))
                if result is not None:
                    return result
                if now_s - shown_s >= (_SHOW_S if console.is_terminal else _PLAIN_S):
                    shown_s, lines = now_s, test.lines(now_s)
                    live.update(Text("\n".join(lines)), refresh=True)
                    if not console.is_terminal:
                        print_line(console, "; ".join(lines))
                _check_received(link, now_s - start_s, now_s)
                clock.sleep_until(now_s + _STEP_S)
        except KeyboardInterrupt:
            return SignTestResult(False, f"ended early: {test.summary()}", interrupted=True)


def _check_received(link: Link, waited_s: float, now_s: float) -> None:
    status = link.status(now_s)
    if not link.connected and (status.problem or waited_s > _ANSWER_WITHIN_S):
        raise ConnectionFailedError(status.problem or f"no autopilot answered ({status.line()})")
