"""The trackers that the settings name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from follower.flight.vision import tracker_factory
from follower.flight.vision.tracker_factory import make_multi_tracker, make_target_tracker
from follower.settings.settings import Settings
from follower_vision.appearance.embedding import OnnxEmbedder
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.onnx_network import ModelError, Tensor

h = onnx.helper
FRAME = Frame(np.random.default_rng(3).integers(0, 255, (120, 160, 3), np.uint8), 0.0, 0)
BOXES = [Box(50, 50, 20, 30), Box(110, 60, 20, 30)]


class BlindDetector:
    """Sees nothing."""

    class_names = ("thing",)

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        return []


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    """Settings with an appearance network that averages colours, and a detector."""
    picture = h.make_tensor_value_info("in", onnx.TensorProto.FLOAT, [1, 3, 16, 8])
    vector = h.make_tensor_value_info("out", onnx.TensorProto.FLOAT, [1, 3])
    node = h.make_node("ReduceMean", ["in"], ["out"], axes=[2, 3], keepdims=0)
    graph = h.make_graph([node], "averaging", [picture], [vector])
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    (tmp_path / "mine.onnx").write_bytes(model.SerializeToString())
    monkeypatch.setattr(tracker_factory, "make_settings_detector", lambda _: BlindDetector())
    return Settings(detector="any", appearance=str(tmp_path / "mine.onnx"))


@pytest.fixture
def embedded(monkeypatch: pytest.MonkeyPatch) -> list[Box]:
    """The boxes that the appearance network is shown."""
    shown: list[Box] = []
    embed = OnnxEmbedder.embed

    def watched(self: OnnxEmbedder, image: Image, box: Box) -> Tensor:
        shown.append(box)
        return embed(self, image, box)

    monkeypatch.setattr(OnnxEmbedder, "embed", watched)
    return shown


def test_the_appearance_network_learns_the_target(settings: Settings, embedded: list[Box]) -> None:
    make_target_tracker(settings).start(FRAME, BOXES[0])
    assert embedded == BOXES[:1]


@pytest.mark.parametrize("count", [1, 2])
def test_it_learns_each_of_several(settings: Settings, embedded: list[Box], count: int) -> None:
    tracker = make_multi_tracker(settings, count, BlindDetector())
    tracker.start(FRAME, BOXES[:count])
    tracker.close()
    assert embedded == BOXES[:count]


def test_without_a_name_there_is_none(settings: Settings, embedded: list[Box]) -> None:
    plain = settings.model_copy(update={"appearance": None})
    make_target_tracker(plain).start(FRAME, BOXES[0])
    assert embedded == []


@pytest.mark.parametrize(
    ("name", "message"),
    [("yolox-nano", "no appearance network; there are osnet"), ("gone.onnx", "no such network")],
)
def test_another_kind_of_network_is_refused(settings: Settings, name: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make_target_tracker(settings.model_copy(update={"appearance": name}))
