"""A small Re3 in torch: trunk, correlation, two LSTM layers, and the box that comes out."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from follower.training.re3.settings import Re3NetworkSettings
from follower_vision.trackers.re3 import CELL_PX, PLACES, SEARCH_PX, TARGET_PX, TEMPLATE_PX

TEMPLATE_CELLS = TEMPLATE_PX // CELL_PX
SEARCH_CELLS = SEARCH_PX // CELL_PX
_PARTS = TEMPLATE_CELLS**2
_DECODE_RADIUS = 1.5


class Re3ModuleState(NamedTuple):
    """What the network remembers.

    Attributes:
        hidden: (2, N, hidden) of both LSTM layers.
        cell: likewise.
    """

    hidden: Tensor
    cell: Tensor


class Re3Answer(NamedTuple):
    """What the network says about N crops.

    Attributes:
        box: (N, 4) centre's shift from the crop's middle in target scales, and logs of the width's
            and height's growth.
        confidence: (N,) logit of the target being visible.
        scores: (N, P) logit of each place being the target's middle.
        shapes: (N, 4, P) box as seen from each place.
        state: to hand in with the next frame.
    """

    box: Tensor
    confidence: Tensor
    scores: Tensor
    shapes: Tensor
    state: Re3ModuleState


class Re3Module(nn.Module):
    """Follows a target from crop to crop.

    After Gordon, Farhadi and Fox, "Re3" (RA-L 2018); docs/how-to/train-re3.md lists the departures.
    """

    parts: Tensor
    sources: Tensor
    places: Tensor

    def __init__(self, settings: Re3NetworkSettings) -> None:
        """Make an untrained network."""
        super().__init__()
        self.settings = settings
        channels, head, hidden = settings.channels, settings.head, settings.hidden
        self.trunk = _trunk(channels)
        self.sharpness = nn.Parameter(torch.tensor(1.5))
        self.surroundings = nn.Conv2d(channels, 32, 1)
        self.compare = nn.Sequential(
            _convolution(2 * _PARTS + 2 + 32, head, 1), _Residual(head), _Residual(head)
        )
        self.score = nn.Conv2d(head, 1, 1)
        self.shape = nn.Conv2d(head, 4, 1)
        self.prior = nn.Linear(hidden, PLACES**2)
        self.summary = _convolution(head + 1, 16, 2)
        self.squeeze = nn.Linear(16 * ((PLACES + 1) // 2) ** 2, hidden)
        # Unscaled, the maps' features shut the second layer's gates for good.
        self.levelled = nn.LayerNorm(hidden + 5 + head)
        self.first = nn.LSTMCell(hidden + 5 + head, hidden)
        self.second = nn.LSTMCell(2 * hidden + 5 + head, hidden)
        self.refine = nn.Linear(hidden, 4)
        self.seen = nn.Sequential(nn.Linear(head + 3, 32), nn.ReLU(), nn.Linear(32, 1))
        self.recalled = nn.Linear(hidden, 1)
        for layer in (self.prior, self.refine, self.recalled):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.register_buffer("parts", _part_centres(), persistent=False)
        self.register_buffer("sources", _aligned_sources(), persistent=False)
        self.register_buffer("places", _place_centres(), persistent=False)

    def start_state(self, count: int) -> Re3ModuleState:
        """Return the state before the first frame of `count` targets."""
        zeros = self.places.new_zeros(2, count, self.settings.hidden)
        return Re3ModuleState(zeros, zeros)

    def recurrence(self) -> tuple[nn.Module, ...]:
        """Return what feeds the LSTM layers, these, and what reads them."""
        readers = self.prior, self.refine, self.recalled
        return self.summary, self.squeeze, self.levelled, self.first, self.second, *readers

    def begin_recurrence(self) -> None:
        """Give the LSTM layers new weights, and their readers none: they have no say at first."""
        for part in (self.levelled, self.first, self.second):
            part.reset_parameters()
        for reader in (self.prior, self.refine, self.recalled):
            nn.init.zeros_(reader.weight)

    def memory(self, template: Tensor) -> Tensor:
        """Return features (N, C, 8, 8) of template crops (N, 3, 64, 64), 0 to 255."""
        return functional.normalize(self.trunk(centred(template)), dim=1)

    def forward(
        self,
        last: Tensor,
        present: Tensor,
        size: Tensor,
        memory: Tensor,
        memory_size: Tensor,
        state: Re3ModuleState,
    ) -> Re3Answer:
        """Find the targets.

        Args:
            last: (N, C, 8, 8) features of the crops about the last box of the frame before.
            present: (N, 3, 128, 128) crops about the same place of the new frame, 0 to 255.
            size: (N, 2) width and height of the last box in target scales.
            memory: (N, C, 8, 8) features of the first frame's template.
            memory_size: (N, 2) width and height of the first frame's box in target scales.
            state: of the LSTM layers.
        """
        features = self.trunk(centred(present))
        unit = functional.normalize(features, dim=1)
        maps, peaks = self._maps(features, unit, last, size, memory, memory_size)
        scores = self.score(maps).flatten(1) + self.prior(state.hidden[1])
        shapes = self.shape(maps).flatten(2)
        near = self._near_best(scores)
        found = self._decode(near, shapes)
        look = (maps.flatten(2) * near[:, None]).sum(dim=2)
        clues = torch.cat([peaks, scores.amax(dim=1, keepdim=True) / 4], dim=1)
        state = self._remember(maps, scores, found, look, clues, state)
        box = found + self.refine(state.hidden[1])
        seen = self.seen(torch.cat([look, clues], dim=1)) + self.recalled(state.hidden[1])
        return Re3Answer(box, seen[:, 0], scores, shapes, state)

    def _maps(
        self,
        features: Tensor,
        unit: Tensor,
        last: Tensor,
        size: Tensor,
        memory: Tensor,
        memory_size: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return maps (N, head, P, P) of the places, and the best likenesses (N, 2)."""
        likes = [
            self._likeness(last, size, unit),
            self._likeness(memory, memory_size, unit),
        ]
        means = [like.sum(dim=1, keepdim=True) for like in likes]
        around = functional.avg_pool2d(self.surroundings(features), 2, 1, padding=1)
        factor = self.sharpness.exp()
        scaled = [like * _PARTS / 8 * factor for like in likes]
        stacked = torch.cat([*scaled, *(mean * factor for mean in means), around], dim=1)
        peaks = torch.cat([mean.flatten(2).amax(dim=2) for mean in means], dim=1)
        return self.compare(stacked), peaks

    def _likeness(self, template: Tensor, size: Tensor, unit: Tensor) -> Tensor:
        """Return (N, 64, P, P): how well each part of the template fits, target's middle there.

        The parts are weighted by the share of the box that they hold, so that the sum over the
        parts is a mean cosine.
        """
        weights = self._weights(size)
        count = template.shape[0]
        cosine = torch.bmm(template.flatten(2).transpose(1, 2), unit.flatten(2))
        grid = cosine.reshape(count, _PARTS, SEARCH_CELLS, SEARCH_CELLS)
        margin = TEMPLATE_CELLS // 2
        padded = functional.pad(grid, (margin, margin, margin, margin)).flatten(2)
        aligned = torch.gather(padded, 2, self.sources.expand(count, -1, -1))
        likeness = aligned * weights[:, :, None]
        return likeness.reshape(count, _PARTS, PLACES, PLACES)

    def _weights(self, size: Tensor) -> Tensor:
        """Return (N, 64) shares of the box in each part of the template; they add up to one."""
        half = size[:, None, :] * (TARGET_PX / 2 / CELL_PX)
        inside = (half - self.parts.abs() + 0.5).clamp(0.0, 1.0).prod(dim=2)
        return inside / inside.sum(dim=1, keepdim=True).clamp_min(1e-3)

    def _near_best(self, scores: Tensor) -> Tensor:
        """Return (N, P) weights: the scores' softmax about the best place."""
        best = self.places[scores.argmax(dim=1)]
        away = (self.places[None] - best[:, None]).abs().amax(dim=2)
        reach = _DECODE_RADIUS * CELL_PX / TARGET_PX
        outside = (away > reach).to(scores.dtype)
        return torch.softmax(scores - 1e4 * outside, dim=1)

    def _decode(self, near: Tensor, shapes: Tensor) -> Tensor:
        """Return the box (N, 4) as the places about the best one see it."""
        offsets = (shapes * near[:, None]).sum(dim=2)
        middle = (self.places[None] * near[:, :, None]).sum(dim=1)
        return torch.cat([middle + offsets[:, :2], offsets[:, 2:]], dim=1)

    def _remember(
        self,
        maps: Tensor,
        scores: Tensor,
        found: Tensor,
        look: Tensor,
        clues: Tensor,
        state: Re3ModuleState,
    ) -> Re3ModuleState:
        """Step both LSTM layers; the second sees the input too, as in the paper."""
        heat = torch.softmax(scores, dim=1).reshape(-1, 1, PLACES, PLACES)
        scene = self.summary(torch.cat([maps, heat * 10], dim=1)).flatten(1)
        scene = functional.relu(self.squeeze(scene))
        given = self.levelled(torch.cat([scene, found, look, clues[:, 2:]], dim=1))
        first, first_cell = self.first(given, (state.hidden[0], state.cell[0]))
        both = torch.cat([given, first], dim=1)
        second, second_cell = self.second(both, (state.hidden[1], state.cell[1]))
        return Re3ModuleState(torch.stack([first, second]), torch.stack([first_cell, second_cell]))


