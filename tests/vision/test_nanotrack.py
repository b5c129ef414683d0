"""NanoTrack's glue, on a network with known weights and on the real ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from real_data import DATA, needs_data

from follower_vision.geometry.box import Box
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.motion_tracker import ResponseMap
from follower_vision.trackers.nanotrack import (
    NANOTRACK_SETTINGS,
    NanoTracker,
    NanoTrackNetwork,
    NanoTrackSettings,
)

onnx = pytest.importorskip("onnx", reason="tiny networks are built with the onnx package")
h = onnx.helper

HALF_SIDE = 32.0


def _save(path: Path, nodes: list, inputs: list, outputs: list, constants: list = ()) -> Path:
    def infos(tensors: list) -> list:
        return [h.make_tensor_value_info(name, 1, shape) for name, shape in tensors]

    graph = h.make_graph(nodes, "tiny", infos(inputs), infos(outputs), initializer=list(constants))
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def _constant(name: str, values: np.ndarray) -> object:
    return onnx.numpy_helper.from_array(values.astype(np.float32), name)


def _backbone(folder: Path) -> Path:
    """Average 16x16 pixels; cell i lies about pixel 16 i."""
    pool = h.make_node(
        "AveragePool",
        ["pixels"],
        ["features"],
        kernel_shape=[16, 16],
        strides=[16, 16],
        pads=[8, 8, 8, 8],
    )
    shapes = [("pixels", [1, 3, 255, 255])], [("features", [1, 3, 16, 16])]
    return _save(folder / "backbone.onnx", [pool], *shapes)


def _head(folder: Path) -> Path:
    """Call cells amid red the target, and say that each side is always 32 crop pixels away."""
    weights = np.zeros((2, 3, 1, 1))
    weights[1, :, 0, 0] = [-0.02, -0.02, 0.04]  # blue, green, red
    bias = np.array([0.0, -2.5])
    nodes = [
        h.make_node("AveragePool", ["search"], ["about"], kernel_shape=[5, 5], pads=[2, 2, 2, 2]),
        h.make_node("Conv", ["about", "weights", "bias"], ["coloured"]),
        # The template must be part of the graph, but says nothing.
        h.make_node("ReduceMean", ["template"], ["mean"], keepdims=1),
        h.make_node("Mul", ["mean", "zero"], ["nothing"]),
        h.make_node("Add", ["coloured", "nothing"], ["classes"]),
        h.make_node("Conv", ["search", "flat", "sides"], ["distances"]),
    ]
    constants = [
        _constant("weights", weights),
        _constant("bias", bias),
        _constant("zero", np.zeros((1, 1, 1, 1))),
        _constant("flat", np.zeros((4, 3, 1, 1))),
        _constant("sides", np.full(4, HALF_SIDE)),
    ]
    return _save(
        folder / "head.onnx",
        nodes,
        [("template", [1, 3, 8, 8]), ("search", [1, 3, 16, 16])],
        [("classes", [1, 2, 16, 16]), ("distances", [1, 4, 16, 16])],
        constants,
    )


@pytest.fixture
def network(tmp_path: Path) -> NanoTrackNetwork:
    return NanoTrackNetwork(_backbone(tmp_path), _head(tmp_path))


def scene(*places: tuple[float, float], side: int = 40) -> np.ndarray:
    """A grey image of 640x480 with red squares about the places given."""
    image = np.full((480, 640, 3), 100, np.uint8)
    for cx, cy in places:
        corner = round(cx - side / 2), round(cy - side / 2)
        cv2.rectangle(image, (*corner, side, side), (30, 30, 250), -1)
    return image


def tracker(network: NanoTrackNetwork, **changes: float) -> NanoTracker:
    return NanoTracker(network, NanoTrackSettings(**changes))


def test_a_still_target_stays_put(network: NanoTrackNetwork) -> None:
    nano = tracker(network)
    nano.start(scene((300, 200)), Box(300, 200, 40, 40))
    for _ in range(5):
        estimate = nano.update(scene((300, 200)))
    assert estimate.box.distance(Box(300, 200, 40, 40)) < 2
    assert estimate.confidence > 0.9


@pytest.mark.parametrize("share", ["one cell", "all"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_networks_broken_numbers_are_an_unseen_frame(
    network: NanoTrackNetwork, monkeypatch: pytest.MonkeyPatch, wrong: float, share: str
) -> None:
    nano, there = tracker(network), scene((300, 200))
    nano.start(there, Box(300, 200, 40, 40))
    box, features = nano.update(there).box, network.features

    def broken(crop: np.ndarray) -> np.ndarray:
        right = features(crop).copy()
        right[(..., 8, 8) if share == "one cell" else ...] = wrong
        return right

    with monkeypatch.context() as patch:
        patch.setattr(network, "features", broken)
        estimate = nano.update(there)
        assert not np.isnan(nano.search(there, box).finite(box).image_features).any()
    assert estimate.box.distance(box) < 60
    assert 0 <= estimate.confidence <= 1
    assert (estimate.box, estimate.confidence) == (box, 0.0) or share == "one cell"
    assert nano.update(there).confidence > 0.9


def test_a_head_whose_sides_are_pixels_knows_no_shape(network: NanoTrackNetwork) -> None:
    template = network.template(
        np.zeros((network.template_side, network.template_side, 3), "uint8")
    )
    features = network.features(np.zeros((network.search_side, network.search_side, 3), "uint8"))
    plain, shaped = (network.match(template, features, one) for one in ((1.0, 1.0), (3.0, 1 / 3)))
    np.testing.assert_array_equal(plain.corners, shaped.corners)


def test_the_box_follows_right_and_down(network: NanoTrackNetwork) -> None:
    nano = tracker(network, window_influence=0.0)
    nano.start(scene((300, 200)), Box(300, 200, 40, 40))
    for step in range(1, 20):
        estimate = nano.update(scene((300 + 6 * step, 200 + 3 * step)))
    # A cell is 16 of 127 crop pixels, which show 80 pixels of the image.
    assert estimate.box.distance(Box(300 + 6 * 19, 200 + 3 * 19, 40, 40)) < 16 * 80 / 127


def test_the_size_goes_to_the_seen_one_at_the_learning_rate(network: NanoTrackNetwork) -> None:
    nano = tracker(network, learning_rate=0.25, penalty_k=0.0)
    nano.start(scene((300, 200)), Box(300, 200, 50, 50))
    estimate = nano.update(scene((300, 200)))
    # 64 crop pixels; the crop's 127 show twice the target.
    seen = 2 * HALF_SIDE * 100 / 127
    rate = 0.25 * estimate.confidence
    assert estimate.box.width == pytest.approx(50 + rate * (seen - 50), rel=1e-3)


def test_nothing_there_is_low_confidence(network: NanoTrackNetwork) -> None:
    nano = tracker(network)
    nano.start(scene((300, 200)), Box(300, 200, 40, 40))
    assert nano.update(scene()).confidence < 0.1
    assert nano.search(scene(), Box(300, 200, 40, 40)).scores.max() < 0.1


def best(response: ResponseMap) -> tuple[float, float]:
    """The centre of the place with the highest likeness, in pixels."""
    left, top, right, bottom = response.corners[int(response.scores.argmax())]
    return (left + right) / 2, (top + bottom) / 2


def test_a_search_shows_the_look_alike(network: NanoTrackNetwork) -> None:
    nano, box = tracker(network), Box(300, 200, 40, 40)
    nano.start(scene((300, 200)), box)
    response = nano.search(scene((300, 200), (355, 200)), box)
    likely = response.corners[response.scores > 0.5]
    centres = (likely[:, 0] + likely[:, 2]) / 2
    assert np.abs(centres - 300).min() < 8
    assert np.abs(centres - 355).min() < 8
    assert np.all((response.penalty > 0) & (response.penalty <= 1))


def test_a_search_elsewhere_changes_nothing(network: NanoTrackNetwork) -> None:
    nano, undisturbed = tracker(network), tracker(network)
    image = scene((300, 200), (500, 400))
    for each in (nano, undisturbed):
        each.start(image, Box(300, 200, 40, 40))
    response = nano.search(image, Box(495, 395, 40, 40))
    assert best(response) == pytest.approx((500, 400), abs=8)
    assert response.region.distance(Box(495, 395, 1, 1)) == 0
    assert nano.update(image) == undisturbed.update(image)


def test_a_search_gives_the_features_of_the_region_it_searched(network: NanoTrackNetwork) -> None:
    """The tiny network's features are the mean colours of 16 x 16 pixels of the crop."""
    nano, box = tracker(network), Box(300, 200, 40, 40)
    nano.start(scene((300, 200)), box)
    features = nano.search(scene((300, 200)), box).image_features
    assert features.shape == (16, 16, 3)
    assert features[8, 8] == pytest.approx((30, 30, 250), abs=2)
    assert features[1, 1] == pytest.approx((100, 100, 100), abs=2)


