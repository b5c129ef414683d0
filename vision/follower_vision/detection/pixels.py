"""How an image becomes a network's input: its place in the tensor and the scaling of its values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.network import Tensor


class Placement(StrEnum):
    """How a region of another shape is fitted into the network's input."""

    STRETCH = "stretch"
    """Both sides are scaled on their own."""
    CENTRE = "centre"
    """The shape is kept; what is missing is added on both sides."""
    CORNER = "corner"
    """The shape is kept; what is missing is added to the right or below."""


@dataclass(frozen=True, slots=True)
class InputFormat:
    """What a network wants to be shown.

    Attributes:
        placement: how a region of another shape is fitted in.
        fill: the grey value of what lies outside the image.
        red_first: channels are red, green, blue; otherwise blue, green, red.
        mean: of each channel, in the network's order, taken off.
        deviation: by which each channel is divided after that.
    """

    placement: Placement
    fill: float = 114.0
    red_first: bool = False
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    deviation: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def view(self, region: Box, width: int, height: int) -> Box:
        """Return the part of the image that fills an input of `width` x `height` pixels."""
        if self.placement is Placement.STRETCH:
            return region
        zoom = min(width / region.width, height / region.height)
        if self.placement is Placement.CENTRE:
            return Box(region.cx, region.cy, width / zoom, height / zoom)
        return Box.from_xywh(region.left, region.top, width / zoom, height / zoom)

    def write(self, cut: Image, tensor: Tensor) -> None:
        """Write an image of the input's size, (H, W, 3) BGR, into a tensor, (1, 3, H, W)."""
        ordered = cut[..., ::-1] if self.red_first else cut
        np.copyto(tensor[0], ordered.transpose(2, 0, 1))
        if any(self.mean):
            tensor -= np.array(self.mean, np.float32)[:, None, None]
        if any(deviation != 1 for deviation in self.deviation):
            tensor *= (1.0 / np.array(self.deviation, np.float32))[:, None, None]
