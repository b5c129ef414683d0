"""A detector in 8-bit whole numbers beside the trained one, kept if it is as good and faster."""

from __future__ import annotations

import ast
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

from follower.training.detector.average_precision import mean_average_precision
from follower.training.detector.labelled import LabelledImage
from follower.training.detector.reading import AnswerReader
from follower.training.detector.trainer import as_tensor
from follower_vision.network import Network, Tensor

_MOST_LOSS = 0.005
_TIMED = 15
_CPU = torch.device("cpu")


@dataclass(frozen=True, slots=True)
class Measured:
    """What a detector's file is worth.

    Attributes:
        precision: mean average precision at an overlap of 0.5; None without anything to find.
        work_ms: processor time of one look, median.
    """

    precision: float | None
    work_ms: float


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


def measure_files(paths: Sequence[Path], pictures: Sequence[LabelledImage]) -> list[Measured]:
    """Return what detectors' files are worth, timed in turn so that all share what disturbs."""
    networks = [Network(path) for path in paths]
    times: list[list[float]] = [[] for _ in networks]
    inputs = [as_tensor([picture], _CPU).numpy() for picture in pictures]
    for number in range(_TIMED if inputs else 0):
        for network, spent in zip(networks, times, strict=True):
            begun = time.process_time()
            network.run(inputs[number % len(inputs)])
            spent.append(1e3 * (time.process_time() - begun))
    return [
        Measured(_precision(network, inputs, pictures), float(np.median(spent or [0.0])))
        for network, spent in zip(networks, times, strict=True)
    ]


def is_worth_it(eight_bit: Measured, trained: Measured) -> bool:
    """Return whether the 8-bit detector is faster at no loss that would be noticed."""
    if eight_bit.precision is None or trained.precision is None:
        return False
    loss = trained.precision - eight_bit.precision
    return loss <= _MOST_LOSS and eight_bit.work_ms < trained.work_ms


def _precision(
    network: Network, inputs: Sequence[Tensor], pictures: Sequence[LabelledImage]
) -> float | None:
    anchors = np.array(ast.literal_eval(network.metadata["anchors"]))
    classes = len(ast.literal_eval(network.metadata["names"]))
    (shape,) = network.inputs.values()
    reader = AnswerReader(anchors, classes, shape[-1])
    found = [reader.read(network.run(picture)[0][0]) for picture in inputs]
    return mean_average_precision(found, pictures, classes).mean
