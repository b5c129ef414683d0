"""`follower preflight --sign-test`."""

from __future__ import annotations

import math
from contextlib import ExitStack

import cv2
from rich.console import Console
from rich.live import Live
from rich.text import Text

from follower.fly.camera import open_camera
from follower.fly.options import FlyOptions
from follower.fly.preflight import opened_link
from follower.fly.target import target_selector
from follower.links.connection import ConnectionFailedError
from follower.links.link import Link
from follower.preflight.camera_checks import lens_advice
from follower.preflight.camera_watch import CameraWatch
from follower.print_line import print_line
from follower.sign_test.session import SignTest, SignTestResult
from follower.tracking import make_settings_detector, make_target_tracker
from follower.watched import Pressed, stop_signals
from follower_control.strict_yaml import SettingsError
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.framesource import SourceError

_PASSED, _FAILED, _INTERRUPTED = 0, 1, 130
_STEP_S = 0.02
_FIRST_FRAME_S = 10.0
_ANSWER_WITHIN_S = 15.0
_SHOW_S, _PLAIN_S = 0.1, 2.0


def sign_test(options: FlyOptions) -> int:
    """Run the sign test to its end, and return the exit code: 0 passed, 1 failed.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    if not options.lens_given:
        raise SettingsError(f"the sign test needs to know the lens: {lens_advice()}")
    settings = options.settings()
    if settings.gimbal.enabled:
        raise SettingsError(
            "the sign test is for a camera that is fixed to the vehicle: a gimbal turns against "
            "the hand; lock it and give --set gimbal.enabled=false and its angles as camera.*_deg"
        )
    selector = target_selector(options, make_settings_detector(settings))
    tracker = make_target_tracker(settings)
    console, clock = Console(), MonotonicClock()
    cv2.setNumThreads(1)
    with stop_signals() as pressed, ExitStack() as stack:
        link = stack.enter_context(opened_link(options, settings, clock))
        source = stack.enter_context(open_camera(options, clock))
        camera = stack.enter_context(CameraWatch(source, options.shown_camera, clock))
        first = camera.frames.wait(_FIRST_FRAME_S)
        if first is None:
            raise SourceError(f"{options.shown_camera}: {source.problem or 'no frame came'}")
        test = SignTest(settings, link, tracker, selector, (first.width, first.height))
        return _end(console, *run(test, link, camera, clock, console, pressed))


def run(
    test: SignTest,
    link: Link,
    camera: CameraWatch,
    clock: Clock,
    console: Console,
    pressed: Pressed,
) -> tuple[SignTestResult, bool]:
    """Step a test until it has a result; return it, and whether the user ended it early.

    Raises:
        ConnectionFailedError: no autopilot was heard.
    """
    start_s, shown_s = clock.now(), -math.inf
    with ExitStack() as stack:
        live = None
        if console.is_terminal:
            live = stack.enter_context(Live(console=console, auto_refresh=False, transient=True))
        try:
            while True:
                pressed.check()
                now_s = clock.now()
                result = test.step(now_s, camera.frames.wait(0))
                if result is not None:
                    return result, False
                if now_s - shown_s >= (_PLAIN_S if live is None else _SHOW_S):
                    shown_s = now_s
                    _show(console, live, test.lines(now_s))
                _check_heard(link, now_s - start_s, now_s)
                clock.sleep_until(now_s + _STEP_S)
        except KeyboardInterrupt:
            return SignTestResult(False, f"ended early: {test.summary()}"), True


def _check_heard(link: Link, waited_s: float, now_s: float) -> None:
    status = link.status(now_s)
    if not link.connected and (status.problem or waited_s > _ANSWER_WITHIN_S):
        raise ConnectionFailedError(status.problem or f"no autopilot was heard ({status.line()})")


def _show(console: Console, live: Live | None, lines: list[str]) -> None:
    if live is not None:
        live.update(Text("\n".join(lines)), refresh=True)
    else:
        words = [line for line in lines if not line.startswith(("┌", "│", "└", " "))]
        print_line(console, "; ".join(words))


def _end(console: Console, result: SignTestResult, interrupted: bool) -> int:
    style = "bold green" if result.passed else "bold red"
    verdict = "Passed" if result.passed else "Failed"
    print_line(console, f"{verdict}: {result.text}", style)
    if interrupted:
        return _INTERRUPTED
    return _PASSED if result.passed else _FAILED
