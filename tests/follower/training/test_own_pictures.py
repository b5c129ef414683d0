"""Folders of the user's own pictures, in YOLO's and COCO's form, good and broken."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from follower.training.detector.dataset import (
    FolderPictures,
    coco_files,
    is_held_out,
    read_coco,
    read_yolo,
)
from follower.training.detector.labelled_image import IGNORED
from follower.training.detector.settings import FolderSettings
from follower_control.common.strict_config import SettingsError


def picture(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((40, 80, 3), 120, np.uint8))


def yolo(folder: Path, line: str = "1 0.5 0.5 0.25 0.5") -> Path:
    (folder / "data.yaml").write_text("names: {0: car, 1: drone}")
    for part in ("train", "val"):
        picture(folder / "images" / part / "one.png")
        labels = folder / "labels" / part / "one.txt"
        labels.parent.mkdir(parents=True)
        labels.write_text(f"0 0.2 0.2 0.1 0.1\n{line}\n" if part == "train" else "")
    return folder


def coco(folder: Path, **changes: Any) -> Path:
    picture(folder / "images" / "a.png")
    picture(folder / "images" / "b.png")
    data = {
        "images": [{"id": 7, "file_name": "a.png"}, {"id": 9, "file_name": "b.png"}],
        "categories": [{"id": 4, "name": "drone"}, {"id": 2, "name": "car"}],
        "annotations": [
            {"image_id": 7, "category_id": 4, "bbox": [10, 5, 20, 10]},
            {"image_id": 9, "category_id": 2, "bbox": [0, 0, 8, 8], "iscrowd": 1},
        ],
    }
    (folder / "labels.json").write_text(json.dumps(data | changes))
    return folder


def test_yolos_shares_become_pixels_and_its_folders_part_the_pictures(tmp_path: Path) -> None:
    names, (learnt, held_out) = read_yolo(yolo(tmp_path))
    assert names == ("car", "drone")
    assert learnt.path.parent.name == "train"
    assert (learnt.held_out, held_out.held_out) == (False, True)
    assert held_out.classes == ()
    loaded = learnt.load()
    np.testing.assert_allclose(loaded.boxes, [[12, 6, 20, 10], [30, 10, 50, 30]], atol=1e-4)
    assert loaded.classes.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("path", "held_out"),
    [
        ("images/train/test_flight.jpg", False),
        ("train/val_di_fassa.jpg", False),
        ("images/val2017/train_1.jpg", True),
        ("test_3.jpg", True),
        ("images/1.jpg", False),
    ],
)
def test_a_folder_named_train_counts_before_a_pictures_own_name(path: str, held_out: bool) -> None:
    assert is_held_out(Path(path)) == held_out


def test_the_folders_of_one_coco_files_pictures_part_them(tmp_path: Path) -> None:
    for part in ("train", "val"):
        picture(tmp_path / part / "a.png")
    images = [{"id": 7, "file_name": "train/a.png"}, {"id": 9, "file_name": "val/a.png"}]
    _, entries = read_coco(coco(tmp_path, images=images))
    assert [one.held_out for one in entries] == [False, True]


def test_names_may_stand_in_a_text_file_and_labels_beside_the_pictures(tmp_path: Path) -> None:
    picture(tmp_path / "one.jpg")
    (tmp_path / "one.txt").write_text("0 0.5 0.5 1 1")
    (tmp_path / "classes.txt").write_text("rover\n\n")
    names, (entry,) = read_yolo(tmp_path)
    assert names == ("rover",)
    assert entry.load().boxes.tolist() == [[0, 0, 80, 40]]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("drone 0.5 0.5 0.2 0.2", "line 2: expected `class"),
        ("1 0.5 0.5 0.2", "line 2: expected `class"),
        ("2 0.5 0.5 0.2 0.2", "line 2: class 2, but there are 2 names"),
        ("1 0.5 0.5 0 0.2", "line 2: a box has a positive width"),
        ("1 40 20 20 10", "line 2: the box reaches beyond the picture"),
        ("1 nan 0.5 0.2 0.2", "line 2: the box reaches beyond the picture"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message) as caught:
        read_yolo(yolo(tmp_path, line))
    assert "one.txt" in str(caught.value)


def test_a_yolo_folder_without_names_pictures_or_labels_says_what_is_missing(
    tmp_path: Path,
) -> None:
    with pytest.raises(SettingsError, match=r"write data\.yaml"):
        read_yolo(tmp_path)
    (tmp_path / "data.yaml").write_text("names: [car]")
    with pytest.raises(SettingsError, match="no pictures"):
        read_yolo(tmp_path)
    picture(tmp_path / "images" / "one.png")
    with pytest.raises(SettingsError, match=r"labels/one\.txt"):
        read_yolo(tmp_path)


@pytest.mark.parametrize("file", ["classes.txt", "labels/train/one.txt"])
def test_text_that_is_no_utf_8_is_named(tmp_path: Path, file: str) -> None:
    (yolo(tmp_path) / "data.yaml").unlink()
    (tmp_path / "classes.txt").write_text("car\ndrone\n")
    (tmp_path / file).write_bytes("0 é".encode("latin-1"))
    with pytest.raises(SettingsError, match=rf"{file}: not a text file in UTF-8"):
        read_yolo(tmp_path)


def test_cocos_categories_are_numbered_and_its_crowds_ignored(tmp_path: Path) -> None:
    names, entries = read_coco(coco(tmp_path))
    assert names == ("car", "drone")
    first, second = (entry.load() for entry in entries)
    assert first.boxes.tolist() == [[10, 5, 30, 15]]
    assert first.classes.tolist() == [1]
    assert second.classes.tolist() == [IGNORED]


@pytest.mark.parametrize("form", ["yolo", "coco"])
def test_windows_byte_order_marks_and_a_macs_hidden_files_change_nothing(
    tmp_path: Path, form: str
) -> None:
    folder = (coco if form == "coco" else yolo)(tmp_path)
    if form == "yolo":
        (folder / "data.yaml").unlink()
        (folder / "classes.txt").write_text("car\ndrone\n")
    read = read_coco if form == "coco" else read_yolo
    names, entries = read(folder)
    for path in sorted(path for path in folder.rglob("*.*") if path.is_file()):
        if path.suffix != ".png":
            path.write_text(path.read_text(), "utf-8-sig")
        path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07")
    assert read(folder) == (names, entries)
    assert coco_files(folder) == ([folder / "labels.json"] if form == "coco" else [])


@pytest.mark.parametrize("box", [[80, 5, 20, 10], [10, 40, 20, 10], [-20, 5, 20, 10]])
def test_a_box_outside_its_picture_as_of_another_resolution_is_refused(
    tmp_path: Path, box: list[float]
) -> None:
    one = {"image_id": 7, "category_id": 4, "bbox": box}
    _, entries = read_coco(coco(tmp_path, annotations=[one]))
    with pytest.raises(SettingsError, match=r"a\.png: a box lies outside the picture, 80x40"):
        entries[0].load()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": [{"id": 7}]}, r"images\[0\]\.file_name: missing"),
        ({"images": [{"id": 7, "file_name": "c.png"}]}, "image 0: the picture c.png"),
        ({"annotations": [{"image_id": 7}]}, r"annotations\[0\]\.category_id, .*: missing"),
        ({"annotations": [{"image_id": 7, "category_id": 5, "bbox": [0, 0, 1, 1]}]}, "category 5"),
        (
            {"annotations": [{"image_id": 7, "category_id": 4, "bbox": [0, 0, 0, 1]}]},
            "greater than 0",
        ),
        ({"annotations": [{"image_id": 8, "category_id": 4, "bbox": [0, 0, 1, 1]}]}, "image 8"),
        ({"categories": {}}, "categories: Input should be a valid list"),
    ],
)
def test_what_is_wrong_in_a_coco_file_is_named(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(SettingsError, match=message) as caught:
        read_coco(coco(tmp_path, **changes))
    assert "labels.json" in str(caught.value)


def test_a_broken_json_file_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "labels.json").write_text('{"images": [],\n "annotations": [}')
    with pytest.raises(SettingsError, match=r"labels\.json, line 2: no valid JSON"):
        read_coco(tmp_path)


def test_pictures_are_parted_by_the_seed_and_a_broken_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "data.yaml").write_text(f"names: {[f'class {number}' for number in range(10)]}")
    for number in range(10):
        picture(tmp_path / f"{number}.png")
        (tmp_path / f"{number}.txt").write_text(f"{number} 0.5 0.5 0.5 0.5")
    pictures = FolderPictures(tmp_path, FolderSettings(held_out_share=0.3), seed=1)
    held_out = {one.classes.item() for one in pictures.held_out(96, 10)}
    stream = pictures.training(96, 1)
    learnt = {number for _ in range(210) for number in next(stream).classes.tolist()}
    assert len(held_out) == 3
    assert learnt - {IGNORED} == set(range(10)) - held_out
    for number in range(10):
        (tmp_path / f"{number}.png").write_bytes(b"no picture")
    with pytest.raises(SettingsError, match=r"\.png: this is no picture"):
        next(pictures.training(96, 2))


def test_a_folder_that_is_not_there_or_too_small_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="no such folder"):
        FolderPictures(tmp_path / "none", FolderSettings(), 1)
    (tmp_path / "data.yaml").write_text("names: [car]")
    picture(tmp_path / "one.png")
    (tmp_path / "one.txt").write_text("0 0.5 0.5 0.5 0.5")
    with pytest.raises(SettingsError, match="too few"):
        FolderPictures(tmp_path, FolderSettings(), 1)
