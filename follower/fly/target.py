"""Points out the one target of a flight."""

from __future__ import annotations

from follower.fly.options import FlyOptions
from follower.object_selector import ChoiceError, ObjectSelector, Wanted
from follower.selecting import box_selector, colour_selector
from follower.vision_stage import Selector
from follower_vision.box import Box
from follower_vision.detection import Detector
from follower_vision.frame import Frame
from follower_vision.network import ModelError


def target_selector(options: FlyOptions, detector: Detector | None) -> Selector:
    """Return what finds the target in a frame.

    Raises:
        SettingsError: what was asked for is no class, colour or box.
        ModelError: a class was asked for, and there is no detector.
    """
    if options.target is not None:
        return box_selector(options.target)
    if options.colour is not None:
        return colour_selector(options.colour)
    if detector is None:
        raise ModelError("--select needs a detector; name one by --detector")
    return _object_selector(options.select or "", detector)


def _object_selector(text: str, detector: Detector) -> Selector:
    objects = ObjectSelector([Wanted.parse(text, detector.class_names)], detector)

    def select(frame: Frame) -> Box | None:
        try:
            found = objects(frame)
        except ChoiceError:
            return None  # fewer than the number asked for are seen so far
        return found[0] if found else None

    return select
