"""Re3's trained network as an ONNX file: confidence calibrated, state in and out."""

import copy
import itertools
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from follower.training.onnx_export import ExportedNetwork, export_network
from follower.training.re3.examples import Tracked
from follower.training.re3.network import Re3Module, Re3ModuleState
from follower_vision.trackers.re3 import INPUTS, OUTPUTS, SEARCH_PX, TEMPLATE_PX

RIGHT_OVERLAP = 0.5
_NEWTON_STEPS = 30
_RIDGE = 1e-2
_LEAST_VALUES = 64
UNCALIBRATED = (1.0, 0.0)
"""Slope and offset of a logit that is left as it is."""


def calibrated(seen: Tracked) -> tuple[float, float]:
    """Fit the likelihood of an overlap above a half by a logistic curve (Platt's scaling).

    Returns slope and offset of the calibrated logit. Where the logits say nothing about the
    overlap, or the wrong thing, they are left as they are.
    """
    right = (seen.overlaps > RIGHT_OVERLAP).astype(float)
    inputs = np.stack([seen.logits, np.ones_like(seen.logits)], axis=1)
    weights = np.zeros(2)
    for _ in range(_NEWTON_STEPS):
        likelihood = 1.0 / (1.0 + np.exp(-np.clip(inputs @ weights, -30, 30)))
        slope = inputs.T @ (likelihood - right) + _RIDGE * weights
        curve = (inputs * (likelihood * (1 - likelihood))[:, None]).T @ inputs
        weights -= np.linalg.solve(curve + _RIDGE * np.eye(2), slope)
    if not np.isfinite(weights).all() or weights[0] <= 0.0:
        return UNCALIBRATED
    return float(weights[0]), float(weights[1])


def folded(network: Re3Module) -> Re3Module:
    """Return a copy whose batch normalisations are part of the convolutions before them."""
    copied = copy.deepcopy(network).cpu().eval()
    for module in copied.modules():
        names = list(module._modules)
        for name, following in itertools.pairwise(names):
            layer, norm = module._modules[name], module._modules[following]
            if isinstance(layer, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                module._modules[name] = fuse_conv_bn_eval(layer, norm)
                module._modules[following] = nn.Identity()
    return copied


@torch.no_grad()
def _round(network: Re3Module) -> None:
    """Change the weights to numbers that 16 bits hold exactly."""
    for value in network.parameters():
        if value.numel() >= _LEAST_VALUES:
            value.copy_(value.half().float())


def _store_as_half(model: onnx.ModelProto) -> None:
    """Keep weights as 16-bit numbers in the file; the runtime widens them once, as it loads."""
    casts = []
    for initializer in model.graph.initializer:
        values = numpy_helper.to_array(initializer)
        if values.dtype != np.float32 or values.size < _LEAST_VALUES:
            continue
        name, short = initializer.name, f"{initializer.name}_half"
        initializer.CopyFrom(numpy_helper.from_array(values.astype(np.float16), short))
        casts.append(helper.make_node("Cast", [short], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)


class Re3Export(nn.Module):
    """The network with plain tensors in and out, in the order of `INPUTS` and `OUTPUTS`."""

    def __init__(self, network: Re3Module, calibration: tuple[float, float]) -> None:
        """Wrap a network."""
        super().__init__()
        self.network = network
        self.slope, self.offset = calibration

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
        answer = self.network(
            features, present, size, memory, memory_size, Re3ModuleState(hidden, cell)
        )
        seen = torch.sigmoid(self.slope * answer.confidence + self.offset)
        return answer.box, seen, features, answer.state.hidden, answer.state.cell


def export_re3(
    network: Re3Module, path: Path, calibration: tuple[float, float] = UNCALIBRATED
) -> ExportedNetwork:
    """Write the network to an ONNX file, its weights as 16-bit numbers, and compare the two.

    The comparison is with the network of the same rounded weights.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    compact = folded(network)
    _round(compact)
    return export_network(
        Re3Export(compact, calibration).eval(),
        path,
        lambda rng: random_inputs(network, rng),
        (INPUTS, (*OUTPUTS[:3], "next_hidden", "next_cell")),
        {"family": "re3", "licence": "Apache-2.0"},
        _store_as_half,
    )


def random_inputs(network: Re3Module, rng: np.random.Generator) -> tuple[Tensor, ...]:
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