def test_the_first_look_stays_the_only_one(network: NanoTrackNetwork) -> None:
    image, box = scene((300, 200)), Box(300, 200, 40, 40)
    nano = tracker(network)
    nano.start(image, box)
    before = nano.search(image, box)
    for _ in range(40):
        nano.learn(np.ascontiguousarray(image[..., ::-1]), box, 1.0)
    assert np.array_equal(nano.search(image, box).scores, before.scores)


def test_a_target_beyond_the_edge_keeps_a_finite_box(network: NanoTrackNetwork) -> None:
    nano = tracker(network)
    nano.start(scene((10, 10)), Box(10, 10, 40, 40))
    for step in range(10):
        estimate = nano.update(scene((10 - 5 * step, 10 - 5 * step)))
    assert 0 <= estimate.box.cx <= 640
    assert 0 <= estimate.box.cy <= 480


def test_small_boxes_stop_at_the_smallest_side(network: NanoTrackNetwork) -> None:
    nano = tracker(network, smallest_side_px=7.0)
    nano.start(scene((300, 200), side=4), Box(300, 200, 4, 4))
    assert nano.update(scene((300, 200), side=4)).box.width >= 7.0


def test_a_head_is_no_backbone_nor_the_other_way_round(tmp_path: Path) -> None:
    backbone, head = _backbone(tmp_path), _head(tmp_path)
    with pytest.raises(ModelError, match=r"head\.onnx: not a NanoTrack backbone"):
        NanoTrackNetwork(head, head)
    with pytest.raises(ModelError, match=r"backbone\.onnx: not a NanoTrack head"):
        NanoTrackNetwork(backbone, backbone)


@needs_data("weights", "sequences")
@pytest.mark.parametrize("version", [1, 2, 3])
def test_real_network_follows_a_real_car(version: int) -> None:
    folder = DATA / "sequences" / "otb_car4"
    truth = [
        Box.from_xywh(*row)
        for row in np.loadtxt(folder / "groundtruth.txt", delimiter=",", max_rows=120)
    ]
    files = [DATA / "weights" / f"nanotrackv{version}_{part}.onnx" for part in ("backbone", "head")]
    nano = NanoTracker(NanoTrackNetwork(*files), NANOTRACK_SETTINGS[version])
    images = [cv2.imread(str(path)) for path in sorted((folder / "img").iterdir())[:120]]
    nano.start(images[0], truth[0])
    estimates = [nano.update(image) for image in images[1:]]
    overlaps = [found.box.iou(box) for found, box in zip(estimates, truth[1:], strict=True)]
    assert min(overlaps) > 0.5
    assert np.mean(overlaps) > 0.75
    assert min(found.confidence for found in estimates) > 0.8
