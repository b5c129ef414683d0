"""Each data set's layout is loaded; what is broken is named."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.datasets import DatasetError, load_dataset


def pictures(folder: Path, number: int = 3) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(number):
        cv2.imwrite(str(folder / f"{index + 1:04}.jpg"), np.zeros((48, 64, 3), np.uint8))


@pytest.mark.parametrize(
    ("images", "truth", "lines"),
    [
        ("img", "groundtruth_rect.txt", "1,2,3,4\n1\t2\t3\t4\n1 2 3 4\n"),
        ("img", "groundtruth.txt", "1,2,3,4\n" * 3),
        ("color", "groundtruth.txt", "1,6,1,2,4,2,4,6\n" * 3),
        (".", "groundtruth.txt", "1.0,2.0,3.0,4.0\n" * 3),
    ],
    ids=["otb", "plain", "vot", "got10k"],
)
def test_a_layout_gives_its_boxes(tmp_path: Path, images: str, truth: str, lines: str) -> None:
    pictures(tmp_path / "one" / images)
    (tmp_path / "one" / truth).write_text(lines)
    for folder in (tmp_path, tmp_path / "one"):
        (sequence,), remarks = load_dataset(folder)
        assert (sequence.name, remarks) == ("one", [])
        assert sequence.truth == (Box.from_xywh(1, 2, 3, 4),) * 3


def test_uav123_pairs_annotations_with_folders(tmp_path: Path) -> None:
    pictures(tmp_path / "data_seq" / "UAV123" / "bike1")
    (tmp_path / "anno" / "UAV123").mkdir(parents=True)
    (tmp_path / "anno" / "UAV123" / "bike1.txt").write_text("1,2,3,4\nNaN,NaN,NaN,NaN\n1,2,3,4\n")
    (sequence,), _ = load_dataset(tmp_path)
    assert [box is None for box in sequence.truth] == [False, True, False]


def test_a_slanted_polygon_gives_the_box_around_it(tmp_path: Path) -> None:
    pictures(tmp_path / "color")
    (tmp_path / "groundtruth.txt").write_text("10,0,20,10,10,20,0,10\n" * 3)
    (sequence,), _ = load_dataset(tmp_path)
    assert sequence.initial == Box.from_xywh(0, 0, 20, 20)


def test_absence_is_read_from_zeros_and_from_labels(tmp_path: Path) -> None:
    pictures(tmp_path, 4)
    (tmp_path / "groundtruth.txt").write_text("1,2,3,4\n0,0,0,0\n1,2,3,4\n1,2,3,4\n")
    (tmp_path / "absence.label").write_text("0\n0\n1\n0\n")
    (sequence,), _ = load_dataset(tmp_path)
    assert [box is None for box in sequence.truth] == [False, True, True, False]


@pytest.mark.parametrize("lines", ["1,2,3,4\n", "1,2,3\n" * 3, "a,b,c,d\n" * 3, "0,0,0,0\n" * 3])
def test_a_broken_sequence_is_skipped_by_name(tmp_path: Path, lines: str) -> None:
    for name, text in (("bad", lines), ("good", "1,2,3,4\n" * 3)):
        pictures(tmp_path / name / "img")
        (tmp_path / name / "groundtruth.txt").write_text(text)
    (sequence,), (remark,) = load_dataset(tmp_path)
    assert sequence.name == "good"
    assert "bad" in remark


def test_no_sequence_is_an_error_in_one_line(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DatasetError) as caught:
            load_dataset(folder)
        assert "\n" not in str(caught.value)
