"""Replays recorded flights through the code that flies, and shows what is different."""

from follower.replay.comparison import Comparison, Difference, compare
from follower.replay.replay import Replay, replay_settings

__all__ = ["Comparison", "Difference", "Replay", "compare", "replay_settings"]
