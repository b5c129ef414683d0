"""The detector's glue on a network with known weights, and the real networks on real frames."""

from __future__ import annotations

import functools
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from real_data import DATA, needs_data

from follower_vision.detection import DetectorSettings, OnnxDetector
from follower_vision.detection.detection import InputFormat, Placement
from follower_vision.detection.onnx_detector import COCO_CLASSES, VOC_CLASSES, choose_class_names
from follower_vision.geometry.box import Box
from follower_vision.onnx_network import ModelError

onnx = pytest.importorskip("onnx", reason="tiny networks are built with the onnx package")
h = onnx.helper

SIDE = 64
BOX_SHARE = 0.25


def red_detector(path: Path, side: int | str = SIDE, names: str | None = None) -> Path:
    """A FastestDet of two classes: a red cell is an object, a quarter of the input wide and high.

    Red and dark is class 0, red and bright (with blue) is class 1.
    """
    weights, bias = np.zeros((7, 3, 1, 1)), np.zeros(7)
    weights[0, :, 0, 0] = [0.0, -20.0, 20.0]  # blue, green, red, each 0 to 1
    bias[0] = -12.0
    weights[5:, 0, 0, 0] = [-20.0, 20.0]
    bias[5:] = [10.0, -10.0]
    bias[3:5] = np.log(BOX_SHARE / (1 - BOX_SHARE))
    nodes = [
        h.make_node("AveragePool", ["x"], ["mean"], kernel_shape=[16, 16], strides=[16, 16]),
        h.make_node("Conv", ["mean", "w", "b"], ["raw"]),
        h.make_node("Split", ["raw", "parts"], ["objectness", "box", "classes"], axis=1),
        h.make_node("Sigmoid", ["objectness"], ["likely"]),
        h.make_node("Sigmoid", ["classes"], ["named"]),
        h.make_node("Concat", ["likely", "box", "named"], ["y"], axis=1),
    ]
    constants = [
        onnx.numpy_helper.from_array(weights.astype(np.float32), "w"),
        onnx.numpy_helper.from_array(bias.astype(np.float32), "b"),
        onnx.numpy_helper.from_array(np.array([1, 4, 2]), "parts"),
    ]
    graph = h.make_graph(
        nodes,
        "red",
        [h.make_tensor_value_info("x", 1, [1, 3, side, side])],
        [h.make_tensor_value_info("y", 1, [1, 7, "rows", "columns"])],
        initializer=constants,
    )
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    if names is not None:
        h.set_model_props(model, {"names": names})
    path.write_bytes(model.SerializeToString())
    return path


