"""A frame on its way out, with what may be drawn into it."""

from __future__ import annotations

from dataclasses import dataclass

from follower_vision.frame import Image
from follower_vision.track import Track


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What vision answered for.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        sequence: the frame's number.
        captured_s: when, on the flight's clock.
        tracks: where the targets are, none while there is none.
        lines: text for the corner.
    """

    image: Image
    sequence: int
    captured_s: float
    tracks: tuple[Track, ...] = ()
    lines: tuple[str, ...] = ()
