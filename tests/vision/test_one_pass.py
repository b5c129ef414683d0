"""One-pass evaluation: measures, curves, starts and the loading of sequences."""

import importlib.util
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_vision.evaluation.datasets import DatasetError, load_dataset
from follower_vision.evaluation.metrics import (
    OpeScore,
    mean_score,
    ope_curves,
    ope_score,
    spatial_starts,
    temporal_starts,
)
from follower_vision.geometry.box import Box

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT.parent / "shared" / "tools" / "ope_reference.py"
SQUARE = Box(50.0, 50.0, 10.0, 10.0)


def random_boxes(rng, count):
    """Boxes about a common place, some of them missing."""
    boxes = []
    for _ in range(count):
        x, y = rng.uniform(0, 40, 2)
        w, h = rng.uniform(5, 60, 2)
        boxes.append(None if rng.random() < 0.1 else Box.from_xywh(x, y, w, h))
    return boxes


@pytest.mark.skipif(not REFERENCE.exists(), reason="no reference scores in ../shared/tools")
@pytest.mark.parametrize("seed", range(20))
def test_measures_agree_with_the_independent_reference(seed):
    spec = importlib.util.spec_from_file_location("ope_reference", REFERENCE)
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    rng = np.random.default_rng(seed)
    boxes, truth = random_boxes(rng, 200), random_boxes(rng, 200)
    expected = reference.score(
        [box.xywh if box else None for box in boxes],
        [box.xywh if box else (0, 0, 0, 0) for box in truth],
    )
    score = ope_score(boxes, truth)
    assert score.success == pytest.approx(expected["success"], abs=1e-9)
    assert score.precision == pytest.approx(expected["precision"], abs=1e-9)
    assert score.auc == pytest.approx(expected["auc"], abs=1e-9)
    assert score.frames == expected["frames"]
    curves = ope_curves(boxes, truth)
    assert np.mean(curves.success) == pytest.approx(expected["auc"], abs=1e-9)


def test_perfect_boxes_score_full_marks_but_for_the_threshold_of_one():
    score = ope_score([SQUARE] * 5, [SQUARE] * 5)
    assert score == OpeScore(success=1.0, precision=1.0, auc=pytest.approx(20 / 21), frames=4)


def test_boxes_beside_the_target_have_precision_without_success():
    beside = SQUARE.moved_to(62.0, 50.0)
    assert ope_score([SQUARE, beside], [SQUARE, SQUARE]) == OpeScore(0.0, 1.0, 0.0, 1)


def test_exactly_half_an_overlap_is_no_success_and_exactly_20_px_is_precise():
    half = Box(50.0, 50.0, 10.0, 5.0)
    assert ope_score([SQUARE, half], [SQUARE, SQUARE]).success == 0.0
    assert ope_score([SQUARE, SQUARE.moved_to(70.0, 50.0)], [SQUARE, SQUARE]).precision == 1.0


def test_a_missing_box_is_a_miss_and_an_absent_target_is_not_scored():
    score = ope_score([SQUARE, None, SQUARE, SQUARE], [SQUARE, SQUARE, None, SQUARE])
    assert (score.success, score.precision, score.frames) == (0.5, 0.5, 2)


def test_the_first_frame_is_not_scored():
    far = SQUARE.moved_to(500.0, 500.0)
    assert ope_score([far, SQUARE], [SQUARE, SQUARE]).success == 1.0


def test_what_cannot_be_scored_is_refused():
    with pytest.raises(ValueError, match="2 boxes for 1"):
        ope_score([SQUARE, SQUARE], [SQUARE])
    with pytest.raises(ValueError, match="no frame"):
        ope_score([SQUARE, SQUARE], [SQUARE, None])


def test_sequences_weigh_the_same_in_the_mean_whatever_their_length():
    mean = mean_score([OpeScore(1.0, 1.0, 0.8, 10), OpeScore(0.0, 0.5, 0.2, 990)])
    assert mean == OpeScore(0.5, 0.75, pytest.approx(0.5), 1000)


