"""`follower train siamese`: from a configuration to the two ONNX files."""

from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from follower.training.onnx_export import (
    ExportedNetwork,
    export_network,
    folded,
    round_to_half,
    store_as_half,
    write_card,
)
from follower.training.siamese.examples import Batch
from follower.training.siamese.network import (
    CELLS,
    SEARCH_PX,
    STRIDE_PX,
    TEMPLATE_PX,
    SiameseHead,
    SiameseModule,
)
from follower.training.siamese.settings import SiameseConfig
from follower.training.siamese.trainer import SiameseTrainer
from follower.training.tracker_training import TrackerTraining
from follower_vision.images.frame import Image
from follower_vision.trackers.nanotrack import IN_FIRST_SHAPE

_COLUMNS = 6
_VISIBLE, _ABSENT = (80, 220, 60), (60, 60, 255)


def write_siamese(
    trainer: SiameseTrainer, config: SiameseConfig, folder: Path
) -> list[ExportedNetwork]:
    """Write both networks of a training, NAME_backbone.onnx and NAME_head.onnx, and their cards."""
    backbone, head = export_siamese(trainer.averaged, folder / config.name)
    training = config.training
    rows = [
        ("data", config.data),
        (
            "recipe",
            f"{trainer.step_number} steps of {training.batch} pairs, AdamW, rate "
            f"{training.rate:g}, seed {training.seed}",
        ),
        (
            "mean overlap of the best box, held-out scenes",
            f"{trainer.validate():.3f} ({training.held_out} pairs)",
        ),
    ]
    about = (
        "A motion tracker: a small Siamese network in the form of NanoTrack's (HonglinChu,\n"
        "SiamTrackers): a backbone for both crops, and a head that compares them."
    )
    write_card(backbone, config, trainer.averaged.backbone, about, rows)
    write_card(head, config, trainer.averaged.head, about, rows)
    return [backbone, head]


class _HeadExport(nn.Module):
    """The head with NanoTrack's outputs: two classes, and the sides."""

    def __init__(self, head: SiameseHead) -> None:
        super().__init__()
        self.head = head

    def forward(self, template: Tensor, search: Tensor) -> tuple[Tensor, Tensor]:
        answer = self.head(template, search)
        return torch.cat([torch.zeros_like(answer.scores), answer.scores], dim=1), answer.sides


def export_siamese(network: SiameseModule, stem: Path) -> tuple[ExportedNetwork, ExportedNetwork]:
    """Write STEM_backbone.onnx and STEM_head.onnx, weights as 16-bit numbers, and compare them.

    The comparison is with the network of the same rounded weights.

    Raises:
        ModelError: a file does not answer as the network does.
    """
    compact = folded(network)
    round_to_half(compact)

    def crops(rng: np.random.Generator) -> tuple[Tensor, ...]:
        noise = rng.normal(120, 40, (1, 3, SEARCH_PX, SEARCH_PX)).astype(np.float32)
        return (torch.from_numpy(noise.clip(0, 255)),)

    def features(rng: np.random.Generator) -> tuple[Tensor, ...]:
        search = crops(rng)[0]
        with torch.no_grad():
            return compact.backbone(search[..., :TEMPLATE_PX, :TEMPLATE_PX]), compact.backbone(
                search
            )

    metadata = {"family": "siamese", "licence": "Apache-2.0"}
    backbone = export_network(
        compact.backbone,
        stem.with_name(f"{stem.name}_backbone.onnx"),
        crops,
        (("crop",), ("features",)),
        metadata,
        store_as_half,
    )
    head = export_network(
        _HeadExport(compact.head).eval(),
        stem.with_name(f"{stem.name}_head.onnx"),
        features,
        (("template", "search"), ("classes", "sides")),
        metadata | dict([IN_FIRST_SHAPE]),
        store_as_half,
    )
    return backbone, head


def sample_sheet(batch: Batch) -> Image:
    """Return a batch's templates, and beside each the search crop with the box; red: not there."""
    tiles = [_tile(batch, number) for number in range(len(batch.box))]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % _COLUMNS)
    rows = [np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)]
    return np.asarray(np.vstack(rows))


def _tile(batch: Batch, number: int) -> Image:
    template, search = (
        np.ascontiguousarray(crops[number].numpy().transpose(1, 2, 0))
        for crops in (batch.template, batch.search)
    )
    cx, cy, width, height = (float(value) for value in batch.box[number])
    middle = CELLS * STRIDE_PX / 2
    first = round(middle + cx - width / 2), round(middle + cy - height / 2)
    last = round(middle + cx + width / 2), round(middle + cy + height / 2)
    cv2.rectangle(search, first, last, _VISIBLE if batch.visible[number] else _ABSENT, 1)
    blank = np.zeros((SEARCH_PX - TEMPLATE_PX, TEMPLATE_PX, 3), np.uint8)
    return np.asarray(np.hstack([np.vstack([template, blank]), search]))


SIAMESE = TrackerTraining(
    SiameseConfig,
    SiameseTrainer,
    lambda trainer: sample_sheet(trainer.batch(0)),
    write_siamese,
)
