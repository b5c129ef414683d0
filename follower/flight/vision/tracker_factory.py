"""Makes the trackers that the settings name."""

from contextlib import suppress
from functools import partial
from pathlib import Path

from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detector, make_detector
from follower_vision.detection.detection_service import DetectionMode
from follower_vision.detection.detectors import network_file
from follower_vision.fusion import (
    FusionSettings,
    FusionTracker,
    InlineDetection,
    MultiFusion,
    PaperFusion,
)
from follower_vision.models import ModelStore, default_folder
from follower_vision.onnx_network import ModelError
from follower_vision.trackers import registry
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.opencv import OPENCV_KINDS
from follower_vision.trackers.target_tracker import (
    MultiTargetTracker,
    SeparateTrackers,
    TargetTracker,
)


def make_target_tracker(settings: Settings, mode: DetectionMode = InlineDetection) -> TargetTracker:
    """Return a fresh target tracker: Fusion with the motion tracker and detector of the settings.

    Args:
        settings: all of them.
        mode: how Fusion runs its detector; in the background, whoever asked closes the tracker.

    Raises:
        ModelError: a network is missing or broken; the message says how to get it.
        SettingsError: the paper's algorithm is asked for without a detector.
    """
    return make_tracker_with(make_settings_detector(settings), settings, mode)


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
    fusion = settings.fusion
    if count > 1 and detector is not None and fusion.algorithm == "fitted":
        return MultiFusion(partial(_motion_tracker, settings), detector, fusion, mode)
    trackers = [make_tracker_with(detector, settings, mode) for _ in range(count)]
    return SeparateTrackers(trackers, partial(_close_all, trackers))


def make_fusion(
    motion: MotionTracker,
    detector: Detector | None,
    settings: FusionSettings,
    mode: DetectionMode = InlineDetection,
) -> FusionTracker | PaperFusion:
    """Return the algorithm that the settings name; the paper's always waits for its detector.

    Raises:
        SettingsError: the paper's has none.
    """
    if settings.algorithm == "fitted":
        return FusionTracker(motion, detector, settings, mode)
    if detector is None:
        raise SettingsError(
            "fusion.algorithm: the paper's needs a detector; name one in `detector`"
        )
    return PaperFusion(motion, detector)


def make_settings_detector(settings: Settings) -> Detector | None:
    """Return the detector that the settings name, None if they name none.

    Raises:
        ModelError: its network is missing or broken; the message says how to get it.
    """
    if settings.detector is None:
        return None
    return make_detector(settings.detector, _store(settings), device=settings.vision.device)


def network_files(settings: Settings) -> list[Path]:
    """Return the networks that the settings' tracker and detector load, but what is missing."""
    files: list[Path] = []
    with suppress(ModelError):
        files += registry.network_files(settings.tracker, _tracker_store(settings).file)
    with suppress(ModelError):
        found = settings.detector and network_file(settings.detector, _store(settings))
        files += [found] if found else []
    return files


def close_tracker(tracker: TargetTracker) -> None:
    """Release the threads of a tracker that has any."""
    if isinstance(tracker, FusionTracker):
        tracker.close()


def make_tracker_with(
    detector: Detector | None, settings: Settings, mode: DetectionMode
) -> TargetTracker:
    """Return what `make_target_tracker` does, with this detector instead of the settings' own."""
    return make_fusion(_motion_tracker(settings), detector, settings.fusion, mode)


def _close_all(trackers: list[TargetTracker]) -> None:
    for tracker in trackers:
        close_tracker(tracker)


def _motion_tracker(settings: Settings) -> MotionTracker:
    find_file = _tracker_store(settings).file
    return registry.make_tracker(settings.tracker, find_file, settings.vision.device)


def _tracker_store(settings: Settings) -> ModelStore:
    # OpenCV reads its trackers' files itself, and no reduced ones.
    return _store(settings) if settings.tracker not in OPENCV_KINDS else ModelStore(_folder())


def _store(settings: Settings) -> ModelStore:
    return ModelStore(_folder(), reduced=settings.vision.precision == "auto")


def _folder() -> Path:
    return default_folder()
