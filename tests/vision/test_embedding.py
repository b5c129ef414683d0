"""The appearance network, with a tiny one that averages colours, and its use in Fusion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from follower_vision.box import Box
from follower_vision.embedding import Gallery, OnnxEmbedder
from follower_vision.frame import Frame, Image
from follower_vision.fusion.looks import Looks
from follower_vision.network import ModelError
from follower_vision.reidentify import ReidentifySettings

h = onnx.helper
BOX = Box(50, 50, 20, 40)


def _averaging_network(outputs: int = 1, channels: int = 3) -> bytes:
    """Average a picture of 16 x 8 pixels over all places: three numbers, one a colour."""
    picture = h.make_tensor_value_info("in", onnx.TensorProto.FLOAT, ["batch", channels, 16, 8])
    names = [f"out{number}" for number in range(outputs)]
    vectors = [
        h.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", channels])
        for name in names
    ]
    nodes = [h.make_node("ReduceMean", ["in"], [n], axes=[2, 3], keepdims=0) for n in names]
    graph = h.make_graph(nodes, "averaging", [picture], vectors)
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    return model.SerializeToString()


@pytest.fixture
def embedder(tmp_path: Path) -> OnnxEmbedder:
    (tmp_path / "averaging.onnx").write_bytes(_averaging_network())
    return OnnxEmbedder(tmp_path / "averaging.onnx")


def _painted(*colour: int) -> Image:
    image = np.full((100, 100, 3), 90, np.uint8)
    image[30:70, 40:60] = colour
    return image


def test_vector_is_the_normalised_colour_in_rgb_order(embedder: OnnxEmbedder) -> None:
    vector = embedder.embed(_painted(255, 0, 0), BOX)
    blue = (np.array([0, 0, 1]) - (0.485, 0.456, 0.406)) / (0.229, 0.224, 0.225)
    assert vector == pytest.approx(blue / np.linalg.norm(blue), abs=0.01)


def test_gallery_knows_the_first_view_and_the_latest(embedder: OnnxEmbedder) -> None:
    red, green, blue = _painted(0, 0, 255), _painted(0, 255, 0), _painted(255, 0, 0)
    gallery = Gallery(embedder, most=2)
    with pytest.raises(RuntimeError):
        gallery.likeness(red, BOX)
    gallery.start(red, BOX)
    assert gallery.likeness(red, BOX) == pytest.approx(1.0, abs=1e-5)
    assert gallery.likeness(green, BOX) < 0.5
    gallery.learn(green, BOX)
    gallery.learn(blue, BOX)
    assert gallery.likeness(red, BOX) == pytest.approx(1.0, abs=1e-5)
    assert gallery.likeness(blue, BOX) == pytest.approx(1.0, abs=1e-5)
    assert gallery.likeness(green, BOX) < 0.5


def test_looks_ask_the_network_only_if_there_is_one(embedder: OnnxEmbedder) -> None:
    red, blue = _painted(0, 0, 255), _painted(255, 0, 0)
    plain, informed = Looks(ReidentifySettings()), Looks(ReidentifySettings(), embedder)
    for looks in (plain, informed):
        looks.start(Frame(red, 0.0, 0), BOX)
    assert plain.kinship(red, BOX) == plain.kinship(blue, BOX) == 0.0
    assert informed.kinship(red, BOX) > 0 > informed.kinship(blue, BOX)


@pytest.mark.parametrize("content", [_averaging_network(outputs=2), _averaging_network(channels=1)])
def test_another_kind_of_network_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.onnx"
    path.write_bytes(content)
    with pytest.raises(ModelError, match="not an appearance network"):
        OnnxEmbedder(path)
