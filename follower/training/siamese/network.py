"""A small Siamese network in torch: a backbone for both crops, and a head that compares them."""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from follower.training.siamese.settings import SiameseNetworkSettings

SEARCH_PX, TEMPLATE_PX, STRIDE_PX = 160, 80, 8
"""Sides of the crops, twice a target's size with its margin and four times; pixels a cell."""

CELLS = SEARCH_PX // STRIDE_PX
_TEMPLATE_CELLS = TEMPLATE_PX // STRIDE_PX
_PARTS = 8
"""So many cells of the template's middle are compared, across and down."""
_AROUND = 32
_LARGEST_PX = math.exp(5.2)


class SiameseAnswer(NamedTuple):
    """What the network says of each place in N search crops.

    Attributes:
        scores: (N, 1, 20, 20) logit of the overlap to be expected of the box there, as NanoTrack's
            head orders places: place i lies 8 (i - 10) pixels from the crop's middle.
        sides: (N, 4, 20, 20) pixels from the place to the box's left, top, right and bottom side;
            as the network gives them, over the shape of the template's box (see `in_shape`).
    """

    scores: Tensor
    sides: Tensor


class SiameseBackbone(nn.Module):
    """Convolutions of both crops, (N, 3, S, S) of 0 to 255, to features (N, C, S / 8, S / 8)."""

    def __init__(self, channels: int) -> None:
        """Make an untrained network."""
        super().__init__()
        self.layers = nn.Sequential(
            convolved(3, 24, 3, 2),
            convolved(24, 40, 3, 2),
            convolved(40, channels, 3, 2),
            _Residual(channels),
            _Residual(channels),
            nn.Conv2d(channels, channels, 1),
        )

    def forward(self, crops: Tensor) -> Tensor:
        """Return the crops' features."""
        features: Tensor = self.layers((crops - 120.0) / 64.0)
        return features


class SiameseHead(nn.Module):
    """Compares a template's features with a search crop's.

    Each of 8 x 8 parts of the template is compared with what lies under it when the target's middle
    is at a place (pixel-wise correlation as in Yan et al., "LightTrack", CVPR 2021, with the parts
    aligned); beside that each channel is correlated (Li et al., "SiamRPN++", CVPR 2019).
    """

    sources: Tensor

    def __init__(self, settings: SiameseNetworkSettings) -> None:
        """Make an untrained network."""
        super().__init__()
        channels, head = settings.channels, settings.head
        self.sharpness = nn.Parameter(torch.tensor(1.5))
        self.of_template = convolved(channels, channels, 1)
        self.of_search = convolved(channels, channels, 1)
        self.levelled = nn.BatchNorm2d(channels)
        self.around = nn.Conv2d(channels, _AROUND, 1)
        self.mix = convolved(_PARTS**2 + 1 + channels + _AROUND, head, 1)
        self.tower = nn.Sequential(_Wide(head), _Wide(head))
        self.score_tower, self.side_tower = _Wide(head), _Wide(head)
        self.score, self.side = nn.Conv2d(head, 1, 1), nn.Conv2d(head, 4, 1)
        nn.init.constant_(self.score.bias, -3.0)  # type: ignore[arg-type]
        nn.init.constant_(self.side.bias, math.log(20.0))  # type: ignore[arg-type]
        self.register_buffer("sources", _aligned_sources(), persistent=False)

    def forward(self, template: Tensor, search: Tensor) -> SiameseAnswer:
        """Compare features of N templates, (N, C, 10, 10), with N search crops', (N, C, 20, 20)."""
        margin = (_TEMPLATE_CELLS - _PARTS) // 2
        middle = template[:, :, margin : margin + _PARTS, margin : margin + _PARTS]
        likeness = self._likeness(middle, search)
        factor = self.sharpness.exp()
        # A place is the corner between four cells, as the template's middle is.
        around = functional.avg_pool2d(
            functional.pad(self.around(search), (1, 0, 1, 0)), kernel_size=2, stride=1
        )
        maps = torch.cat(
            [
                likeness * factor,
                likeness.mean(dim=1, keepdim=True) * factor * 4,
                self.levelled(self._correlated(middle, search)),
                around,
            ],
            dim=1,
        )
        maps = self.tower(self.mix(maps))
        sides = torch.exp(self.side(self.side_tower(maps)).clamp(max=math.log(_LARGEST_PX)))
        return SiameseAnswer(self.score(self.score_tower(maps)), sides)

    def _likeness(self, middle: Tensor, search: Tensor) -> Tensor:
        """Return (N, 64, 20, 20): the cosine of each part and what lies under it at each place."""
        count, half = len(search), _PARTS // 2
        parts = functional.normalize(middle, dim=1).flatten(2).transpose(1, 2)
        cells = functional.normalize(search, dim=1).flatten(2)
        cosine = torch.bmm(parts, cells).reshape(count, _PARTS**2, CELLS, CELLS)
        padded = functional.pad(cosine, (half, half, half, half)).flatten(2)
        aligned = torch.gather(padded, 2, self.sources.expand(count, -1, -1))
        return aligned.reshape(count, _PARTS**2, CELLS, CELLS)

    def _correlated(self, middle: Tensor, search: Tensor) -> Tensor:
        """Return (N, C, 20, 20): each channel's correlation with the template's."""
        kernel, half = self.of_template(middle), _PARTS // 2
        maps = functional.pad(self.of_search(search), (half, half - 1, half, half - 1))
        count, channels = kernel.shape[:2]
        flat = functional.conv2d(
            maps.reshape(1, count * channels, *maps.shape[2:]),
            kernel.reshape(count * channels, 1, _PARTS, _PARTS),
            groups=count * channels,
        )
        return flat.reshape(count, channels, CELLS, CELLS) / _PARTS**2


