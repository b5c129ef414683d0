"""A small detector of the YOLO v2 family."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor, nn
from torch.nn.functional import pixel_unshuffle

from follower.training.detector.settings import DetectorTraining
from follower_control.common.strict_config import SettingsError
from follower_vision.onnx_network import Network

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
        start = torch.zeros(anchors, 5 + classes)
        start[:, 4] = _EMPTY_BIAS
        self.region.bias = nn.Parameter(start.flatten())

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
    sought = [tuple(convolution.weight.shape) for convolution, _ in _layers(network)]
    if sought != [kernel.shape for kernel, _ in kernels]:
        raise SettingsError(f"{path}: its layers are not those of channels {settings.channels}")
    _unfold(network, kernels, pictures)
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
    parts = (network.fine, network.passed, network.deep, network.joined)
    layers = [one for part in parts for one in part.modules()]
    convolutions = [one for one in layers if isinstance(one, nn.Conv2d)]
    normalisations = [one for one in layers if isinstance(one, nn.BatchNorm2d)]
    yield from zip(convolutions, normalisations, strict=True)
    yield network.region, None


@torch.no_grad()
def _unfold(
    network: RegionNetwork, kernels: Sequence[tuple[np.ndarray, np.ndarray]], pictures: Tensor
) -> None:
    """Take folded weights; each normalisation undoes itself on what it meets, and adds the bias."""

    def undo(layer: Any, given: tuple[Tensor, ...]) -> None:
        variance, mean = torch.var_mean(given[0], (0, 2, 3))
        layer.running_mean, layer.running_var = mean, variance
        layer.weight.copy_((variance + layer.eps).sqrt())
        layer.bias.add_(mean)

    hooks = []
    for (convolution, normalisation), (kernel, bias) in zip(_layers(network), kernels, strict=True):
        convolution.weight.copy_(torch.tensor(kernel))
        with_bias: Any = normalisation or convolution
        with_bias.bias.copy_(torch.tensor(bias))
        if normalisation is not None:
            hooks.append(normalisation.register_forward_pre_hook(undo))
    network(pictures)
    for hook in hooks:
        hook.remove()
