"""A small detector of the YOLO v2 family."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import pixel_unshuffle

_EMPTY_BIAS = -4.0
"""At first nearly every place is taken as empty, which most places are."""


class RegionNetwork(nn.Module):
    """Predicts boxes on a grid of cells of 32 pixels, from a picture (B, 3, H, W) RGB, 0 to 1.

    After Redmon and Farhadi, "YOLO9000: Better, Faster, Stronger" (CVPR 2017): the region layer,
    anchors, batch normalisation, leaky rectifiers, and the pass-through that folds the finer grid's
    features into the coarser one. Its trunk is narrower than Darknet-19 and has residual blocks
    (those of YOLO v3) and strides in the place of pooling.

    The output is (B, anchors * (5 + classes), rows, columns), as darknet's region layer gets it.
    """

    def __init__(self, classes: int, anchors: int, channels: Sequence[int]) -> None:
        super().__init__()
        first, second, third, fine, deep = channels
        self.fine = nn.Sequential(
            _layer(3, first, 3, 2),
            _layer(first, second, 3, 2),
            _layer(second, third, 3, 2),
            _Residual(third),
            _layer(third, fine, 3, 2),
            _Residual(fine),
            _Residual(fine),
        )
        self.deep = nn.Sequential(_layer(fine, deep, 3, 2), _Residual(deep), _Residual(deep))
        self.passed = _layer(fine, fine // 4, 1)
        self.joined = nn.Sequential(
            _layer(deep + fine, deep, 1), _layer(deep, deep // 2, 1), _layer(deep // 2, deep, 3)
        )
        self.region = nn.Conv2d(deep, anchors * (5 + classes), 1)
        _start_empty(self.region, anchors)

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the region layer's input."""
        fine = self.fine(pictures)
        passed = pixel_unshuffle(self.passed(fine), 2)
        answer: Tensor = self.region(self.joined(torch.cat([self.deep(fine), passed], 1)))
        return answer


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        half = channels // 2
        self.change = nn.Sequential(_layer(channels, half, 1), _layer(half, channels, 3))

    def forward(self, values: Tensor) -> Tensor:
        changed: Tensor = values + self.change(values)
        return changed


def _layer(channels_in: int, channels_out: int, side: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, side, stride, side // 2, bias=False),
        nn.BatchNorm2d(channels_out),
        nn.LeakyReLU(0.1, inplace=True),
    )


def _start_empty(region: nn.Conv2d, anchors: int) -> None:
    if region.bias is None:
        return
    nn.init.zeros_(region.bias)
    with torch.no_grad():
        region.bias.view(anchors, -1)[:, 4] = _EMPTY_BIAS
