"""What is asked of a vehicle so that its response can be identified: steps there and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar

from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint

_SHARES = (0.5, 1.0)
"""A small step and a large one: a vehicle that answers both alike is a linear one."""
_TONES_HZ = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4)
_CREST = 0.65
"""Of the tones' sum over what it would be if all peaked at once."""
_PERIOD_S = 20.0
"""Of the multisine: two of its longest tone, all of whose others fit in."""


class PatternKind(StrEnum):
    """The shape of the excitation."""

    STEPS = "steps"
    """Doublets: out, back, stop. Easy to watch, and ends where it began."""
    MULTISINE = "multisine"
    """Seven tones from 0.1 to 1.4 Hz at once: all frequencies, and a restless flight."""


@dataclass(frozen=True, slots=True)
class ExcitationSettings:
    """How large and how long.

    Attributes:
        kind: steps or tones.
        forward_m_s, right_m_s, vertical_m_s, yaw_deg_s: the largest setpoint on each body axis, m/s
            and deg/s; 0 leaves the axis out.
        hold_s: how long each half of a doublet lasts, seconds.
        rest_s: a hold between two of them, and at the beginning and the end.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    kind: PatternKind = PatternKind.STEPS
    forward_m_s: float = 2.0
    right_m_s: float = 2.0
    vertical_m_s: float = 0.8
    yaw_deg_s: float = 30.0
    hold_s: float = 3.0
    rest_s: float = 2.5

    def __post_init__(self) -> None:
        for name, most in (("forward_m_s", 10.0), ("right_m_s", 10.0), ("vertical_m_s", 3.0)):
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name} lies within 0 and {most:g}, not {getattr(self, name):g}")
        if not 0 <= self.yaw_deg_s <= 90:
            raise ValueError(f"yaw_deg_s lies within 0 and 90, not {self.yaw_deg_s:g}")
        if max(self.forward_m_s, self.right_m_s, self.vertical_m_s, self.yaw_deg_s) == 0:
            raise ValueError("at least one axis has to be moved")
        if not 0.5 <= self.hold_s <= 20 or not 0.5 <= self.rest_s <= 20:
            raise ValueError("hold_s and rest_s lie within 0.5 and 20 s")


@dataclass(frozen=True, slots=True)
class _Piece:
    """A direction for some time: a constant share of it, or the tones."""

    start_s: float
    length_s: float
    share: float
    towards: VelocitySetpoint
    tones: bool = False


RUN_KEY = "excitation"
"""Under which a recording's `run` keeps the pattern's settings."""


def recorded_pattern(run: Mapping[str, Any]) -> Pattern | None:
    """Return the pattern that a recorded flight flew, None if it was a pursuit.

    Raises:
        ValueError: what is recorded of it is no pattern.
    """
    if RUN_KEY not in run:
        return None
    try:
        plain = dict(run[RUN_KEY])
        plain["kind"] = PatternKind(plain.get("kind", PatternKind.STEPS))
        return Pattern(ExcitationSettings(**plain))
    except TypeError as error:
        raise ValueError(f"the recorded {RUN_KEY} cannot be flown again: {error}") from None


class Pattern:
    """Setpoints over time, axis after axis, each of which ends at rest."""

    def __init__(self, settings: ExcitationSettings) -> None:
        self._settings = settings
        self._pieces: list[_Piece] = []
        self.length_s = 0.0
        self._rest()
        for axis in _axes(settings):
            if settings.kind is PatternKind.MULTISINE:
                self._add(_PERIOD_S, 1.0, axis, tones=True)
                self._rest()
                continue
            for share in _SHARES:
                self._add(settings.hold_s, share, axis)
                self._add(settings.hold_s, -share, axis)
                self._rest()

    def setpoint(self, time_s: float) -> VelocitySetpoint:
        """Return the setpoint `time_s` seconds after the beginning; a hold before and after."""
        for piece in self._pieces:
            if 0 <= time_s - piece.start_s < piece.length_s:
                share = _tones(time_s - piece.start_s) if piece.tones else piece.share
                return VelocitySetpoint(*(share * x for x in piece.towards.values))
        return HOLD

    def _rest(self) -> None:
        self.length_s += self._settings.rest_s

    def _add(
        self, length_s: float, share: float, towards: VelocitySetpoint, tones: bool = False
    ) -> None:
        self._pieces.append(_Piece(self.length_s, length_s, share, towards, tones))
        self.length_s += length_s


def _axes(s: ExcitationSettings) -> list[VelocitySetpoint]:
    """Return one setpoint for each axis that is moved; up before down."""
    axes = (
        VelocitySetpoint(forward_m_s=s.forward_m_s),
        VelocitySetpoint(right_m_s=s.right_m_s),
        VelocitySetpoint(down_m_s=-s.vertical_m_s),
        VelocitySetpoint(yaw_rate_rad_s=math.radians(s.yaw_deg_s)),
    )
    return [axis for axis in axes if any(axis.values)]


def _tones(time_s: float) -> float:
    """Return the sum of the tones: within ±1, zero at both ends, phases after Schroeder (1970)."""
    count = len(_TONES_HZ)
    total = sum(
        math.sin(2 * math.pi * tone * time_s - math.pi * k * k / count)
        for k, tone in enumerate(_TONES_HZ)
    )
    fade = min(1.0, time_s, _PERIOD_S - time_s)
    return fade * min(max(total / (_CREST * count), -1.0), 1.0)
