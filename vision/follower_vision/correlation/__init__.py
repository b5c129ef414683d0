"""A motion tracker without weights: a background-aware correlation filter with a scale filter."""

from follower_vision.correlation.settings import CorrelationSettings
from follower_vision.correlation.tracker import CorrelationTracker

__all__ = ["CorrelationSettings", "CorrelationTracker"]
