"""Each family's decoder gives back the boxes that were written into a network's answer."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.detection.detection import Candidates, NetworkLayout, sigmoid, softmax
from follower_vision.detection.families import (
    COCO_ANCHORS,
    FAMILIES,
    VOC_ANCHORS,
    YoloV2Decoder,
    make_decoder,
)

HEIGHT, WIDTH, CLASSES = 256, 320, 7
cxs, cys = st.floats(24, WIDTH - 24), st.floats(24, HEIGHT - 24)
sizes = st.floats(6, 90)
class_ids = st.integers(0, CLASSES - 1)


def layout(*shapes: tuple[int, ...], names: tuple[str, ...] = (), head: str = "") -> NetworkLayout:
    labels = names or tuple(f"out{index}" for index in range(len(shapes)))
    return NetworkLayout(HEIGHT, WIDTH, tuple(zip(labels, shapes, strict=True)), head=head)


def cells(stride: int) -> int:
    return math.ceil(HEIGHT / stride) * math.ceil(WIDTH / stride)


def logit(share: float) -> float:
    return math.log(share / (1 - share))


def check(
    found: Candidates, cx: float, cy: float, w: float, h: float, number: int, score: float
) -> None:
    corners = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2]
    np.testing.assert_allclose(found.corners, [corners], atol=0.02)
    assert found.classes.tolist() == [number]
    assert found.scores == pytest.approx([score])


@given(cxs, cys, sizes, sizes, class_ids, st.sampled_from([0, 1, 2]))
def test_yolox(cx: float, cy: float, w: float, h: float, number: int, level: int) -> None:
    strides = (8, 16, 32)
    total = sum(map(cells, strides))
    answer = np.zeros((1, total, 5 + CLASSES), np.float32)
    stride, before = strides[level], sum(map(cells, strides[:level]))
    column, row = int(cx / stride), int(cy / stride)
    at = before + row * (WIDTH // stride) + column
    box = [cx / stride - column, cy / stride - row, math.log(w / stride), math.log(h / stride)]
    answer[0, at, :5] = [*box, 0.8]
    answer[0, at, 5 + number] = 0.5
    decoder = make_decoder(layout(answer.shape))
    assert decoder.classes == CLASSES
    check(decoder.decode([answer], 0.3), cx, cy, w, h, number, 0.4)
    assert len(decoder.decode([answer], 0.41).scores) == 0


@given(cxs, cys, sizes, sizes, class_ids)
def test_yolov8(cx: float, cy: float, w: float, h: float, number: int) -> None:
    answer = np.zeros((1, 4 + CLASSES, sum(map(cells, (8, 16, 32)))), np.float32)
    answer[0, :4, 99] = [cx, cy, w, h]
    answer[0, 4 + number, 99] = 0.6
    decoder = make_decoder(layout(answer.shape))
    assert decoder.classes == CLASSES
    check(decoder.decode([answer], 0.5), cx, cy, w, h, number, 0.6)


@given(cxs, cys, sizes, sizes, class_ids, st.sampled_from([(8, 16, 32), (8, 16, 32, 64)]))
def test_yolov5(
    cx: float, cy: float, w: float, h: float, number: int, strides: tuple[int, ...]
) -> None:
    answer = np.zeros((1, 3 * sum(map(cells, strides)), 5 + CLASSES), np.float32)
    answer[0, 99, :5] = [cx, cy, w, h, 0.8]
    answer[0, 99, 5 + number] = 0.5
    decoder = make_decoder(layout(answer.shape))
    assert decoder.classes == CLASSES
    check(decoder.decode([answer], 0.3), cx, cy, w, h, number, 0.4)
    assert len(decoder.decode([answer], 0.41).scores) == 0


@given(cxs, cys, sizes, sizes, class_ids)
def test_yolo_end_to_end(cx: float, cy: float, w: float, h: float, number: int) -> None:
    answer = np.zeros((1, 300, 6), np.float32)
    answer[0, 7] = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2, 0.6, number]
    answer[0, 8] = [cx, cy, cx + w, cy + h, 0.7, math.nan]
    answer[0, 9] = [cx, cy, cx + w, cy + h, math.nan, number]
    check(make_decoder(layout(answer.shape)).decode([answer], 0.5), cx, cy, w, h, number, 0.6)


@given(cxs, cys, sizes, sizes, class_ids, st.booleans())
def test_rtdetr(cx: float, cy: float, w: float, h: float, number: int, boxes_first: bool) -> None:
    logits = np.full((1, 300, CLASSES), -9.0, np.float32)
    boxes = np.zeros((1, 300, 4), np.float32)
    boxes[0, 7] = [cx / WIDTH, cy / HEIGHT, w / WIDTH, h / HEIGHT]
    logits[0, 7, number] = logit(0.6)
    outputs, names = [logits, boxes], ("logits", "pred_boxes")
    if boxes_first:
        outputs, names = outputs[::-1], ("boxes", "logits")
    decoder = make_decoder(layout(*(one.shape for one in outputs), names=names))
    assert decoder.classes == CLASSES
    check(decoder.decode(outputs, 0.5), cx, cy, w, h, number, 0.6)


@given(cxs, cys, sizes, sizes, class_ids)
def test_rtdetr_of_ultralytics(cx: float, cy: float, w: float, h: float, number: int) -> None:
    """Read as an end-to-end YOLO, its boxes would all be a pixel in the corner."""
    answer = np.zeros((1, 300, 6), np.float32)
    answer[0, 7] = [cx / WIDTH, cy / HEIGHT, w / WIDTH, h / HEIGHT, 0.6, number]
    found = make_decoder(layout(answer.shape, head="RTDETRDecoder")).decode([answer], 0.5)
    check(found, cx, cy, w, h, number, 0.6)


@given(cxs, cys, sizes, sizes, class_ids)
def test_detr_deploy(cx: float, cy: float, w: float, h: float, number: int) -> None:
    labels, scores = np.zeros((1, 300), np.int64), np.zeros((1, 300), np.float32)
    boxes = np.zeros((1, 300, 4), np.float32)
    boxes[0, 7] = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2]
    labels[0, 7], scores[0, 7] = number, 0.6
    shapes = layout((1, 300), (1, 300, 4), (1, 300), names=("labels", "boxes", "scores"))
    found = make_decoder(shapes).decode([labels, boxes, scores], 0.5)  # type: ignore[list-item]
    check(found, cx, cy, w, h, number, 0.6)


@given(cxs, cys, sizes, sizes, class_ids)
def test_fastestdet(cx: float, cy: float, w: float, h: float, number: int) -> None:
    answer = np.zeros((1, 5 + CLASSES, HEIGHT // 16, WIDTH // 16), np.float32)
    column, row = int(cx / 16), int(cy / 16)
    offset = np.arctanh([cx / 16 - column, cy / 16 - row])
    answer[0, :5, row, column] = [0.9, *offset, logit(w / WIDTH), logit(h / HEIGHT)]
    answer[0, 5 + number, row, column] = 0.5
    decoder = make_decoder(layout(answer.shape))
    assert decoder.classes == CLASSES
    expected = 0.9**0.6 * 0.5**0.4
    check(decoder.decode([answer], 0.5), cx, cy, w, h, number, expected)
    assert len(decoder.decode([answer], expected + 0.01).scores) == 0


@given(cxs, cys, sizes, sizes, class_ids, st.integers(0, 4))
def test_yolov2(cx: float, cy: float, w: float, h: float, number: int, anchor: int) -> None:
    rows, columns = HEIGHT // 32, WIDTH // 32
    answer = np.zeros((1, 5, 5 + CLASSES, rows, columns), np.float32)
    answer[:, :, 4] = -9.0
    column, row = int(cx / 32), int(cy / 32)
    shares = np.clip([cx / 32 - column, cy / 32 - row], 1e-4, 1 - 1e-4)
    size = np.log(np.array([w, h]) / 32 / np.array(COCO_ANCHORS[anchor]))
    answer[0, anchor, :5, row, column] = [*map(logit, shares), *size, logit(0.9)]
    answer[0, anchor, 5 + number, row, column] = 20.0
    answer = answer.reshape(1, -1, rows, columns)
    decoder = make_decoder(layout(answer.shape))
    assert decoder.classes == CLASSES
    check(decoder.decode([answer], 0.5), cx, cy, w, h, number, 0.9)


def test_yolov2_takes_vocs_anchors_for_twenty_classes_and_others_when_given() -> None:
    rows, columns = HEIGHT // 32, WIDTH // 32
    answer = np.full((1, 5 * 25, rows, columns), -9.0, np.float32)
    answer[0, [0, 1, 2, 3, 4], 2, 3] = [0.0, 0.0, 0.0, 0.0, 9.0]
    answer[0, 5 + 6, 2, 3] = 20.0
    plain = YoloV2Decoder(layout(answer.shape)).decode([answer], 0.5)
    score = 1 / (1 + math.exp(-9))
    check(plain, 3.5 * 32, 2.5 * 32, VOC_ANCHORS[0][0] * 32, VOC_ANCHORS[0][1] * 32, 6, score)
    own = YoloV2Decoder(layout(answer.shape), anchors=[(1, 2)] * 5).decode([answer], 0.5)
    check(own, 3.5 * 32, 2.5 * 32, 32, 64, 6, score)


def bins_for(distances: list[float], bins: int = 8) -> np.ndarray:
    """Logits of four distributions whose means are the distances given, in strides."""
    logits = np.full((4, bins), -40.0)
    for row, distance in zip(logits, distances, strict=True):
        low = min(int(distance), bins - 2)
        share = min(max(distance - low, 1e-9), 1 - 1e-9)
        row[low], row[low + 1] = math.log(1 - share), math.log(share)
    return logits.ravel()


@given(cxs, cys, sizes, sizes, class_ids, st.sampled_from(["raw", "sigmoid"]))
def test_nanodet(cx: float, cy: float, w: float, h: float, number: int, scores: str) -> None:
    stride = 32
    column, row = int(cx / stride), int(cy / stride)
    x, y = column * stride + 15.5, row * stride + 15.5
    box = cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2
    # A side must lie on the far side of the cell's point.
    box = min(box[0], x), min(box[1], y), max(box[2], x), max(box[3], y)
    answers = [np.zeros((1, cells(s), CLASSES), np.float32) for s in (8, 16, 32)]
    distances = [np.zeros((1, cells(s), 32), np.float32) for s in (8, 16, 32)]
    if scores == "raw":
        for one in answers:
            one[:] = -9.0
    at = row * (WIDTH // stride) + column
    answers[2][0, at, number] = logit(0.7) if scores == "raw" else 0.7
    answers[0][0, 3] = math.nan
    sides = [(x - box[0]), (y - box[1]), (box[2] - x), (box[3] - y)]
    distances[2][0, at] = bins_for([side / stride for side in sides])
    outputs = answers + distances
    decoder = make_decoder(layout(*(one.shape for one in outputs)))
    assert decoder.classes == CLASSES
    found = decoder.decode(outputs, 0.5)
    np.testing.assert_allclose(found.corners, [box], atol=0.02)
    assert found.classes.tolist() == [number]
    assert found.scores == pytest.approx([0.7], abs=1e-5)


@pytest.mark.parametrize("order", ["pairs", "distances first"])
def test_nanodet_finds_its_outputs_in_any_order(order: str) -> None:
    outputs = []
    for stride in (8, 16, 32):
        scores = np.zeros((1, cells(stride), CLASSES), np.float32)
        scores[0, 3, 5] = 0.9 if stride == 16 else 0.0
        bins = np.zeros((1, cells(stride), 32), np.float32)
        bins[0, 3] = bins_for([1.0, 0.5, 2.0, 0.5])
        pair = [(f"cls_{stride}", scores), (f"dis_{stride}", bins)]
        outputs += pair if order == "pairs" else pair[::-1]
    names, tensors = zip(*outputs, strict=True)
    decoder = make_decoder(layout(*(one.shape for one in tensors), names=names))
    found = decoder.decode(tensors, 0.5)
    assert decoder.classes == CLASSES
    x, y = 3 * 16 + 7.5, 7.5
    np.testing.assert_allclose(found.corners, [[x - 16, y - 8, x + 32, y + 8]], atol=0.01)


def test_nanodet_plus_joins_everything_in_one_output() -> None:
    total = sum(map(cells, (8, 16, 32, 64)))
    answer = np.zeros((1, total, CLASSES + 32), np.float32)
    at = cells(8) + 2 * (WIDTH // 16) + 4
    answer[0, at, 1] = 0.8
    answer[0, at, CLASSES:] = bins_for([1.0, 1.0, 2.0, 0.5])
    found = make_decoder(layout(answer.shape)).decode([answer], 0.5)
    np.testing.assert_allclose(found.corners, [[48, 16, 96, 40]], atol=0.01)
    assert found.classes.tolist() == [1]


SHAPES = {
    "yolox": [(1, sum(map(cells, (8, 16, 32))), 12)],
    "yolov8": [(1, 11, sum(map(cells, (8, 16, 32))))],
    "nanodet": [(1, cells(s), n) for n in (7, 32) for s in (8, 16, 32)],
    "fastestdet": [(1, 12, HEIGHT // 16, WIDTH // 16)],
    "yolov2": [(1, 60, HEIGHT // 32, WIDTH // 32)],
    "yolov5": [(1, 3 * sum(map(cells, (8, 16, 32))), 12)],
    "yolo-end-to-end": [(1, 300, 6)],
    "rtdetr": [(1, 300, 7), (1, 300, 4)],
    "rtdetr-ultralytics": [(1, 300, 6)],
    "detr-deploy": [(1, 300), (1, 300, 4), (1, 300)],
}
NAMES = {"rtdetr": ("logits", "pred_boxes"), "detr-deploy": ("labels", "boxes", "scores")}
HEADS = {"yolo-end-to-end": "v10Detect", "rtdetr-ultralytics": "RTDETRDecoder"}


@pytest.mark.parametrize("family", FAMILIES)
def test_each_family_is_recognised_and_no_other_claims_it(family: str) -> None:
    shapes = layout(*SHAPES[family], names=NAMES.get(family, ()), head=HEADS.get(family, ""))
    assert [name for name, kind in FAMILIES.items() if kind.fits(shapes)] == [family]


@pytest.mark.parametrize("family", FAMILIES)
def test_nothing_seen_is_nothing_found(family: str) -> None:
    answers = [np.full(shape, -30.0, np.float32) for shape in SHAPES[family]]
    shapes = layout(*SHAPES[family], names=NAMES.get(family, ()), head=HEADS.get(family, ""))
    found = make_decoder(shapes).decode(answers, 0.3)
    assert found.corners.shape == (0, 4)
    assert found.scores.shape == found.classes.shape == (0,)


@pytest.mark.parametrize(
    "shapes", [[], [(1, 9)], [(1, 50, 85)], [(1, 300, 38)], [(1, 3, 5, 5)], [(1, 2, 8, 8)] * 2]
)
def test_foreign_networks_are_refused(shapes: list[tuple[int, ...]]) -> None:
    with pytest.raises(ValueError, match="not a detector of the family yolox or ") as caught:
        make_decoder(layout(*shapes))
    assert "\n" not in str(caught.value)
    for name, kind in FAMILIES.items():
        assert f"{name} {kind.layout}" in str(caught.value)


@pytest.mark.parametrize("names", [("dets", "labels"), ("boxes", "scores")])
def test_boxes_of_another_kind_are_not_taken_for_rtdetrs(names: tuple[str, str]) -> None:
    """RF-DETR, and networks with boxes in pixels, have such shapes too."""
    with pytest.raises(ValueError, match=r"outputs \w+ \(1, 300, 4\), \w+ \(1, 300, 7\); what is"):
        make_decoder(layout((1, 300, 4), (1, 300, 7), names=names))


def test_a_family_can_be_set_but_must_fit() -> None:
    with pytest.raises(ValueError, match="no family 'ssd'; there are yolox"):
        make_decoder(layout(*SHAPES["yolox"]), "ssd")
    with pytest.raises(ValueError, match="not a detector of the family yolov8: input 320x256"):
        make_decoder(layout(*SHAPES["yolox"]), "yolov8")
    assert make_decoder(layout(*SHAPES["yolox"]), "yolox").classes == CLASSES


def test_sigmoid_and_softmax_stay_finite() -> None:
    extreme = np.array([-1e4, 0.0, 1e4], np.float32)
    np.testing.assert_allclose(sigmoid(extreme), [0.0, 0.5, 1.0])
    np.testing.assert_allclose(softmax(extreme), [0.0, 0.0, 1.0])
