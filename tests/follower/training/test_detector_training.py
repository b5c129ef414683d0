"""A detector's training: what it is told, that it learns, and that its file answers alike."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import torch
from program import output_of

from follower.training.detector import run
from follower.training.detector.labelled_image import IGNORED, LabelledImage, mirrored
from follower.training.detector.loss import (
    RegionLoss,
    find_anchors,
    giou,
    make_labels,
    shape_iou,
)
from follower.training.detector.network import state_of_onnx
from follower.training.detector.random_scene import RenderedPictures, cut_view, whole_view
from follower.training.detector.run import export_detector, measure_files, try_eight_bit
from follower.training.detector.settings import DetectorConfig, DetectorTraining
from follower.training.detector.trainer import (
    DetectorTrainer,
    as_tensor,
    average_precision,
    mean_average_precision,
)
from follower.training.onnx_export import AGREEMENT
from follower.training.trainer import save_checkpoint
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import OnnxDetector
from follower_vision.detection.detection import Candidates
from follower_vision.geometry.box import Box
from follower_vision.onnx_network import ModelError

pytestmark = pytest.mark.slow

CPU = torch.device("cpu")
SIDE = 96
SMALL = DetectorTraining(
    side_px=SIDE,
    channels=(8, 8, 16, 16, 32),
    steps=250,
    batch=8,
    learning_rate=6e-3,
    warmup_steps=10,
    average=0.9,
)
ANCHORS = np.array([[0.5, 0.5], [0.7, 0.7], [0.9, 0.9], [1.1, 1.1], [1.3, 1.3]])


class Squares:
    """Red and blue squares on grey noise."""

    class_names = ("red", "blue")

    def training(self, side: int, seed: int) -> Iterator[LabelledImage]:
        rng = np.random.default_rng(seed)
        while True:
            yield square(side, rng)

    def held_out(self, side: int, count: int) -> list[LabelledImage]:
        rng = np.random.default_rng([1, 1])
        return [square(side, rng) for _ in range(count)]


def square(side: int, rng: np.random.Generator) -> LabelledImage:
    image = rng.integers(90, 130, (side, side, 3)).astype(np.uint8)
    size, kind = int(rng.integers(18, 40)), int(rng.integers(2))
    left, top = (int(value) for value in rng.integers(0, side - size, 2))
    image[top : top + size, left : left + size] = (20, 20, 230) if kind == 0 else (230, 20, 20)
    boxes = np.array([[left, top, left + size, top + size]], np.float32)
    return LabelledImage(image, boxes, np.array([kind], np.intp))


def labelled(boxes: list[list[float]], classes: list[int]) -> LabelledImage:
    corners = np.array(boxes, np.float32).reshape(-1, 4)
    return LabelledImage(np.zeros((96, 96, 3), np.uint8), corners, np.array(classes, np.intp))


def candidates(boxes: list[list[float]], scores: list[float]) -> Candidates:
    corners = np.array(boxes, np.float32).reshape(-1, 4)
    return Candidates(corners, np.array(scores, np.float32), np.zeros(len(scores), np.intp))


def test_anchors_are_the_middles_of_the_clusters_of_sizes() -> None:
    rng = np.random.default_rng(0)
    middles = np.array([[0.5, 1.0], [2.0, 1.0], [4.0, 5.0]])
    sizes = np.vstack([middle * np.exp(rng.normal(0, 0.03, (40, 2))) for middle in middles])
    anchors = find_anchors(sizes, 3, 2)
    np.testing.assert_allclose(anchors, middles, rtol=0.05)


def test_too_few_sizes_for_the_anchors_are_refused() -> None:
    with pytest.raises(SettingsError, match="not 2"):
        find_anchors(np.array([[1.0, 1.0], [1.0, 1.0], [2.0, 1.0]]), 3, 0)


def test_the_overlap_of_shapes_is_that_of_boxes_about_one_centre() -> None:
    assert shape_iou(np.array([[2.0, 1.0]]), np.array([[1.0, 1.0]]))[0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("hits", "objects", "expected"),
    [
        ([True, True], 2, 1.0),
        ([], 3, 0.0),
        ([False, False], 1, 0.0),
        ([True, False, True], 2, 0.5 + 0.5 * 2 / 3),
        ([False, True], 2, 0.5 * 0.5),
    ],
)
def test_average_precision_in_closed_form(hits: list[bool], objects: int, expected: float) -> None:
    assert average_precision(np.array(hits, bool), objects) == pytest.approx(expected)


def test_a_second_box_on_an_object_is_a_false_alarm_and_one_on_an_ignored_is_not() -> None:
    truth = labelled([[0, 0, 20, 20], [50, 50, 80, 80]], [0, IGNORED])
    on_both = candidates([[0, 0, 20, 20], [50, 50, 80, 80]], [0.6, 0.9])
    assert mean_average_precision([on_both], [truth], 1).mean == pytest.approx(1.0)
    twice = candidates([[0, 0, 20, 20], [1, 0, 21, 20]], [0.6, 0.9])
    assert mean_average_precision([twice], [truth], 1).mean == pytest.approx(1.0)
    wrong_first = candidates([[60, 0, 90, 20], [0, 0, 20, 20]], [0.9, 0.6])
    assert mean_average_precision([wrong_first], [truth], 1).mean == pytest.approx(0.5)


def test_a_class_that_does_not_occur_has_no_precision() -> None:
    measured = mean_average_precision([candidates([], [])], [labelled([[0, 0, 9, 9]], [0])], 2)
    assert measured.of_class == (0.0, None)
    assert measured.objects == (1, 0)


def test_the_generalised_overlap_in_closed_form() -> None:
    boxes = torch.tensor([[0.0, 0.0, 1.0, 1.0]] * 3)
    others = torch.tensor([[0.0, 0.0, 1.0, 1.0], [2.0, 0.0, 3.0, 1.0], [0.0, 0.0, 2.0, 1.0]])
    assert giou(boxes, others).tolist() == pytest.approx([1.0, -1 / 3, 0.5])


def test_the_loss_of_a_right_answer_is_nearly_zero_and_of_a_shifted_one_is_not() -> None:
    picture = labelled([[32 + 8, 8, 32 + 24, 24]], [1])  # fits the first anchor in cell (0, 1)
    labels = make_labels([picture], ANCHORS, CPU)
    answer = torch.zeros(1, 5, 7, 3, 3)
    answer[:, :, 4] = -12
    for anchor in labels.places[1].tolist():
        answer[0, anchor, 4:, 0, 1] = torch.tensor([12.0, -12.0, 12.0])
        answer[0, anchor, 2:4, 0, 1] = torch.log(torch.tensor(0.5 / ANCHORS[anchor, 0]))
    loss = RegionLoss(torch.tensor(ANCHORS, dtype=torch.float32), 1.0, 1.0)
    assert float(loss(answer.flatten(1, 2), labels)) < 1e-3
    answer[:, :, 0] = 3
    assert float(loss(answer.flatten(1, 2), labels)) > 0.3


def test_nobody_says_that_an_ignored_place_is_empty() -> None:
    loss = RegionLoss(torch.tensor(ANCHORS, dtype=torch.float32), 1.0, 1.0)
    sure = torch.full((1, 35, 3, 3), -30.0)
    sure.view(1, 5, 7, 3, 3)[:, :, 4, 1, 1] = 5.0
    ignored = make_labels([labelled([[33, 33, 63, 63]], [IGNORED])], ANCHORS, CPU)
    nothing = make_labels([labelled([], [])], ANCHORS, CPU)
    assert float(loss(sure, ignored)) < 1e-3
    assert float(loss(sure, nothing)) > 5


@pytest.fixture(scope="module")
def trained() -> DetectorTrainer:
    """A network that has learnt squares for some seconds."""
    trainer = DetectorTrainer(SMALL, Squares(), ANCHORS, 1, CPU)
    while trainer.step_number < SMALL.steps:
        trainer.train_step()
    return trainer


def test_a_tiny_run_learns_to_find_squares(trained: DetectorTrainer) -> None:
    measured = trained.measure(Squares().held_out(SIDE, 40))
    assert measured.mean is not None
    assert measured.mean > 0.7


def test_the_exported_file_answers_as_the_network_does_and_detects(
    trained: DetectorTrainer, tmp_path: Path
) -> None:
    exported = export_detector(trained, tmp_path / "squares.onnx")
    assert exported.difference < AGREEMENT
    path = exported.path
    detector = OnnxDetector(path)
    assert detector.class_names == ("red", "blue")
    right = [_best_is_right(detector, picture) for picture in Squares().held_out(SIDE, 12)]
    assert sum(right) >= 7


def test_in_eight_bits_it_finds_as_much_and_says_what_it_is(
    trained: DetectorTrainer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "measure_files", lambda *_: [(0.6, 2.0), (0.6, 1.0)])
    path, small = _exported(trained, tmp_path / "squares.onnx"), tmp_path / "squares-int8.onnx"
    stream = Squares().training(SIDE, 3)
    try_eight_bit(path, [next(stream) for _ in range(20)], trained)
    whole, eight_bit = measure_files([path, small], trained, Squares().held_out(SIDE, 30))
    assert eight_bit[0] > whole[0] - 0.1 > 0
    assert OnnxDetector(small).class_names == ("red", "blue")
    assert small.stat().st_size < 0.8 * path.stat().st_size


@pytest.mark.parametrize(
    ("eight_bit", "kept"), [((0.599, 1.0), True), ((0.59, 1.0), False), ((0.61, 2.1), False)]
)
def test_eight_bits_are_kept_only_where_they_are_faster_at_no_loss(
    trained: DetectorTrainer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    eight_bit: tuple[float, float],
    kept: bool,
) -> None:
    monkeypatch.setattr(run, "measure_files", lambda *_: [(0.6, 2.0), eight_bit])
    path = _exported(trained, tmp_path / "squares.onnx")
    try_eight_bit(path, Squares().held_out(SIDE, 2), trained)
    assert (tmp_path / "squares-int8.onnx").exists() == kept


def _best_is_right(detector: OnnxDetector, picture: LabelledImage) -> bool:
    left, top, right, bottom = picture.boxes[0].tolist()
    true = Box.from_xywh(left, top, right - left, bottom - top)
    found = detector.detect(picture.image)
    return bool(found) and found[0].box.iou(true) > 0.5 and found[0].class_id == picture.classes[0]


def test_a_resumed_training_goes_on_where_it_stopped(trained: DetectorTrainer) -> None:
    again = DetectorTrainer(SMALL, Squares(), ANCHORS, 7, CPU)
    again.restore(trained.state())
    picture = as_tensor(Squares().held_out(SIDE, 1), CPU)
    assert torch.equal(again.averaged(picture), trained.averaged(picture))
    assert again.step_number == trained.step_number
    assert again.learning_rate == trained.learning_rate


def test_a_state_of_other_classes_is_refused(trained: DetectorTrainer) -> None:
    state = trained.state() | {"classes": ["red", "green"]}
    with pytest.raises(SettingsError, match="other classes"):
        DetectorTrainer(SMALL, Squares(), ANCHORS, 1, CPU).restore(state)


def _exported(trained: DetectorTrainer, path: Path) -> Path:
    return export_detector(trained, path).path


def test_a_training_begun_with_an_exported_network_answers_as_it_does_and_goes_on_learning(
    trained: DetectorTrainer, tmp_path: Path
) -> None:
    path, held_out = _exported(trained, tmp_path / "squares.onnx"), Squares().held_out(SIDE, 32)
    state = state_of_onnx(path, SMALL, ("red", "blue"), as_tensor(held_out, CPU))
    again = DetectorTrainer(SMALL, Squares(), np.array(state["anchors"]), 7, CPU)
    again.begin_with(state, "squares.onnx")
    expected = list(trained.answers(held_out))
    np.testing.assert_allclose(list(again.answers(held_out)), expected, atol=1e-3)
    # In training a normalisation takes mean and variance from the batch: it has to fit them, or
    # all that was learnt is lost in the first step.
    original = DetectorTrainer(SMALL, Squares(), ANCHORS, 1, CPU)
    original.restore(trained.state())
    assert again.learn(held_out) < 1.5 * original.learn(held_out)


def test_a_network_of_other_classes_or_layers_or_another_tool_begins_no_training(
    trained: DetectorTrainer, tmp_path: Path
) -> None:
    path, pictures = _exported(trained, tmp_path / "squares.onnx"), torch.zeros(2, 3, SIDE, SIDE)
    with pytest.raises(SettingsError, match=r"squares\.onnx: it finds \['red', 'blue'\]"):
        state_of_onnx(path, SMALL, ("boat",), pictures)
    wider = replace(SMALL, channels=(8, 8, 16, 16, 64))
    with pytest.raises(SettingsError, match="its layers are not those of channels"):
        state_of_onnx(path, wider, ("red", "blue"), pictures)
    model = onnx.load(path)
    del model.metadata_props[:]
    onnx.save(model, path)
    with pytest.raises(SettingsError, match="no network that `follower train detector` has"):
        state_of_onnx(path, SMALL, ("red", "blue"), pictures)
    path.write_bytes(b"no network")
    with pytest.raises(ModelError, match=r"squares\.onnx"):
        state_of_onnx(path, SMALL, ("red", "blue"), pictures)


def test_no_training_begins_with_another_kind_of_network(tmp_path: Path) -> None:
    data = _own_pictures(tmp_path / "mine")
    save_checkpoint(tmp_path, {"kind": "re3"})
    config = DetectorConfig(data=data, training=SMALL)
    with pytest.raises(SettingsError, match="this is no training of a detector"):
        run.train_detector(config, tmp_path / "out", CPU, start=tmp_path)


def test_a_training_that_cannot_begin_leaves_an_earlier_ones_recipe(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("the earlier one's")
    with pytest.raises(SettingsError, match="no such folder"):
        run.train_detector(DetectorConfig(data=tmp_path / "mistyped"), tmp_path, CPU)
    assert (tmp_path / "config.yaml").read_text() == "the earlier one's"


def _own_pictures(folder: Path) -> Path:
    folder.mkdir()
    (folder / "data.yaml").write_text("names: [red, blue]")
    rng = np.random.default_rng(0)
    for number in range(8):
        picture = square(120, rng)
        cv2.imwrite(str(folder / f"{number}.png"), picture.image)
        left, top, right, bottom = (picture.boxes[0] / 120).tolist()
        line = f"{picture.classes[0]} {(left + right) / 2} {(top + bottom) / 2} "
        (folder / f"{number}.txt").write_text(line + f"{right - left} {bottom - top}\n")
    return folder


def test_a_mirrored_picture_is_the_same_after_mirroring_it_again() -> None:
    picture = square(SIDE, np.random.default_rng(3))
    once, twice = mirrored(picture), mirrored(mirrored(picture))
    assert np.array_equal(twice.image, picture.image)
    np.testing.assert_allclose(twice.boxes, picture.boxes)
    left, top, right, bottom = once.boxes[0].astype(int).tolist()
    inside = once.image[top:bottom, left:right].reshape(-1, 3)
    assert (inside == inside[0]).all()


def test_a_view_keeps_the_boxes_on_what_they_show() -> None:
    image = np.full((120, 160, 3), 100, np.uint8)
    image[40:70, 90:130] = (0, 0, 255)
    picture = LabelledImage(image, np.array([[90, 40, 130, 70]], np.float32), np.array([0]))
    for view in (whole_view(picture, SIDE), cut_view(picture, Box(110, 50, 64, 64), SIDE)):
        left, top, right, bottom = view.boxes[0]
        red = np.argwhere(view.image[..., 2] > 180)
        assert red.min(axis=0) == pytest.approx((top, left), abs=1.5)
        assert red.max(axis=0) + 1 == pytest.approx((bottom, right), abs=1.5)


def test_what_the_edge_of_a_view_cuts_in_two_is_ignored_below_one_half() -> None:
    image = np.zeros((100, 100, 3), np.uint8)
    picture = LabelledImage(image, np.array([[40, 40, 60, 60]], np.float32), np.array([0]))
    mostly = cut_view(picture, Box(77, 50, 60, 60), SIDE)  # from 47 on
    hardly = cut_view(picture, Box(83, 50, 60, 60), SIDE)  # from 53 on
    gone = cut_view(picture, Box(95, 50, 60, 60), SIDE)
    assert (mostly.classes.tolist(), hardly.classes.tolist()) == ([0], [IGNORED])
    assert len(gone.classes) == 0


def test_rendered_pictures_come_from_the_seed_and_their_boxes_lie_inside() -> None:
    pictures = RenderedPictures(160, 120, pictures_a_world=3, views_a_picture=3, mixed=4)
    streams = [pictures.training(SIDE, seed) for seed in (5, 5, 6)]
    some = [[next(stream) for _ in range(6)] for stream in streams]
    for one, same, other in zip(*some, strict=True):
        assert np.array_equal(one.image, same.image)
        assert np.array_equal(one.boxes, same.boxes)
        assert not np.array_equal(one.image, other.image)
        assert (one.boxes >= 0).all()
        assert (one.boxes <= SIDE).all()
        assert (one.boxes[:, 2:] > one.boxes[:, :2]).all()
    assert any((one.classes != IGNORED).any() for one in some[0])


def test_the_command_trains_on_a_folder_resumes_and_leaves_all_that_it_promises(
    tmp_path: Path,
) -> None:
    data = _own_pictures(tmp_path / "mine")
    sizes = "training={side_px: 96, channels: [8, 8, 8, 8, 16], steps: 3, batch: 2, save_every: 1}"
    words = ["train", "detector", "--data", str(data), "--out", str(tmp_path), "--device", "cpu"]
    output_of(*words, "--set", "name=mine", "--set", sizes, "--set", "licence=CC0-1.0")
    folder = tmp_path / "mine"
    names = ("samples.png", "detections.png", "log.csv", "mine.onnx", "mine.md", "checkpoint.pt")
    assert all((folder / name).is_file() for name in names)
    card = (folder / "mine.md").read_text()
    assert "mAP@0.5" in card
    assert "CC0-1.0" in card
    assert OnnxDetector(folder / "mine.onnx").class_names == ("red", "blue")
    config = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text(config.replace("steps: 3\n", "steps: 5\n"))
    begun = ["--set", "name=begun", "--start", str(folder / "mine.onnx"), "--set", sizes]
    output_of(*words, *begun)
    assert OnnxDetector(tmp_path / "begun" / "begun.onnx").class_names == ("red", "blue")
    begun_card = tmp_path / "begun" / "begun.md"
    assert "that of its pictures" in begun_card.read_text()
    output_of("train", "detector", "--resume", str(begun_card.parent))
    assert f"begun with the weights of | `{folder / 'mine.onnx'}`" in begun_card.read_text()
    assert "begun with" not in card
    output_of("train", "detector", "--resume", str(folder))
    steps = [row.split(",")[0] for row in (folder / "log.csv").read_text().splitlines()]
    assert steps == ["step", "1", "2", "3", "4", "5"]