class SiameseModule(nn.Module):
    """Backbone and head."""

    def __init__(self, settings: SiameseNetworkSettings) -> None:
        """Make an untrained network."""
        super().__init__()
        self.backbone, self.head = SiameseBackbone(settings.channels), SiameseHead(settings)

    def forward(self, template: Tensor, search: Tensor) -> SiameseAnswer:
        """Find the targets of templates (N, 3, 80, 80) in crops (N, 3, 160, 160), 0 to 255."""
        answer: SiameseAnswer = self.head(self.backbone(template), self.backbone(search))
        return answer


class _Residual(nn.Module):
    """Two 3x3 convolutions beside a short cut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = convolved(channels, channels, 3)
        self.second = convolved(channels, channels, 3, rectified=False)

    def forward(self, maps: Tensor) -> Tensor:
        return functional.relu(maps + self.second(self.first(maps)))


class _Wide(nn.Module):
    """Depthwise 5x5 and pointwise convolutions beside a short cut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.depthwise = convolved(channels, channels, 5, groups=channels, rectified=False)
        self.pointwise = convolved(channels, channels, 1)

    def forward(self, maps: Tensor) -> Tensor:
        mixed: Tensor = self.pointwise(self.depthwise(maps))
        return maps + mixed


def convolved(
    into: int, out: int, side: int, stride: int = 1, groups: int = 1, rectified: bool = True
) -> nn.Sequential:
    """Return a convolution, its normalisation, and a rectifier if that is wanted."""
    layer = nn.Conv2d(into, out, side, stride, side // 2, groups=groups, bias=False)
    last = [nn.ReLU()] if rectified else []
    return nn.Sequential(layer, nn.BatchNorm2d(out), *last)


def places() -> Tensor:
    """Return (400, 2) x, y of the places from the search crop's middle, in pixels, by rows."""
    along = (torch.arange(CELLS) - CELLS // 2) * float(STRIDE_PX)
    down, across = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([across.flatten(), down.flatten()], dim=1)


def _aligned_sources() -> Tensor:
    """Return (64, 400): which cell of the padded search lies under a part, target at a place."""
    padded = CELLS + _PARTS
    along = torch.arange(_PARTS)[:, None] + torch.arange(CELLS)[None, :]
    rows = along[:, None, :, None] * padded
    return (rows + along[None, :, None, :]).reshape(_PARTS**2, CELLS**2)
