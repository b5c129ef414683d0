"""A motion tracker without weights: a background-aware correlation filter with a scale filter.

Uses: `geometry`, `images`, NumPy, OpenCV.
Start at: `tracker.CorrelationTracker`.
"""

from follower_vision.trackers.correlation.tracker import CorrelationTracker

__all__ = ["CorrelationTracker"]
