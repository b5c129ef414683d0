"""What-if: the same loops under other circumstances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from follower_control.strict_yaml import SettingsError
from follower_control.tuning.conditions import Conditions

KEYS = {
    "delay": "from the camera's exposure to the setpoint, s (known to the follower)",
    "stamp_error": "how much later than the exposure frames are stamped, s (not known to it)",
    "dead_time": "more dead time in link and autopilot, s",
    "camera_rate": "frames a second",
    "range": "distance kept by a nudge, m",
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
    gain = 1.0
    for part in text.split(","):
        key, value = _pair(text, part)
        if key == "gain":
            gain = value
        try:
            conditions = _changed(conditions, key, value)
        except ValueError as error:
            raise SettingsError(f"--what-if {text}: {error}") from None
    if not 0 < gain < 100:
        raise SettingsError(f"--what-if {text}: a gain's factor is above 0 and below 100")
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
