"""A trained detector as an ONNX file, with a card that says what it is."""

from __future__ import annotations

import hashlib
import json
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from follower.training.detector.average_precision import Precision
from follower.training.detector.config import DetectorConfig
from follower.training.detector.trainer import DetectorTrainer
from follower_vision.network import ModelError, Network

OPSET = 17
AGREEMENT = 1e-4
"""Largest difference between torch's answer and onnxruntime's."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What an export has written.

    Attributes:
        path: of the network.
        card: of its description.
        sha256: of the network.
        difference: largest between torch's answers and onnxruntime's.
    """

    path: Path
    card: Path
    sha256: str
    difference: float


def export_detector(
    trainer: DetectorTrainer, config: DetectorConfig, measured: Precision, folder: Path
) -> Exported:
    """Write NAME.onnx and NAME.md.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    path = folder / f"{config.name}.onnx"
    network = trainer.averaged.cpu().eval()
    side = trainer.settings.side_px
    write_onnx(network, side, trainer.class_names, trainer.anchors, path)
    difference = largest_difference(network, path, side)
    if not difference <= AGREEMENT:
        raise ModelError(f"{path}: it differs from the trained network by {difference:.1e}")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    card = folder / f"{config.name}.md"
    card.write_text(_card(trainer, config, measured, path, sha256, difference), encoding="utf-8")
    return Exported(path, card, sha256, difference)


def write_onnx(
    network: nn.Module, side: int, names: tuple[str, ...], anchors: np.ndarray, path: Path
) -> None:
    """Write a network with what a reader has to know in its metadata."""
    blank = torch.zeros(1, 3, side, side)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        # The exporter by tracing folds batch normalisation in; torch calls it outdated.
        warnings.simplefilter("ignore")
        traced = Path(folder) / "network.onnx"
        torch.onnx.export(
            network,
            (blank,),
            str(traced),
            dynamo=False,
            opset_version=OPSET,
            input_names=["pictures"],
            output_names=["region"],
        )
        model = onnx.load(traced)
    pairs = [[round(float(side), 5) for side in pair] for pair in anchors]
    metadata = {"names": str(list(names)), "anchors": json.dumps(pairs), "family": "yolov2"}
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def largest_difference(network: nn.Module, path: Path, side: int) -> float:
    """Return by how much onnxruntime's answers differ from torch's on pictures of noise."""
    rng = np.random.default_rng(0)
    session, worst = Network(path), 0.0
    for _ in range(4):
        pictures = rng.random((1, 3, side, side), np.float32)
        with torch.no_grad():
            expected = network(torch.from_numpy(pictures)).numpy()
        worst = max(worst, float(np.abs(session.run(pictures)[0] - expected).max()))
    return worst


def _card(
    trainer: DetectorTrainer,
    config: DetectorConfig,
    measured: Precision,
    path: Path,
    sha256: str,
    difference: float,
) -> str:
    count = sum(value.numel() for value in trainer.averaged.parameters())
    data = (
        "scenes of the simulator's own renderer (no photographs)"
        if config.data is None
        else f"the user's pictures in `{config.data.name}`"
    )
    settings = trainer.settings
    mean = "not measured" if measured.mean is None else f"{measured.mean:.3f}"
    return "\n".join(
        [
            f"# {config.name}",
            "",
            f"A detector of the YOLO v2 family: {', '.join(trainer.class_names)}.",
            "",
            "| | |",
            "|---|---|",
            f"| file | `{path.name}`, {path.stat().st_size} bytes |",
            f"| sha256 | `{sha256}` |",
            f"| licence | {config.licence} |",
            f"| input | 1 x 3 x {settings.side_px} x {settings.side_px}, RGB, 0 to 1 |",
            f"| parameters | {count} |",
            f"| data | {data} |",
            f"| recipe | {trainer.step_number} steps of {settings.batch} pictures, "
            f"AdamW {settings.learning_rate:g}, seed {config.seed} |",
            f"| mAP@0.5, held out | {mean} (at most {settings.held_out_pictures} pictures) |",
            f"| torch and ONNX differ by | {difference:.1e} |",
            "",
            "| class | objects | average precision |",
            "|---|---|---|",
            *_class_rows(trainer.class_names, measured),
            "",
        ]
    )


def _class_rows(names: tuple[str, ...], measured: Precision) -> list[str]:
    return [
        f"| {name} | {count} | {'none to be found' if value is None else f'{value:.3f}'} |"
        for name, value, count in zip(names, measured.of_class, measured.objects, strict=True)
    ]
