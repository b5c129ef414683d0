"""What a simulated flight may be given beside a world, a follower and an autopilot."""

from __future__ import annotations

from dataclasses import dataclass

from follower.flight_parts import FlightParts
from follower.flight_video import FlightVideo
from follower.recorder import Recorder
from follower.sight import Sight
from follower.target_finder import TargetFinder


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightExtras:
    """Who watches a simulated flight, and what is unusual about it.

    Attributes:
        video: takes every frame with its track, if given.
        recorder: records the flight, if given.
        parts: what it is made of; others than the sound ones make something go wrong.
        sight: what vision goes by. Without pixels, pictures are drawn for `video` alone.
        finder: finds what operators point at, if given.
    """

    video: FlightVideo | None = None
    recorder: Recorder | None = None
    parts: FlightParts | None = None
    sight: Sight = Sight.PIXELS
    finder: TargetFinder | None = None