def test_a_perfect_track_misses_only_the_threshold_one():
    curves = ope_curves([Box(9, 9, 4, 6)] * 3, [Box(9, 9, 4, 6)] * 3)
    assert curves.success == (1.0,) * 20 + (0.0,)
    assert curves.normalised_precision == 1.0
    assert curves.precision[0] == 1.0


def test_a_shift_has_its_closed_form():
    true, shifted = Box(50, 50, 40, 20), Box(60, 50, 40, 20)
    curves = ope_curves([true, shifted], [true, true])
    assert sum(curves.success) == 12  # The overlap is 0.6: thresholds 0 to 0.55 lie below.
    assert (curves.precision[9], curves.precision[10]) == (0.0, 1.0)
    assert curves.normalised_precision == pytest.approx(26 / 51)  # 0.25 of the width


def test_a_missing_box_is_a_miss_at_every_threshold():
    curves = ope_curves([Box(1, 1, 1, 1), None], [Box(1, 1, 1, 1)] * 2)
    assert max(*curves.success, *curves.precision, *curves.normalised) == 0.0


def test_temporal_starts_have_a_box_and_one_to_score():
    box = Box(5, 5, 2, 2)
    truth = [box, None, None, None, box, box, None, box]
    assert temporal_starts(truth, 4) == [0, 4]
    assert temporal_starts(truth, 10**12) == temporal_starts(truth, len(truth))


def test_the_twelve_spatial_starts():
    starts = spatial_starts(Box(50, 50, 40, 20))
    assert len(set(starts)) == 12
    assert {round(start.cx) for start in starts} == {46, 50, 54}
    assert [round(start.width) for start in starts[8:]] == [32, 36, 44, 48]


def make_sequence(folder, lines, images=3):
    (folder / "img").mkdir(parents=True)
    for number in range(images):
        image = np.full((20, 30, 3), number, np.uint8)
        cv2.imwrite(str(folder / "img" / f"{number + 1:06d}.png"), image)
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    return folder


def test_a_folder_is_loaded_in_order_with_absent_frames(tmp_path):
    folder = make_sequence(tmp_path / "walk", ["1,2,3,4", "0,0,0,0", "3,2,3,4"])
    (sequence,), _ = load_dataset(folder)
    assert sequence.name == "walk"
    assert sequence.truth == (Box.from_xywh(1, 2, 3, 4), None, Box.from_xywh(3, 2, 3, 4))
    assert [int(image[0, 0, 0]) for image in sequence.frames()] == [0, 1, 2]


def test_unusable_folders_are_refused(tmp_path):
    _, short = load_dataset(make_sequence(tmp_path / "short", ["1,2,3,4", "1,2,3,4"]))
    assert "2 boxes for 3 images" in short[0]
    _, absent = load_dataset(make_sequence(tmp_path / "absent", ["0,0,0,0"] * 3))
    assert "a box in the first" in absent[0]
    with pytest.raises(DatasetError, match="nowhere"):
        load_dataset(tmp_path / "nowhere")


def test_names_that_are_no_utf_8_can_be_read(tmp_path):
    named = make_sequence(tmp_path / "walk", ["1,2,3,4"] * 3)
    folder = named.rename(tmp_path / os.fsdecode(b"caf\xe9"))
    (sequence,), _ = load_dataset(folder)
    assert [int(image[0, 0, 0]) for image in sequence.frames()] == [0, 1, 2]


def test_a_broken_image_is_an_error_that_names_it(tmp_path):
    folder = make_sequence(tmp_path / "walk", ["1,2,3,4"] * 3)
    (folder / "img" / "000002.png").write_bytes(b"not an image")
    with pytest.raises(OSError, match=r"000002\.png"):
        list(load_dataset(folder)[0][0].frames())
