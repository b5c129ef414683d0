"""Checks of the camera, its lens and the networks that look at its frames."""

import math
import threading
from collections import deque
from contextlib import ExitStack
from typing import Self

import numpy as np

from follower.apps.preflight.check import (
    CameraReading,
    CheckGroup,
    CompanionSnapshot,
    PreflightFinding,
    failed,
    passed,
    unknown,
    warned,
)
from follower_control.servo.settings import FollowMode, RangeFrom
from follower_vision.clock import Clock
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Frame
from follower_vision.mailbox import Mailbox
from follower_vision.sources.frame_source import ClosesItself, FrameSource

CAMERA = CheckGroup[CompanionSnapshot]("Camera")
_SLOW_HZ, _TOO_SLOW_HZ = 15.0, 5.0
_UNSTEADY = 0.5
_OLD_S = 0.15
_DARK = 3.0
_FROZEN_SHARE = 0.5
_NARROW_DEG, _WIDE_DEG = 15.0, 130.0
_MOST_FOLD = 1e-3
_MOST_TURNED_DEG = 15.0
LENS_ADVICE = (
    "set camera.fov_deg (horizontal, from the data sheet), or camera.focal_px and "
    "camera.focal_width_px: `follower calibrate` finds them"
)


@CAMERA.check("camera", "frames come")
def _camera(s: CompanionSnapshot) -> PreflightFinding:
    reading = s.camera
    if not reading.frames:
        return failed(
            reading.problem or "no frame came", "is the camera plugged in, free, and sending?"
        )
    width, height = reading.size or (0, 0)
    return passed(f"{reading.frames} frames of {width}x{height} pixels from {reading.source}")


@CAMERA.check(
    "frame-rate",
    "15 Hz with jitter below half an interval; never below 5 Hz, no gap longer than "
    "supervisor.frame_timeout_s",
)
def _frame_rate(s: CompanionSnapshot) -> PreflightFinding:
    reading = s.camera
    if not reading.interval_s > 0:
        return unknown("too few frames to tell")
    rate = 1 / reading.interval_s
    text = (
        f"{rate:.0f} Hz, jitter {1e3 * reading.jitter_s:.0f} ms, longest gap "
        f"{1e3 * reading.worst_interval_s:.0f} ms"
    )
    if rate < _TOO_SLOW_HZ or reading.worst_interval_s > s.settings.supervisor.frame_timeout_s:
        return failed(text, "a smaller image, more light, a cable instead of radio")
    if rate < _SLOW_HZ or reading.jitter_s > _UNSTEADY * reading.interval_s:
        return warned(text, "a smaller image, more light, a fixed exposure time")
    return passed(text)


@CAMERA.check(
    "frame-age",
    "a frame is at most 150 ms old when it is taken; never older than supervisor.frame_timeout_s",
)
def _frame_age(s: CompanionSnapshot) -> PreflightFinding:
    age_s = s.camera.age_s
    if not math.isfinite(age_s):
        return unknown("no frame came")
    latency_s = s.settings.camera.latency_s
    text = f"{1e3 * age_s:.0f} ms old when taken, stamped {1e3 * latency_s:.0f} ms late by setting"
    if age_s > s.settings.supervisor.frame_timeout_s:
        return failed(text, "the computer is too slow for this stream: a smaller image")
    if age_s > _OLD_S:
        return warned(text, "a smaller image, or fewer other programs")
    return passed(text)


@CAMERA.check("picture", "the picture is not of one colour and does not stand still")
def _picture(s: CompanionSnapshot) -> PreflightFinding:
    reading = s.camera
    if not reading.frames:
        return unknown("no frame came")
    if reading.contrast < _DARK:
        return failed(
            f"contrast {reading.contrast:.1f}: black, white or grey all over",
            "take off the lens cap, look after exposure and cable",
        )
    if reading.frames > 1 and reading.repeats / (reading.frames - 1) > _FROZEN_SHARE:
        return warned(
            f"{reading.repeats} of {reading.frames} frames are the same to the last bit",
            "the camera or its driver stands still; restart it",
        )
    return passed(f"contrast {reading.contrast:.0f}")


