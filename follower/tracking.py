"""Makes the trackers that the settings name."""

from __future__ import annotations

import os

from follower.settings import Settings
from follower_vision.detection import make_detector
from follower_vision.fusion import FusionTracker
from follower_vision.longterm import LongTermTracker
from follower_vision.models import ModelStore, default_folder
from follower_vision.target_tracker import TargetTracker
from follower_vision.trackers import make_tracker


def make_target_tracker(settings: Settings) -> TargetTracker:
    """Return a fresh target tracker: Fusion with a detector, else a long-term tracker without.

    Raises:
        ModelError: a network is missing or broken; the message says how to get it.
    """
    store = ModelStore(default_folder(os.environ))
    motion = make_tracker(settings.tracker, store.file)
    if settings.detector is None:
        return LongTermTracker(motion, settings.longterm)
    return FusionTracker(motion, make_detector(settings.detector, store), settings.fusion)