class _Residual(nn.Module):
    """Depthwise 5x5 and pointwise convolutions beside a short cut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.wide = nn.Conv2d(channels, channels, 5, padding=2, groups=channels, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.mix = _convolution(channels, channels, 1)

    def forward(self, maps: Tensor) -> Tensor:
        mixed: Tensor = self.mix(self.norm(self.wide(maps)))
        return maps + mixed


def _convolution(into: int, out: int, kernel_or_stride: int) -> nn.Sequential:
    """Return 1x1 for 1, or 3x3 with stride 2 for 2, normalised and rectified."""
    if kernel_or_stride == 1:
        layer = nn.Conv2d(into, out, 1, bias=False)
    else:
        layer = nn.Conv2d(into, out, 3, stride=2, padding=1, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(out), nn.ReLU())


def _trunk(channels: int) -> nn.Sequential:
    """Return the convolutions of both crops: a cell each 8 pixels."""
    return nn.Sequential(
        _convolution(3, 16, 2),
        _convolution(16, 32, 2),
        _convolution(32, channels, 2),
        _Residual(channels),
        _Residual(channels),
        nn.Conv2d(channels, channels, 1),
    )


def centred(crop: Tensor) -> Tensor:
    """Return a crop's values, 0 to 255, about zero."""
    return (crop - 120.0) / 64.0


def _part_centres() -> Tensor:
    """Return (64, 2) x, y of the template's cells from its middle, in cells."""
    along = torch.arange(TEMPLATE_CELLS) - (TEMPLATE_CELLS - 1) / 2
    down, across = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([across.flatten(), down.flatten()], dim=1)


def _place_centres() -> Tensor:
    """Return (P, 2) x, y of the places from the crop's middle, in target scales."""
    along = (torch.arange(PLACES) - (PLACES - 1) / 2) * CELL_PX / TARGET_PX
    down, across = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([across.flatten(), down.flatten()], dim=1)


def _aligned_sources() -> Tensor:
    """Return (64, P) which cell of the padded search lies under a part, target at a place.

    Places are corners between cells: with the middle at corner k, part j covers cell k + j - 4,
    which is k + j once four cells of margin are added.
    """
    padded = SEARCH_CELLS + TEMPLATE_CELLS
    part, place = torch.arange(TEMPLATE_CELLS), torch.arange(PLACES)
    along = part[:, None] + place[None, :]
    rows = along[:, None, :, None] * padded
    return (rows + along[None, :, None, :]).reshape(_PARTS, PLACES**2)