@CAMERA.check("frame-size", "frames have the size camera.frame_size, if that is set")
def _frame_size(s: CompanionSnapshot) -> PreflightFinding:
    size, wanted = s.camera.size, s.settings.camera.frame_size
    if size is None:
        return unknown("no frame came")
    text = f"{size[0]}x{size[1]}"
    if wanted is None:
        if any(s.settings.camera.distortion):
            return warned(f"{text}; the calibration's size is not set", "set camera.frame_size")
        return passed(text)
    if size != tuple(wanted):
        return failed(
            f"frames are {text}, the settings describe {wanted[0]}x{wanted[1]}",
            "have the camera send that size, or set camera.frame_size and the lens for this one",
        )
    return passed(text)


@CAMERA.check(
    "lens",
    "a field of view of 15 to 130 deg or a focal length is set; the distortion does not fold "
    "the image",
)
def _lens(s: CompanionSnapshot) -> PreflightFinding:
    if not s.lens_given:
        return failed("neither a field of view nor a focal length is set", LENS_ADVICE)
    if s.camera.size is None:
        return unknown("no frame came")
    model = s.settings.camera.model(*s.camera.size)
    fov_deg = math.degrees(model.horizontal_fov_rad)
    text = f"{fov_deg:.0f} deg across, focal length {model.fx:.0f} px at {model.width} px"
    if folds(model):
        return failed(
            f"{text}; the distortion folds the image before its corners",
            "set camera.distortion to k1, k2, p1, p2, k3 of a calibration with this lens; a "
            "fisheye needs another model",
        )
    if not _NARROW_DEG <= fov_deg <= _WIDE_DEG:
        return failed(text, "check camera.fov_deg, camera.focal_px and camera.focal_width_px")
    return passed(text)


def folds(model: CameraModel) -> bool:
    """Whether some pixel's ray, put through the lens again, does not come back to that pixel."""
    across, down = np.linspace(0, model.width, 9), np.linspace(0, model.height, 7)
    pixels = np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)
    rays = model.rays(pixels)
    if not np.isfinite(rays).all() or (rays[:, 2] <= 0).any():
        return True
    wrong = np.abs(model.pixels(rays) - pixels).max()
    return not wrong < _MOST_FOLD * model.width


@CAMERA.check("mount", "the camera looks ahead, and not into the sky")
def _mount(s: CompanionSnapshot) -> PreflightFinding:
    c = s.settings.camera
    if s.settings.gimbal.enabled:
        return warned("held by a gimbal, which is not checked", "look whether it turns freely")
    pitch = f"{abs(c.pitch_deg):g} deg {'down' if c.pitch_deg < 0 else 'up'}"
    pitch = pitch if c.pitch_deg else "straight on"
    turned = f", turned {c.yaw_deg:g} deg to the right" if c.yaw_deg else ""
    rolled = f", rolled {c.roll_deg:g} deg" if c.roll_deg else ""
    text = f"looks {pitch}{turned}{rolled}"
    if abs(c.yaw_deg) > _MOST_TURNED_DEG or abs(c.pitch_deg) > 90:
        return failed(
            f"{text}: the nose is turned to the target, and so the camera away from it",
            "mount it so that it looks ahead, with camera.yaw_deg near 0 and camera.pitch_deg "
            "from -90 to 90; a camera upside down has camera.roll_deg 180",
        )
    if c.pitch_deg > 30:
        return warned(f"{text}: into the sky", "looking down is negative in camera.pitch_deg")
    return passed(text)


