"""Makes the trackers that the settings name."""

from __future__ import annotations

from pathlib import Path

from follower.settings import Settings
from follower_vision.longterm import LongTermTracker
from follower_vision.target_tracker import TargetTracker
from follower_vision.trackers import make_tracker


def make_target_tracker(settings: Settings) -> TargetTracker:
    """Return a fresh target tracker around the motion tracker named by the settings."""
    return LongTermTracker(make_tracker(settings.tracker, _no_file), settings.longterm)


def _no_file(name: str) -> Path:
    raise FileNotFoundError(f"{name} is no file of a tracker without networks")
