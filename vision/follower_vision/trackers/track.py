"""What the vision side says about the target after each frame."""

from dataclasses import dataclass
from enum import StrEnum

from follower_vision.geometry.box import Box


class TrackState(StrEnum):
    """How much a track's box can be trusted.

    Examples:
        >>> import follower
        >>> follower.TrackState.TRACKING == "tracking"
        True
    """

    TRACKING = "tracking"
    """The target was seen in this frame."""
    COASTING = "coasting"
    """The target was not clearly seen; the box is a short extrapolation."""
    LOST = "lost"
    """The position of the target is unknown; the box is the last one seen."""


@dataclass(frozen=True, slots=True)
class Track:
    """The target's box in one frame.

    Attributes:
        box: in pixels of that frame.
        state: how far to trust the box. Control steers by TRACKING boxes alone.
        confidence: 0 (none) to 1 (certain), as the producer judges it.
        produced_by: what made this box, e.g. "peak", "detection", "prediction".
        captured_s: capture time of the frame, on the system's clock.
        sequence: the frame's number.

    Examples:
        >>> import follower
        >>> with follower.Fusion(follower.Box.from_xywh(190, 100, 40, 40)) as tracker:
        ...     track = tracker.step(next(follower.frames("clip.mp4")))
        >>> print(track.box.cx, track.box.cy, track.state, track.sequence)
        210.0 120.0 tracking 0
    """

    box: Box
    state: TrackState
    confidence: float
    produced_by: str
    captured_s: float
    sequence: int
