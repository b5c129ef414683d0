"""Checks of the camera, its lens and the networks that look at its frames."""

from __future__ import annotations

import math

import numpy as np

from follower.preflight.finding import Finding, Verdict, failed, passed, unknown, warned
from follower.preflight.snapshot import Snapshot
from follower_control.servo_settings import Mode, RangeFrom
from follower_vision.camera import CameraModel

_SLOW_HZ, _TOO_SLOW_HZ = 15.0, 5.0
_UNSTEADY = 0.5
_OLD_S = 0.15
_DARK = 3.0
_FROZEN_SHARE = 0.5
_NARROW_DEG, _WIDE_DEG = 15.0, 130.0
_MOST_FOLD = 1e-3


def camera(s: Snapshot) -> Finding:
    """Frames come."""
    reading = s.camera
    if not reading.frames:
        return failed(
            reading.problem or "no frame came", "is the camera plugged in, free, and sending?"
        )
    width, height = reading.size or (0, 0)
    return passed(f"{reading.frames} frames of {width}x{height} pixels from {reading.source}")


def frame_rate(s: Snapshot) -> Finding:
    """Frames come often and steadily."""
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


def frame_age(s: Snapshot) -> Finding:
    """Frames are fresh when they are looked at."""
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


def picture(s: Snapshot) -> Finding:
    """The picture shows something, and moves."""
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


def frame_size(s: Snapshot) -> Finding:
    """Frames have the size for which the lens was described."""
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


def lens(s: Snapshot) -> Finding:
    """Field of view and distortion are given and plausible."""
    if not s.lens_given:
        return failed(
            "neither a field of view nor a focal length is set",
            lens_advice(),
        )
    if s.camera.size is None:
        return unknown("no frame came")
    return judge_lens(s.settings.camera.model(*s.camera.size))


def lens_advice() -> str:
    """Return what to set so that the lens is known."""
    return (
        "set camera.fov_deg (horizontal, from the data sheet), or camera.focal_px and "
        "camera.focal_width_px: `follower calibrate` finds them"
    )


def judge_lens(model: CameraModel) -> Finding:
    """Judge intrinsics at the size of the frames."""
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


def mount(s: Snapshot) -> Finding:
    """The camera's mount is one that following works with."""
    c = s.settings.camera
    if s.settings.gimbal.enabled:
        return warned("held by a gimbal, which is not checked", "look whether it turns freely")
    pitch = f"{abs(c.pitch_deg):g} deg {'down' if c.pitch_deg < 0 else 'up'}"
    pitch = pitch if c.pitch_deg else "straight on"
    turned = f", turned {c.yaw_deg:g} deg to the right" if c.yaw_deg else ""
    rolled = f", rolled {c.roll_deg:g} deg" if c.roll_deg else ""
    text = f"looks {pitch}{turned}{rolled}"
    if c.pitch_deg > 30:
        return warned(f"{text}: into the sky", "looking down is negative in camera.pitch_deg")
    return passed(text)


def circling(s: Snapshot) -> Finding:
    """Going round a target, the distance does not come from its size in the image."""
    servo = s.settings.servo
    if servo.mode not in (Mode.SIDE, Mode.ORBIT):
        return passed("it does not go round the target")
    if servo.range_from is RangeFrom.GROUND:
        return passed("the distance comes from the ground")
    return warned(
        f"servo.mode {servo.mode} takes the distance from the target's size: it comes too near "
        "where that looks smaller",
        "set servo.range_from: ground and servo.target_middle_m, if the ground is level",
    )


def models(s: Snapshot) -> Finding:
    """The networks' files are there and are the right ones."""
    if not s.models:
        return passed("no network is needed")
    bad = {name: state for name, state in s.models.items() if state != "good"}
    if bad:
        listed = ", ".join(f"{name} is {state}" for name, state in bad.items())
        return failed(listed, "`follower models pull`, `follower models verify`")
    return Finding(Verdict.PASS, ", ".join(s.models))