def constant_detector(path: Path, rows: list[tuple[float, ...]]) -> Path:
    """A YOLOv8 that always sees the same: rows of cx, cy, width, height and two class scores."""
    cells = sum((SIDE // stride) ** 2 for stride in (8, 16, 32))
    answer = np.zeros((1, 6, cells), np.float32)
    answer[0, :, : len(rows)] = np.array(rows, np.float32).T
    nodes = [
        h.make_node("ReduceMean", ["x"], ["mean"], axes=[1, 2, 3], keepdims=0),
        h.make_node("Mul", ["mean", "zero"], ["nothing"]),
        h.make_node("Add", ["answer", "nothing"], ["y"]),
    ]
    constants = [
        onnx.numpy_helper.from_array(answer, "answer"),
        onnx.numpy_helper.from_array(np.zeros(1, np.float32), "zero"),
    ]
    graph = h.make_graph(
        nodes,
        "constant",
        [h.make_tensor_value_info("x", 1, [1, 3, SIDE, SIDE])],
        [h.make_tensor_value_info("y", 1, [1, 6, cells])],
        initializer=constants,
    )
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


WIDE, HIGH = 96, 64
CELLS = 126
"""Cells of the three grids in an input of 96 x 64 pixels."""


def exported(
    path: Path, outputs: dict[str, np.ndarray], *, with_size: bool = False, **written: str
) -> Path:
    """A network that always answers the same, of `WIDE` x `HIGH` pixels.

    With a size as its second input, `boxes` are shares of it, and come out in its pixels. What is
    `written` is in the file's metadata.
    """
    nodes, values = [], []
    for name, answer in outputs.items():
        values.append(onnx.numpy_helper.from_array(answer, f"{name} said"))
        factor = "size4" if with_size and name == "boxes" else None
        said = [f"{name} said", factor] if factor else [f"{name} said"]
        nodes.append(h.make_node("Mul" if factor else "Identity", said, [name]))
    inputs = [h.make_tensor_value_info("images", 1, ["N", 3, HIGH, WIDE])]
    if with_size:
        inputs.append(h.make_tensor_value_info("orig_target_sizes", 7, ["N", 2]))
        cast = h.make_node("Cast", ["orig_target_sizes"], ["size"], to=1)
        nodes = [cast, h.make_node("Concat", ["size", "size"], ["size4"], axis=1), *nodes]
    infos = [
        h.make_tensor_value_info(name, 7 if answer.dtype == np.int64 else 1, answer.shape)
        for name, answer in outputs.items()
    ]
    graph = h.make_graph(nodes, "exported", inputs, infos, initializer=values)
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    h.set_model_props(model, written)
    path.write_bytes(model.SerializeToString())
    return path


def answers(export: str) -> dict[str, np.ndarray]:
    """What an exporter's network says that sees class 1 in the middle half of its input, at 0.9."""
    centre, corners = (48, 32, 48, 32), (24, 16, 72, 48)
    shapes = {
        "YOLOv5": {"output0": (3 * CELLS, 7)},
        "YOLO11": {"output0": (CELLS, 6)},
        "YOLO26": {"output0": (300, 6)},
        "RT-DETR": {"output0": (300, 6)},
        "Transformers": {"logits": (300, 80), "pred_boxes": (300, 4)},
        "D-FINE": {"labels": (300,), "boxes": (300, 4), "scores": (300,)},
    }
    made = {name: np.zeros((1, *shape), np.float32) for name, shape in shapes[export].items()}
    if export == "YOLOv5":
        made["output0"][0, 2] = [*centre, 0.9, 0.0, 1.0]
    elif export == "YOLO11":
        made["output0"][0, 2] = [*centre, 0.0, 0.9]
        made["output0"] = made["output0"].transpose(0, 2, 1)
    elif export == "YOLO26":
        made["output0"][0, 2] = [*corners, 0.9, 1.0]
    elif export == "RT-DETR":
        made["output0"][0, 2] = [0.5, 0.5, 0.5, 0.5, 0.9, 1.0]
    elif export == "Transformers":
        made["logits"] -= 9.0
        made["logits"][0, 2, 1] = np.log(0.9 / 0.1)
        made["pred_boxes"][0, 2] = 0.5
    else:
        made["labels"] = made["labels"].astype(np.int64)
        made["labels"][0, 2], made["scores"][0, 2] = 1, 0.9
        made["boxes"][0, 2] = [0.25, 0.25, 0.75, 0.75]
    return made


@pytest.fixture
def red_file(tmp_path: Path) -> Path:
    return red_detector(tmp_path / "red.onnx")


def scene(*squares: tuple[int, int, int, tuple[int, int, int]]) -> np.ndarray:
    """A black image of 640x640 with squares (left, top, side, colour)."""
    image = np.zeros((640, 640, 3), np.uint8)
    for left, top, side, colour in squares:
        cv2.rectangle(image, (left, top, side, side), colour, -1)
    return image


RED, MAGENTA = (0, 0, 255), (255, 0, 255)


def test_the_whole_image_is_searched(red_file: Path) -> None:
    detector = OnnxDetector(red_file, class_names=["dark", "bright"])
    # A cell is 160 pixels here; the network puts the box's middle at the cell's corner.
    found = detector.detect(scene((160, 320, 160, RED), (480, 0, 160, MAGENTA)))
    assert {(one.class_name, round(one.box.cx, 3), round(one.box.cy, 3)) for one in found} == {
        ("dark", 160.0, 320.0),
        ("bright", 480.0, 0.0),
    }
    for one in found:
        assert (one.box.width, one.box.height) == pytest.approx((160.0, 160.0), rel=1e-5)
        assert 0.9 < one.score <= 1.0
        assert not one.cut


def test_a_region_is_a_zoom_and_boxes_come_back_in_image_pixels(red_file: Path) -> None:
    detector = OnnxDetector(red_file)
    image = scene((320, 240, 16, RED))
    assert detector.detect(image) == []
    (found,) = detector.detect(image, Box(336, 256, 64, 64))
    assert found.box.cx == pytest.approx(320)
    assert found.box.cy == pytest.approx(240)
    assert found.box.width == pytest.approx(16, rel=1e-5)


@pytest.mark.parametrize("left", [-32.0, 0.0])
def test_a_region_may_reach_beyond_the_image(red_file: Path, left: float) -> None:
    image = scene((0, 16, 16, RED))
    (found,) = OnnxDetector(red_file).detect(image, Box.from_xywh(left, 0, 64, 64))
    assert found.box.cx == pytest.approx(0, abs=1e-4)
    assert found.box.cy == pytest.approx(16, abs=1e-4)


def test_what_the_regions_edge_cuts_is_marked(red_file: Path) -> None:
    image = scene((400, 416, 16, RED), (416, 432, 16, RED))
    region = Box(432, 432, 64, 64)  # begins at 400, the first square's box at 392
    found = OnnxDetector(red_file).detect(image, region)
    assert {round(one.box.cx): one.cut for one in found} == {400: True, 416: False}


def test_the_images_own_edge_is_no_cut(red_file: Path) -> None:
    found = OnnxDetector(red_file).detect(scene((0, 0, 160, RED)))
    assert [one.cut for one in found] == [False]
    at_corner = OnnxDetector(red_file).detect(scene((0, 0, 16, RED)), Box(32, 32, 64, 64))
    assert [one.cut for one in at_corner] == [False]


def test_neighbouring_boxes_of_one_class_are_thinned_others_not(tmp_path: Path) -> None:
    # Cells are 16 of 64 pixels and boxes 16 wide: neighbours of one class just touch.
    detector = OnnxDetector(red_detector(tmp_path / "a.onnx"), DetectorSettings(max_overlap=0.0))
    everything = detector.detect(scene((0, 0, 640, RED)))
    assert len(everything) == 16
    few = OnnxDetector(red_detector(tmp_path / "b.onnx"), DetectorSettings(most=3))
    found = few.detect(scene((0, 0, 640, RED)))
    assert len(found) == 3
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)


def test_overlap_counts_within_a_class_only(tmp_path: Path) -> None:
    rows = [
        (32, 32, 16, 16, 0.9, 0.0),
        (33, 32, 16, 16, 0.8, 0.0),  # the same object again
        (32, 32, 16, 16, 0.0, 0.7),  # another class at the same place
        (48, 32, 16, 16, 0.6, 0.0),  # a neighbour
    ]
    found = OnnxDetector(constant_detector(tmp_path / "c.onnx", rows)).detect(scene())
    assert [(one.class_id, round(one.score, 3), one.box.cx) for one in found] == [
        (0, 0.9, 320.0),
        (1, 0.7, 320.0),
        (0, 0.6, 480.0),
    ]


def test_a_wide_image_is_shown_whole_and_undistorted(tmp_path: Path) -> None:
    file = constant_detector(tmp_path / "c.onnx", [(32, 32, 16, 8, 0.9, 0.0)])
    (found,) = OnnxDetector(file).detect(np.zeros((360, 640, 3), np.uint8))
    assert found.box == Box(320, 180, 160, 80)


@pytest.mark.parametrize(
    "export", ["YOLOv5", "YOLO11", "YOLO26", "RT-DETR", "Transformers", "D-FINE"]
)
def test_an_exported_network_is_recognised_and_its_boxes_are_where_it_says(
    export: str, tmp_path: Path
) -> None:
    head = "RTDETRDecoder" if export == "RT-DETR" else ""
    with_size = export == "D-FINE"
    file = exported(tmp_path / "own.onnx", answers(export), with_size=with_size, head=head)
    (found,) = OnnxDetector(file).detect(np.zeros((128, 192, 3), np.uint8))
    assert found.box.xywh == pytest.approx((48, 32, 96, 64), abs=1e-3)
    assert found.score == pytest.approx(0.9, abs=1e-5)
    assert found.class_id == 1
    names = {"YOLOv5": "class 1", "YOLO11": "class 1"}
    assert found.class_name == names.get(export, "bicycle")


@pytest.mark.parametrize("task", ["obb", "pose"])
def test_angles_and_joints_are_not_taken_for_scores(task: str, tmp_path: Path) -> None:
    file = exported(tmp_path / "own.onnx", answers("YOLO11"), task=task)
    with pytest.raises(ModelError, match=rf"own\.onnx: not a detector .* its task is {task}$"):
        OnnxDetector(file)
    detects = exported(tmp_path / "own.onnx", answers("YOLO11"), task="detect")
    assert len(OnnxDetector(detects).detect(scene())) == 1


def test_class_numbers_beyond_the_names_are_named_by_number(tmp_path: Path) -> None:
    said = answers("D-FINE")
    said["labels"][0, 2] = 99
    file = exported(tmp_path / "own.onnx", said, with_size=True)
    (found,) = OnnxDetector(file).detect(scene())
    assert found.class_name == "class 99"
    (found,) = OnnxDetector(file, class_names=["a"]).detect(scene())
    assert found.class_name == "class 99"


def test_an_unknown_layout_is_one_line_that_lists_what_is_read(tmp_path: Path) -> None:
    file = exported(tmp_path / "own.onnx", {"output0": np.zeros((1, 300, 38), np.float32)})
    with pytest.raises(
        ModelError, match=r"own\.onnx: not a detector.*output0 \(1, 300, 38\)"
    ) as no:
        OnnxDetector(file)
    assert "\n" not in str(no.value)
    for layout in ("(1, 4 + classes, cells)", "(1, rows, 6)", "logits (1, rows, classes)"):
        assert layout in str(no.value)


def test_boxes_that_are_none_are_dropped(tmp_path: Path) -> None:
    rows = [
        (32, 32, float("inf"), 16, 0.9, 0.0),
        (float("nan"), 32, 16, 16, 0.9, 0.0),
        (32, 32, 0, 16, 0.9, 0.0),
        (32, 32, 16, 16, float("inf"), 0.0),
        (32, 32, 16, 16, 0.5, 0.0),
    ]
    found = OnnxDetector(constant_detector(tmp_path / "c.onnx", rows)).detect(scene())
    assert [round(one.score, 3) for one in found] == [0.5]


def test_min_score_decides(red_file: Path) -> None:
    image = scene((160, 320, 150, RED))
    (weak,) = OnnxDetector(red_file, DetectorSettings(min_score=0.01)).detect(image)
    assert OnnxDetector(red_file, DetectorSettings(min_score=weak.score + 1e-4)).detect(image) == []


def test_a_free_input_size_gets_a_usual_one(tmp_path: Path) -> None:
    detector = OnnxDetector(red_detector(tmp_path / "free.onnx", side="any"))
    (found,) = detector.detect(scene((320, 320, 25, RED)))
    assert found.box.cx == pytest.approx(320, abs=13)


def test_same_image_same_answer(red_file: Path) -> None:
    detector, image = OnnxDetector(red_file), scene((160, 320, 160, RED))
    first = detector.detect(image)
    detector.detect(scene((0, 0, 640, MAGENTA)), Box(100, 100, 50, 80))
    assert detector.detect(image) == first


def test_class_names_come_from_the_call_the_file_or_the_number(tmp_path: Path) -> None:
    named = red_detector(tmp_path / "named.onnx", names="{0: 'boat', 1: 'car'}")
    assert OnnxDetector(named).class_names == ("boat", "car")
    assert OnnxDetector(named, class_names=["a", "b"]).class_names == ("a", "b")
    plain = red_detector(tmp_path / "plain.onnx", names="rubbish(")
    assert OnnxDetector(plain).class_names == ("class 0", "class 1")
    assert choose_class_names(80, None, {}) == COCO_CLASSES
    assert choose_class_names(20, None, {}) == VOC_CLASSES
    assert COCO_CLASSES[0] == VOC_CLASSES[14] == "person"
    with pytest.raises(ValueError, match="3 class names were given for 2 classes"):
        OnnxDetector(named, class_names=["a", "b", "c"])


def test_a_network_of_another_kind_is_one_line_with_the_file_name(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.onnx: no such network.*pull"):
        OnnxDetector(tmp_path / "gone.onnx")
    with pytest.raises(ModelError, match=r"red\.onnx: not a detector of the family yolox: input"):
        OnnxDetector(red_detector(tmp_path / "red.onnx"), family="yolox")


@pytest.mark.parametrize("shape", [[4], [1, 1, 64, 64], [8, 3, 64, 64]])
def test_what_takes_no_single_image_is_one_line_with_its_inputs(
    tmp_path: Path, shape: list[int]
) -> None:
    tensors = [h.make_tensor_value_info(name, 1, shape) for name in "ab"]
    graph = h.make_graph([h.make_node("Relu", ["a"], ["b"])], "relu", tensors[:1], tensors[1:])
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    (tmp_path / "relu.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(
        ModelError, match=r"^\S*relu\.onnx: not a detector of single images"
    ) as caught:
        OnnxDetector(tmp_path / "relu.onnx")
    assert "\n" not in str(caught.value)


@given(st.floats(20, 900), st.floats(20, 900), st.sampled_from(list(Placement)))
def test_the_view_contains_the_region(width: float, height: float, placement: Placement) -> None:
    region = Box(500, 400, width, height)
    view = InputFormat(placement).view(region, 416, 320)
    assert view.left <= region.left + 1e-6
    assert view.right >= region.right - 1e-6
    assert view.top <= region.top + 1e-6
    assert view.bottom >= region.bottom - 1e-6
    if placement is not Placement.STRETCH:
        assert view.width / view.height == pytest.approx(416 / 320)
    if placement is Placement.CORNER:
        assert (view.left, view.top) == pytest.approx((region.left, region.top))


def test_pixels_are_ordered_and_scaled_as_asked() -> None:
    image = np.zeros((2, 2, 3), np.uint8)
    image[:] = (10, 20, 30)
    tensor = np.empty((1, 3, 2, 2), np.float32)
    InputFormat(Placement.CENTRE, red_first=True, mean=(5, 0, 0), deviation=(2, 4, 5)).write(
        image, tensor
    )
    np.testing.assert_allclose(tensor[0, :, 0, 0], [12.5, 5.0, 2.0])


SEQUENCES = {
    "otb_crossing": {"person"},
    "otb_jogging1": {"person"},
    "uav123_group2_2": {"person"},
    "uav123_car16_1": {"car", "truck", "bus"},
    "uavdt_S0601": {"car", "truck", "bus"},
    "vot_car": {"car", "truck", "bus"},
}


@functools.cache
def real_frames() -> list[tuple[np.ndarray, Box, set[str]]]:
    frames = []
    for name, classes in SEQUENCES.items():
        folder = DATA / "sequences" / name
        truth = np.loadtxt(folder / "groundtruth.txt", delimiter=",")
        for index in np.linspace(0, len(truth) - 1, 5).astype(int):
            if truth[index, 2] > 0:
                image = cv2.imread(str(folder / "img" / f"{index + 1:06d}.jpg"))
                frames.append((image, Box.from_xywh(*truth[index]), classes))
    return frames


@needs_data("weights", "sequences")
@pytest.mark.parametrize(
    ("file", "whole", "zoomed"),
    [
        ("yolox_nano_bi.onnx", 0.45, 0.7),
        ("fastestdet.onnx", 0.3, 0.7),
        ("nanodet_m.onnx", 0.4, 0.6),
        ("yolo11n_int8.onnx", 0.35, 0.65),
    ],
)
def test_real_networks_find_real_targets_and_better_in_a_region(
    file: str, whole: float, zoomed: float
) -> None:
    """Three of the 35 frames below what was measured: other processors round otherwise."""
    detector = OnnxDetector(DATA / "weights" / file, DetectorSettings(min_score=0.2))
    hits = []
    for image, box, classes in real_frames():
        side = max(128.0, 5 * box.scale)
        tries = detector.detect(image), detector.detect(image, Box(box.cx, box.cy, side, side))
        hits.append(
            [
                any(one.box.iou(box) >= 0.5 for one in found if one.class_name in classes)
                for found in tries
            ]
        )
    recall_whole, recall_zoomed = np.mean(hits, axis=0)
    assert recall_whole >= whole
    assert recall_zoomed >= zoomed
    assert recall_zoomed > recall_whole
