"""A trained detector as ONNX files, in 32 and in 8 bits, with a card that says what it is."""

import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from follower.training.detector.average_precision import Precision, mean_average_precision
from follower.training.detector.labelled_image import LabelledImage
from follower.training.detector.settings import DetectorConfig
from follower.training.detector.trainer import DetectorTrainer, as_tensor
from follower.training.onnx_export import ExportedNetwork, export_network, write_card
from follower_vision.onnx_network import Network, Tensor

_MOST_LOSS = 0.005
_TIMED = 15
_CPU = torch.device("cpu")


def export_detector(trainer: DetectorTrainer, path: Path) -> ExportedNetwork:
    """Write the averaged network, with class names and anchors in its metadata.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    pairs = [[round(float(length), 5) for length in pair] for pair in trainer.anchors]
    metadata = {
        "names": str(list(trainer.class_names)),
        "anchors": json.dumps(pairs),
        "family": "yolov2",
    }

    def noise(rng: np.random.Generator) -> tuple[torch.Tensor]:
        side = trainer.settings.side_px
        return (torch.from_numpy(rng.random((1, 3, side, side), np.float32)),)

    network = trainer.averaged.cpu().eval()
    return export_network(network, path, noise, (("pictures",), ("region",)), metadata)


def write_detector_card(
    exported: ExportedNetwork, trainer: DetectorTrainer, config: DetectorConfig, measured: Precision
) -> None:
    """Write NAME.md.

    Args:
        exported: the file.
        trainer: has trained it.
        config: of the training.
        measured: quality on held-out pictures.
    """
    settings, side = trainer.settings, trainer.settings.side_px
    rendered = "scenes of the simulator's own renderer (no photographs)"
    rows = [
        ("input", f"1 x 3 x {side} x {side}, RGB, 0 to 1"),
        ("data", rendered if config.data is None else f"the user's pictures in `{config.data}`"),
        (
            "recipe",
            f"{trainer.step_number} steps of {settings.batch} pictures, "
            f"AdamW {settings.learning_rate:g}, seed {config.seed}",
        ),
        ("mAP@0.5, held out", f"{_rounded(measured.mean)} ({len(trainer.held_out)} pictures)"),
    ]
    classes = ["| class | objects | average precision |", "|---|---|---|"]
    for name, value, count in zip(
        trainer.class_names, measured.of_class, measured.objects, strict=True
    ):
        classes.append(f"| {name} | {count} | {_rounded(value)} |")
    about = f"A detector of the YOLO v2 family: {', '.join(trainer.class_names)}."
    write_card(exported, config, trainer.averaged, about, rows, [*classes, ""])


def _rounded(precision: float | None) -> str:
    return "not measured" if precision is None else f"{precision:.3f}"


@dataclass(frozen=True, slots=True)
class MeasuredDetector:
    """What a detector's file is worth.

    Attributes:
        precision: mean average precision at an overlap of 0.5; None without anything to find.
        work_ms: processor time of one detection, median.
    """

    precision: float | None
    work_ms: float

    def __str__(self) -> str:
        return f"mAP@0.5 {_rounded(self.precision)}, {self.work_ms:.2f} ms"


class _Ranges(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime has no types
    """Shows pictures to find out between which numbers each layer's answers lie."""

    def __init__(self, name: str, pictures: Sequence[LabelledImage]) -> None:
        self._feeds: Iterator[dict[str, Tensor]] = (
            {name: as_tensor([picture], _CPU).numpy()} for picture in pictures
        )

    def get_next(self) -> dict[str, Tensor] | None:
        return next(self._feeds, None)


def write_eight_bit(path: Path, pictures: Sequence[LabelledImage], out: Path) -> None:
    """Write a detector's file with weights and answers of 8 bits but in its first and last layers.

    Processors of x86 without VNNI add up such products in 16 bits, which may overflow: measure
    there before use.

    Args:
        path: of the trained detector.
        pictures: some that it has learnt from, for the ranges.
        out: the file to write.
    """
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared.onnx"
        quant_pre_process(str(path), str(prepared), skip_symbolic_shape=True)
        graph = onnx.load(prepared).graph
        layers = [node.name for node in graph.node if node.op_type == "Conv"]
        quantize_static(
            str(prepared),
            str(out),
            _Ranges(graph.input[0].name, pictures),
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            nodes_to_exclude=[layers[0], layers[-1]],
        )
    written = onnx.load(out)
    onnx.helper.set_model_props(written, Network(path).metadata)
    onnx.save(written, out)


def measure_files(
    paths: Sequence[Path], trainer: DetectorTrainer, pictures: Sequence[LabelledImage]
) -> list[MeasuredDetector]:
    """Return what detectors' files are worth, timed in turn so that all share what disturbs.

    Args:
        paths: of the files, each in 32 or 8 bits.
        trainer: has trained them.
        pictures: to measure with, at least one.
    """
    networks = [Network(path) for path in paths]
    times: list[list[float]] = [[] for _ in networks]
    inputs = [as_tensor([picture], _CPU).numpy() for picture in pictures]
    for number in range(_TIMED):
        for network, spent in zip(networks, times, strict=True):
            begun = time.process_time()
            network.run(inputs[number % len(inputs)])
            spent.append(1e3 * (time.process_time() - begun))
    measured = []
    for network, spent in zip(networks, times, strict=True):
        found = [trainer.reader.read(network.run(picture)[0][0]) for picture in inputs]
        precision = mean_average_precision(found, pictures, len(trainer.class_names)).mean
        measured.append(MeasuredDetector(precision, float(np.median(spent))))
    return measured


def is_worth_it(eight_bit: MeasuredDetector, trained: MeasuredDetector) -> bool:
    """Return whether the 8-bit detector is faster at no loss that would be noticed."""
    if eight_bit.precision is None or trained.precision is None:
        return False
    loss = trained.precision - eight_bit.precision
    return loss <= _MOST_LOSS and eight_bit.work_ms < trained.work_ms
