"""A training that begins with an exported network: its normalisations are unfolded again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from follower.training.detector.network import RegionNetwork
from follower.training.detector.settings import DetectorTraining
from follower_control.strict_yaml import SettingsError
from follower_vision.network import Network


def state_of_onnx(
    path: Path, settings: DetectorTraining, classes: Sequence[str], pictures: Tensor
) -> dict[str, Any]:
    """Return what a training begins with, from a network that one like it has exported.

    An export folds every batch normalisation into the convolution before it. Here each gets the
    mean and variance that the folded network shows on some pictures, and the scale and offset that
    undo them: the network answers as before, and what it learns from has the usual size.

    Args:
        path: of the ONNX file.
        settings: of the training that begins.
        classes: what it is to find.
        pictures: (B, 3, H, W) RGB, 0 to 1, of the kind that it will learn from.

    Raises:
        ModelError: the file is missing or broken.
        SettingsError: it is another kind of network, or of other classes.
    """
    said = Network(path).metadata
    if said.get("family") != "yolov2" or not {"anchors", "names"} <= said.keys():
        raise SettingsError(
            f"{path}: this is no network that `follower train detector` has written"
        )
    anchors, names, model = json.loads(said["anchors"]), said["names"], onnx.load(path)
    if names != str(list(classes)):
        raise SettingsError(f"{path}: it finds {names}, and the pictures show {list(classes)}")
    network = RegionNetwork(len(classes), len(anchors), settings.channels).eval()
    kernels = _kernels(model)
    layers = list(_layers(network))
    sought = [tuple(convolution.weight.shape) for convolution, _ in layers]
    if sought != [kernel.shape for kernel, _ in kernels]:
        raise SettingsError(f"{path}: its layers are not those of channels {settings.channels}")
    for (convolution, normalisation), (kernel, bias) in zip(layers, kernels, strict=True):
        _fill(convolution, normalisation, torch.tensor(kernel), torch.tensor(bias))
    _normalise(network, pictures)
    return {
        "kind": "detector",
        "averaged": network.state_dict(),
        "anchors": anchors,
        "classes": list(classes),
        "settings": asdict(settings),
    }


def _kernels(model: onnx.ModelProto) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return weights and bias of each convolution, in the order in which they compute."""
    known = {one.name: one for one in model.graph.initializer}
    numbers = [
        [onnx.numpy_helper.to_array(known[name]) for name in node.input[1:3] if name in known]
        for node in model.graph.node
        if node.op_type == "Conv"
    ]
    return [(pair[0], pair[1]) for pair in numbers if len(pair) == 2]


def _layers(network: RegionNetwork) -> Iterator[tuple[nn.Conv2d, nn.BatchNorm2d | None]]:
    """Yield the convolutions, each with its normalisation, in the order in which they compute."""
    parts = (network.fine, network.passed, network.deep, network.joined, network.region)
    found = [one for part in parts for one in part.modules()]
    found = [one for one in found if isinstance(one, nn.Conv2d | nn.BatchNorm2d)]
    for number, one in enumerate(found):
        if isinstance(one, nn.Conv2d):
            after = found[number + 1] if number + 1 < len(found) else None
            yield one, after if isinstance(after, nn.BatchNorm2d) else None


@torch.no_grad()
def _fill(
    convolution: nn.Conv2d, normalisation: nn.BatchNorm2d | None, kernel: Tensor, bias: Tensor
) -> None:
    """Take the folded weights; the normalisation does nothing but add the bias."""
    convolution.weight.copy_(kernel)
    if normalisation is None:
        if convolution.bias is not None:
            convolution.bias.copy_(bias)
        return
    normalisation.running_mean = torch.zeros_like(bias)
    normalisation.running_var = torch.full_like(bias, 1.0 - normalisation.eps)
    normalisation.weight.fill_(1.0)
    normalisation.bias.copy_(bias)


@torch.no_grad()
def _normalise(network: RegionNetwork, pictures: Tensor) -> None:
    """Let each normalisation divide by what it meets, and multiply by it again."""
    met: dict[nn.Module, tuple[Tensor, Tensor]] = {}

    def look(layer: nn.Module, given: tuple[Tensor, ...]) -> None:
        met[layer] = given[0].mean((0, 2, 3)), given[0].var((0, 2, 3))

    normalisations = [pair[1] for pair in _layers(network) if pair[1] is not None]
    hooks = [one.register_forward_pre_hook(look) for one in normalisations]
    network(pictures)
    for hook in hooks:
        hook.remove()
    for one in normalisations:
        mean, variance = met[one]
        one.running_mean, one.running_var = mean, variance
        one.weight.copy_((variance + one.eps).sqrt())
        one.bias.add_(mean)
