"""Keeps a box's size near the one believed, and its centre on the image."""

from __future__ import annotations

import math

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.belief import Belief, towards
from follower_vision.fusion.settings import FusionSettings

_REFERENCE_MEMORY_S = 0.7
_UNCONFIRMED_POWER = 2.0


def drawn(reference: Box, box: Box, interval_s: float) -> Box:
    """Let the reference's size follow a box's slowly, with a time constant of 0.7 s."""
    return towards(reference, box, 1 - math.exp(-interval_s / _REFERENCE_MEMORY_S))


def clamped(box: Box, belief: Belief, settings: FusionSettings) -> Box:
    """Keep the size near the reference's; nearer if the detector has confirmed that lately."""
    if not settings.size_clamp:
        return box
    power = 1.0 if belief.unconfirmed_s <= _REFERENCE_MEMORY_S else _UNCONFIRMED_POWER
    least = belief.reference.scaled(settings.size_least**power)
    most = belief.reference.scaled(settings.size_most**power)
    width = min(max(box.width, least.width), most.width)
    return Box(box.cx, box.cy, width, min(max(box.height, least.height), most.height))


def inside(box: Box, frame: Frame) -> Box:
    """Keep the centre on the image."""
    return box.moved_to(min(max(box.cx, 0.0), frame.width), min(max(box.cy, 0.0), frame.height))
