"""The loops of one set of settings, now, tuned, and under other circumstances."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from follower.settings.settings import Settings
from follower.tuning.identify.result import VehicleFile
from follower_control.common.strict_config import SettingsError
from follower_control.servo.pid import PidSettings
from follower_control.servo.settings import FollowMode, ServoSettings
from follower_control.tuning.axes import Axis, LoopSettings, axis_loop
from follower_control.tuning.axis_loop import AxisLoop, Conditions
from follower_control.tuning.response_model import VehicleModel
from follower_control.tuning.synthesis import Tuned, TuningGoal, tune

KEYS = {
    "delay": "from the camera's exposure to the setpoint, s (known to the follower)",
    "stamp_error": "how much later than the exposure frames are stamped, s (not known to it)",
    "dead_time": "more dead time in link and autopilot, s",
    "camera_rate": "frames a second",
    "range": "range kept, as by a stick offset, m",
    "gain": "all gains times this",
}


@dataclass(frozen=True, slots=True)
class WhatIf:
    """Circumstances, and a factor on all gains."""

    conditions: Conditions
    gain: float = 1.0
    words: str = ""


def parse_what_ifs(texts: Sequence[str], conditions: Conditions) -> list[WhatIf]:
    """Return one for each text `key=value[,key=value]`.

    Raises:
        SettingsError: a key is unknown, or a value no number that makes sense.
    """
    return [_parsed(text, conditions) for text in texts]


def _parsed(text: str, conditions: Conditions) -> WhatIf:
    values = dict(_pair(text, part) for part in text.split(","))
    gain = values.get("gain", 1.0)
    try:
        for key in KEYS:  # a delay before the stamp's error, which is a part of it
            if key in values:
                conditions = _changed(conditions, key, values[key])
    except ValueError as error:
        raise SettingsError(f"--what-if {text}: {error}") from None
    if not 0.01 <= gain <= 100:
        raise SettingsError(f"--what-if {text}: a gain's factor lies between 0.01 and 100")
    return WhatIf(conditions, gain, text)


def _pair(text: str, part: str) -> tuple[str, float]:
    key, _, value_text = part.strip().partition("=")
    if key not in KEYS:
        known = "; ".join(f"{name}: {what}" for name, what in KEYS.items())
        raise SettingsError(f"--what-if {text}: there is no {key!r}; there are {known}")
    try:
        value = float(value_text)
    except ValueError:
        raise SettingsError(f"--what-if {text}: {value_text!r} is no number") from None
    if key == "camera_rate" and value <= 0:
        raise SettingsError(f"--what-if {text}: a camera takes more than {value:g} frames a second")
    if not math.isfinite(value):
        raise SettingsError(f"--what-if {text}: {value_text} is no finite number")
    return key, value


def _changed(conditions: Conditions, key: str, value: float) -> Conditions:
    delays = conditions.delays
    if key == "delay":
        return replace(conditions, delays=replace(delays, camera_s=value))
    if key == "stamp_error":
        # A stamp that is late by so much hides as much of the delay.
        camera_s = max(delays.camera_s, abs(value))
        return replace(conditions, delays=replace(delays, camera_s=camera_s, stamp_error_s=value))
    if key == "dead_time":
        return replace(conditions, delays=replace(delays, extra_s=value))
    if key == "camera_rate":
        return replace(conditions, delays=replace(delays, frame_interval_s=1 / value))
    return replace(conditions, range_m=value) if key == "range" else conditions


@dataclass(frozen=True, slots=True)
class AxisAnalysis:
    """One axis.

    Attributes:
        axis: which.
        gains: the present ones.
        now: the loop with them.
        tuned: what was found, None if nothing was searched.
        what_ifs: the loop that counts (tuned, else now) under each other circumstance.
        max_sensitivity: what Ms is wanted to stay below.
    """

    axis: Axis
    gains: PidSettings
    now: AxisLoop
    tuned: Tuned | None
    what_ifs: tuple[tuple[str, AxisLoop], ...]
    max_sensitivity: float

    @property
    def chosen(self) -> PidSettings:
        """The gains that count."""
        return self.gains if self.tuned is None else self.tuned.gains


def conditions_of(settings: Settings, vehicle: VehicleFile, elevation_deg: float) -> Conditions:
    """Return steady following at the wanted distance, with the identified delays in seconds."""
    servo = settings.servo
    size_m = vehicle.target.size_m or servo.target_size_m or Conditions().size_m
    delays = replace(vehicle.delays, control_interval_s=1 / settings.control_rate_hz)
    return Conditions(delays, servo.distance_m, math.radians(elevation_deg), size_m)


def analyse(
    settings: Settings,
    vehicle: VehicleModel,
    conditions: Conditions,
    goals: Mapping[Axis, TuningGoal] | None,
    what_ifs: Sequence[WhatIf] = (),
) -> list[AxisAnalysis]:
    """Analyse every axis; with goals, find gains for it.

    Raises:
        SettingsError: a what-if makes gains that no loop can have.
    """
    follower = LoopSettings(settings.servo, settings.estimator, settings.envelope)
    found = []
    for axis in Axis:
        gains = follower.gains(axis)
        now = axis_loop(axis, gains, vehicle, follower, conditions)
        goal = TuningGoal() if goals is None else goals[axis]
        tuned = None if goals is None else tune(axis, vehicle, follower, conditions, goal)
        chosen = gains if tuned is None else tuned.gains
        others = []
        for one in what_ifs:
            try:
                scaled = _scaled(chosen, one.gain)
                loop = axis_loop(axis, scaled, vehicle, follower, one.conditions)
            except ValueError as error:
                raise SettingsError(f"--what-if {one.words}: {axis}: {error}") from None
            others.append((one.words, loop))
        found.append(AxisAnalysis(axis, gains, now, tuned, tuple(others), goal.max_sensitivity))
    return found


_UNLIKE_CHASE = {
    FollowMode.WATCH: "it uses azimuth alone",
    FollowMode.SIDE: "servo.bearing, which only it uses, is not tuned",
    FollowMode.ORBIT: "servo.orbit_rate, which only it uses, is not tuned",
}


def mode_remarks(servo: ServoSettings) -> list[str]:
    """Return in sentences what the loops of chasing do not say of the mode that is set."""
    remarks = []
    if servo.mode is not FollowMode.CHASE:
        unlike = _UNLIKE_CHASE.get(
            servo.mode, "these are the loops of chase; its own are not tuned"
        )
        remarks.append(f"servo.mode is {servo.mode}: {unlike}")
    if servo.hold_height:
        remarks.append("servo.hold_height is set: the elevation loop does nothing")
    return remarks


def overlay(analysis: Sequence[AxisAnalysis]) -> dict[str, Any]:
    """Return the gains in the form in which settings are read."""
    return {"servo": {one.axis.value: _plain(one.chosen) for one in analysis}}


def _plain(gains: PidSettings) -> dict[str, float]:
    return {name: float(f"{value:.4g}") for name, value in asdict(gains).items()}


def _scaled(gains: PidSettings, factor: float) -> PidSettings:
    return replace(gains, kp=factor * gains.kp, ki=factor * gains.ki, kd=factor * gains.kd)
