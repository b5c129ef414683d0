"""Fusion: a motion tracker, an object detector and re-identification, joined."""

from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.tracker import FusionTracker

__all__ = ["FusionSettings", "FusionTracker"]
