"""Halves the size of a network's file at no cost in speed and almost none in quality."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from follower.training.re3.network import Re3Network

_LEAST_VALUES = 64


def folded(network: Re3Network) -> Re3Network:
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


def rounded(network: Re3Network) -> Re3Network:
    """Return a copy with weights that 16 bits hold exactly."""
    copied = copy.deepcopy(network)
    with torch.no_grad():
        for value in copied.parameters():
            if value.numel() >= _LEAST_VALUES:
                value.copy_(value.half().float())
    return copied


def store_as_half(model: onnx.ModelProto) -> None:
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
