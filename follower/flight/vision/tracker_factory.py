"""Makes the trackers that the settings name."""

from __future__ import annotations

import os

from follower.settings import Settings
from follower_vision.detection import Detector, make_detector
from follower_vision.embedding import Embedder, make_embedder
from follower_vision.fusion import FusionTracker, InlineDetection, MultiFusion
from follower_vision.fusion.detection_service import DetectionMode
from follower_vision.longterm import LongTermTracker
from follower_vision.models import ModelStore, default_folder
from follower_vision.motion import MotionTracker
from follower_vision.multi_target import MultiTargetTracker, SeparateTrackers
from follower_vision.target_tracker import TargetTracker
from follower_vision.trackers import make_tracker


def make_target_tracker(settings: Settings, mode: DetectionMode = InlineDetection) -> TargetTracker:
    """Return a fresh target tracker: Fusion with a detector, else a long-term tracker without.

    Args:
        settings: all of them.
        mode: how Fusion runs its detector; in the background, whoever asked closes the tracker.

    Raises:
        ModelError: a network is missing or broken; the message says how to get it.
    """
    detector = make_settings_detector(settings)
    if detector is None:
        return LongTermTracker(_motion_tracker(settings), settings.longterm)
    embedder = _embedder(settings)
    motion = _motion_tracker(settings)
    return FusionTracker(motion, detector, settings.fusion, mode, embedder=embedder)


def make_multi_tracker(
    settings: Settings,
    count: int,
    detector: Detector | None,
    mode: DetectionMode = InlineDetection,
) -> MultiTargetTracker:
    """Return a fresh tracker of `count` targets, which share the detector if there is one.

    One target is followed by just what `make_target_tracker` makes.

    Raises:
        ModelError: a network is missing or broken; the message says how to get it.
    """
    if detector is None:
        longterm = [
            LongTermTracker(_motion_tracker(settings), settings.longterm) for _ in range(count)
        ]
        return SeparateTrackers(longterm)
    fusion, embedder = settings.fusion, _embedder(settings)
    if count > 1:
        return MultiFusion(lambda: _motion_tracker(settings), detector, fusion, mode, embedder)
    motion = _motion_tracker(settings)
    tracker = FusionTracker(motion, detector, fusion, mode, embedder=embedder)
    return SeparateTrackers([tracker], tracker.close)


def make_settings_detector(settings: Settings) -> Detector | None:
    """Return the detector that the settings name, None if they name none.

    Raises:
        ModelError: its network is missing or broken; the message says how to get it.
    """
    return None if settings.detector is None else make_detector(settings.detector, _store())


def _embedder(settings: Settings) -> Embedder | None:
    return None if settings.appearance is None else make_embedder(settings.appearance, _store())


def _motion_tracker(settings: Settings) -> MotionTracker:
    return make_tracker(settings.tracker, _store().file)


def _store() -> ModelStore:
    return ModelStore(default_folder(os.environ))
