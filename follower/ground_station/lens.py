"""What the ground station is told of the frames and of the stream that shows them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Lens:
    """The camera as a ground station sees it.

    Attributes:
        fov_deg: horizontal field of view.
        rate_hz: frames a second.
        stream_size: width and height of the video, where they are not those of the frames.
        bitrate_bit_s: of the video; 0 where nobody knows.
    """

    fov_deg: float
    rate_hz: float
    stream_size: tuple[int, int] | None = None
    bitrate_bit_s: int = 0
