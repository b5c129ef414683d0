"""How hard the generated scenes are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class SceneSettings:
    """Sizes, motions and how often each difficulty occurs.

    Shares are of the scenes, 0 to 1; motions are standard deviations a frame.

    Attributes:
        width: of the frame in pixels.
        height: of the frame in pixels.
        least_scale: smallest target, the square root of its box's area in pixels.
        most_scale: the largest.
        motion: largest step of the target a frame, in its own scale.
        scale_change: largest step of log scale a frame.
        aspect_change: largest step of log aspect a frame.
        rotation: largest step of the target's rotation, radians a frame.
        perspective: share of scenes with a tilting target.
        deformation: share of scenes in which the target bends.
        occlusion: share with something passing before the target.
        look_alikes: share with copies of the target, or like things, beside it.
        leaving: share in which the target may leave the frame and return.
        blur: share with motion blur.
        low_light: share with strong changes of light.
        soft: share that is not quite in focus.
        grey: share in black and white.
        compression: share with the traces of a film's compression.
        pieces: share in which the target is a piece of the ground itself, without an edge.
        loose: share in which the box does not fit the mask, as one that a user has drawn.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    width: int = 640
    height: int = 480
    least_scale: float = 14.0
    most_scale: float = 150.0
    motion: float = 0.3
    scale_change: float = 0.03
    aspect_change: float = 0.02
    rotation: float = 0.04
    perspective: float = 0.3
    deformation: float = 0.3
    occlusion: float = 0.4
    look_alikes: float = 0.6
    leaving: float = 0.15
    blur: float = 0.35
    low_light: float = 0.5
    soft: float = 0.5
    grey: float = 0.15
    compression: float = 0.5
    pieces: float = 0.25
    loose: float = 0.7

    def __post_init__(self) -> None:
        if self.width < 64 or self.height < 64:
            raise ValueError("a scene needs a frame of at least 64 x 64 pixels")
        if not 4.0 <= self.least_scale <= self.most_scale:
            raise ValueError("least_scale must be 4 or more, and most_scale no smaller")
        for name in ("perspective", "deformation", "occlusion", "look_alikes", "leaving", "blur"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} is a share: it must be from 0 to 1")
