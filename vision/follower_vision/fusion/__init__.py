"""The Fusion tracker: a motion tracker, an object detector and re-identification.

Uses: `appearance`, `detection`, `trackers`.
Start at: `tracker.FusionTracker.step`, then `candidates`, `features`, `model`.
"""

from follower_vision.detection.detection_service import BackgroundDetection, InlineDetection
from follower_vision.fusion.multi import MultiFusion
from follower_vision.fusion.paper import PaperFusion
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.tracker import FusionTracker

__all__ = [
    "BackgroundDetection",
    "FusionSettings",
    "FusionTracker",
    "InlineDetection",
    "MultiFusion",
    "PaperFusion",
]