@CAMERA.check(
    "circling",
    "with servo.mode side or orbit the distance comes from the ground (servo.range_from): a "
    "size changes with the side that is seen",
    needed=False,
)
def _circling(s: CompanionSnapshot) -> PreflightFinding:
    servo = s.settings.servo
    if servo.mode not in (FollowMode.SIDE, FollowMode.ORBIT):
        return passed("it does not go round the target")
    if servo.range_from is RangeFrom.GROUND:
        return passed("the distance comes from the ground")
    return warned(
        f"servo.mode {servo.mode} takes the distance from the target's size: it comes too near "
        "where that looks smaller",
        "set servo.range_from: ground and servo.target_middle_m, if the ground is level",
    )


@CAMERA.check("models", "the networks that the settings name are there, with the right SHA-256")
def _models(s: CompanionSnapshot) -> PreflightFinding:
    if not s.models:
        return passed("no network is needed")
    bad = {name: state for name, state in s.models.items() if state != "good"}
    if bad:
        listed = ", ".join(f"{name} is {state}" for name, state in bad.items())
        return failed(listed, "`follower models pull`, `follower models verify`")
    return passed(", ".join(s.models))


_MOST = 600
_WINDOW_S = 3.0
"""A stream that begins with a gap is not blamed for it for ever."""
_EVERY_NTH_PIXEL = 4
_JOIN_S = 3.0


class CameraWatch(ClosesItself):
    """Reads a source on a thread of its own while it is entered; the source stays open.

    Args:
        source: at its beginning, or live.
        name: of the source, for people.
        clock: on which frames are timed.

    Attributes:
        frames: the newest frame, for whoever looks at it.
    """

    def __init__(self, source: FrameSource, name: str, clock: Clock) -> None:
        self._source = source
        self._name = name
        self._clock = clock
        self._lock = threading.Lock()
        self._captured_s: deque[float] = deque(maxlen=_MOST)
        self._ages_s: deque[float] = deque(maxlen=_MOST)
        self._count = self._repeats = 0
        self._newest: Frame | None = None
        self._sample = np.empty((0, 0, 3), np.uint8)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera watch", daemon=True)
        self.frames: Mailbox[Frame] = Mailbox()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.callback(self.close)  # Ctrl-C may come when the thread already reads
            self._thread.start()
            stack.pop_all()
        return self

    def close(self) -> None:
        """Stop reading; the source stays open."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    def reading(self) -> CameraReading:
        """Return what was seen in the last three seconds."""
        problem = self._source.problem or ""
        with self._lock:
            newest, captured_s, ages_s = self._newest, [*self._captured_s], [*self._ages_s]
        if newest is None:
            return CameraReading(self._name, problem)
        # The gap that has not ended yet counts, too: a camera that has died has no next frame.
        ended_s = max(captured_s[-1], self._clock.now() - ages_s[-1])
        intervals = np.diff(captured_s)
        median = float(np.median(intervals)) if len(intervals) else math.nan
        deviation = np.abs(intervals - median)
        return CameraReading(
            self._name,
            problem,
            (newest.width, newest.height),
            self._count,
            median,
            float(max(*intervals, ended_s - captured_s[-1])) if len(intervals) > 1 else math.nan,
            float(np.percentile(deviation, 95)) if len(intervals) else math.nan,
            float(np.percentile(ages_s, 95)),
            float(newest.image[::_EVERY_NTH_PIXEL, ::_EVERY_NTH_PIXEL].mean(2).std()),
            self._repeats,
        )

    def _run(self) -> None:
        while not self._stop.is_set():
            frame = self._source.read()
            if frame is None:
                return
            self._take(frame)

    def _take(self, frame: Frame) -> None:
        before, self._sample = self._sample, frame.image[::_EVERY_NTH_PIXEL, ::_EVERY_NTH_PIXEL]
        self._count += 1
        self._repeats += np.array_equal(before, self._sample)
        with self._lock:
            self._newest = frame
            self._ages_s.append(self._clock.now() - frame.captured_s)
            self._captured_s.append(frame.captured_s)
            while self._captured_s[0] < frame.captured_s - _WINDOW_S:
                self._captured_s.popleft()
                self._ages_s.popleft()
        self.frames.put(frame)
