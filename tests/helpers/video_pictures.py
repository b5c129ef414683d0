"""Pictures to send, and what comes out of an encoder."""

from __future__ import annotations

import numpy as np

from follower.settings.ui import VideoSettings
from follower.ui.video.channel import Picture
from follower.ui.video.h264_encoder import (
    AccessUnit,
    H264Encoder,
)

WIDTH, HEIGHT = 160, 120
SETTINGS = VideoSettings(encoder="libx264", keyframe_s=0.5)
PATIENCE_S = 20.0


def image(number: int) -> np.ndarray:
    """A grey picture with a bright square that moves to the right."""
    picture = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    x = 10 + number % 100
    picture[40:80, x : x + 40] = 220
    return picture


def picture(number: int) -> Picture:
    return Picture(image(number), number, number / 30)


def units(count: int) -> list[AccessUnit]:
    encoder = H264Encoder("libx264", SETTINGS, WIDTH, HEIGHT)
    made = [encoder.encode(image(number), number / 30) for number in range(count)]
    return [unit for unit in made if unit is not None]
