"""A trained network as an ONNX file, compared with the original, and its model card."""

import copy
import hashlib
import itertools
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from follower.training.settings import TrainingConfig
from follower_vision.onnx_network import ModelError, Network

OPSET = 17
AGREEMENT = 1e-4
"""Largest difference of onnxruntime's answers from torch's; of numbers above one their share."""
_TRIALS = 4
_LEAST_VALUES = 64

ModuleT = TypeVar("ModuleT", bound=nn.Module)
MakeInputs = Callable[[np.random.Generator], tuple[Tensor, ...]]


@dataclass(frozen=True, slots=True)
class ExportedNetwork:
    """What an export has written.

    Attributes:
        path: of the network.
        sha256: of the network.
        difference: largest between torch's answers and onnxruntime's.
    """

    path: Path
    sha256: str
    difference: float

    @property
    def card(self) -> Path:
        """Path of the model card."""
        return self.path.with_suffix(".md")


def export_network(
    module: nn.Module,
    path: Path,
    make_inputs: MakeInputs,
    names: tuple[Sequence[str], Sequence[str]],
    metadata: Mapping[str, str],
    change: Callable[[onnx.ModelProto], None] | None = None,
) -> ExportedNetwork:
    """Write a network to an ONNX file and compare the answers of both.

    Args:
        module: in evaluation mode, on the processor.
        path: of the file.
        make_inputs: makes one set of random inputs.
        names: of inputs and outputs.
        metadata: what a reader has to know.
        change: of the graph before it is written.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        # The exporter by tracing folds batch normalisation in; torch calls it outdated.
        warnings.simplefilter("ignore")
        traced = Path(folder) / "network.onnx"
        torch.onnx.export(
            module,
            make_inputs(np.random.default_rng(0)),
            str(traced),
            dynamo=False,
            opset_version=OPSET,
            input_names=list(names[0]),
            output_names=list(names[1]),
        )
        model = onnx.load(traced)
    if change is not None:
        change(model)
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model)
    onnx.save(model, path)
    difference = largest_difference(module, path, make_inputs)
    if not difference <= AGREEMENT:
        raise ModelError(f"{path}: it differs from the trained network by {difference:.1e}")
    return ExportedNetwork(path, hashlib.sha256(path.read_bytes()).hexdigest(), difference)


def folded(network: ModuleT) -> ModuleT:
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
def round_to_half(network: nn.Module) -> None:
    """Change the weights, and statistics beside them, to numbers that 16 bits hold exactly."""
    for value in itertools.chain(network.parameters(), network.buffers()):
        if value.is_floating_point() and value.numel() >= _LEAST_VALUES:
            value.copy_(value.half().float())


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


def largest_difference(module: nn.Module, path: Path, make_inputs: MakeInputs) -> float:
    """Return by how much onnxruntime's answers differ from torch's on random inputs.

    Of numbers above one it is the difference's share.
    """
    rng = np.random.default_rng(1)
    session, worst = Network(path), 0.0
    for _ in range(_TRIALS):
        inputs = make_inputs(rng)
        with torch.no_grad():
            answer = module(*inputs)
        expected = (answer,) if isinstance(answer, Tensor) else answer
        found = session.run(*(np.ascontiguousarray(tensor.numpy()) for tensor in inputs))
        for one, other in zip(expected, found, strict=True):
            wanted = one.numpy()
            share = np.abs(wanted - other) / np.maximum(np.abs(wanted), 1.0)
            worst = float(np.maximum(worst, share.max()))  # unlike max it keeps what is no number
    return worst


def write_card(
    exported: ExportedNetwork,
    config: TrainingConfig,
    network: nn.Module,
    about: str,
    rows: Iterable[tuple[str, str]],
    more: Iterable[str] = (),
) -> None:
    """Write the model card in Markdown beside the network.

    Args:
        exported: the file.
        config: of the training.
        network: whose parameters are counted.
        about: what it is.
        rows: further facts for the table.
        more: lines after it.
    """
    facts = [
        ("file", f"`{exported.path.name}`, {exported.path.stat().st_size} bytes"),
        ("sha256", f"`{exported.sha256}`"),
        ("licence", config.licence),
        ("parameters", str(sum(value.numel() for value in network.parameters()))),
        *rows,
        ("torch and ONNX differ by", f"{exported.difference:.1e}"),
    ]
    table = ["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts)]
    lines = [f"# {config.name}", "", about, "", *table, "", *more]
    exported.card.write_text("\n".join(lines), encoding="utf-8")
