"""Re3's trained network as an ONNX file with what it remembers going in and out."""

from __future__ import annotations

import hashlib
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from follower.training.re3.calibration import Calibration
from follower.training.re3.compact import folded, rounded, store_as_half
from follower.training.re3.network import Re3Network, Re3State
from follower_vision.network import ModelError, Network
from follower_vision.re3_geometry import SEARCH_PX, TEMPLATE_PX
from follower_vision.re3_network import INPUTS, OUTPUTS

OPSET = 17
UNCALIBRATED = Calibration()
AGREEMENT = 1e-4
"""Largest difference between torch's answers and onnxruntime's."""


class Re3Export(nn.Module):
    """The network with plain tensors in and out, in the order of `INPUTS` and `OUTPUTS`."""

    def __init__(self, network: Re3Network, calibration: Calibration) -> None:
        """Wrap a network."""
        super().__init__()
        self.network = network
        self.calibration = calibration

    def forward(
        self,
        previous: Tensor,
        present: Tensor,
        size: Tensor,
        memory: Tensor,
        memory_size: Tensor,
        hidden: Tensor,
        cell: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return box, confidence, features of `previous`, and both parts of the new state."""
        features = self.network.memory(previous)
        answer = self.network.compared(
            features, present, size, memory, memory_size, Re3State(hidden, cell)
        )
        logit = self.calibration.slope * answer.confidence + self.calibration.offset
        seen = torch.sigmoid(logit)
        return answer.box, seen, features, answer.state.hidden, answer.state.cell


@dataclass(frozen=True, slots=True)
class Exported:
    """What an export has written.

    Attributes:
        path: of the network.
        sha256: of the network.
        difference: largest between torch's answers and onnxruntime's.
    """

    path: Path
    sha256: str
    difference: float


def export_re3(
    network: Re3Network, path: Path, calibration: Calibration = UNCALIBRATED
) -> Exported:
    """Write the network to an ONNX file, its weights as 16-bit numbers, and compare the two.

    The comparison is with the network of the same rounded weights.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    module = Re3Export(rounded(folded(network)), calibration).eval()
    inputs = random_inputs(network, np.random.default_rng(0))
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        # The exporter by tracing needs no further package; torch calls it outdated.
        warnings.simplefilter("ignore")
        traced = Path(folder) / "network.onnx"
        torch.onnx.export(
            module,
            inputs,
            str(traced),
            dynamo=False,
            opset_version=OPSET,
            input_names=list(INPUTS),
            output_names=[*OUTPUTS[:3], "next_hidden", "next_cell"],
        )
        model = onnx.load(traced)
    store_as_half(model)
    onnx.helper.set_model_props(model, {"family": "re3", "licence": "Apache-2.0"})
    onnx.checker.check_model(model)
    onnx.save(model, path)
    difference = largest_difference(module.eval(), path)
    if not difference <= AGREEMENT:
        raise ModelError(f"{path}: it differs from the trained network by {difference:.1e}")
    return Exported(path, hashlib.sha256(path.read_bytes()).hexdigest(), difference)


def random_inputs(network: Re3Network, rng: np.random.Generator) -> tuple[Tensor, ...]:
    """Return one set of inputs: crops of smooth noise, a memory and a state."""
    channels, hidden = network.settings.channels, network.settings.hidden

    def noise(*shape: int) -> Tensor:
        return torch.from_numpy(rng.normal(size=shape).astype(np.float32))

    cells = TEMPLATE_PX // 8
    return (
        (noise(1, 3, TEMPLATE_PX, TEMPLATE_PX) * 40 + 120).clamp(0, 255),
        (noise(1, 3, SEARCH_PX, SEARCH_PX) * 40 + 120).clamp(0, 255),
        torch.tensor([[1.2, 1 / 1.2]]),
        nn.functional.normalize(noise(1, channels, cells, cells), dim=1),
        torch.tensor([[0.8, 1.25]]),
        noise(2, 1, hidden) * 0.2,
        noise(2, 1, hidden) * 0.2,
    )


def largest_difference(module: Re3Export, path: Path, trials: int = 4) -> float:
    """Return by how much onnxruntime's answers differ from torch's on random inputs."""
    rng = np.random.default_rng(1)
    session, worst = Network(path), 0.0
    for _ in range(trials):
        inputs = random_inputs(module.network, rng)
        with torch.no_grad():
            expected = module(*inputs)
        found = session.run(*(np.ascontiguousarray(tensor.numpy()) for tensor in inputs))
        for one, other in zip(expected, found, strict=True):
            worst = max(worst, float(np.abs(one.numpy() - other).max()))
    return worst
