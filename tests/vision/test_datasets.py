"""Each data set's layout is loaded; what is broken is named."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_vision.evaluation.datasets import DatasetError, load_dataset
from follower_vision.evaluation.one_pass import Sequence
from follower_vision.geometry.box import Box


def pictures(folder: Path, number: int = 3) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(number):
        cv2.imwrite(str(folder / f"{index + 1:04}.jpg"), np.zeros((48, 64, 3), np.uint8))


@pytest.mark.parametrize(
    ("images", "truth", "lines"),
    [
        ("img", "groundtruth_rect.txt", "1,2,3,4,\n1\t2\t3\t4\n1 2 3 4\n"),
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


@pytest.mark.parametrize(
    ("name", "labels"), [("absence.label", "0\n0\n1\n0\n"), ("cover.label", "8\n3\n0\n3\n")]
)
def test_absence_is_read_from_zeros_and_from_labels(tmp_path: Path, name: str, labels: str) -> None:
    pictures(tmp_path, 4)
    (tmp_path / "groundtruth.txt").write_text("1,2,3,4\n0,0,0,0\n1,2,3,4\n1,2,3,4\n")
    (tmp_path / name).write_text(labels)
    (sequence,), _ = load_dataset(tmp_path)
    assert [box is None for box in sequence.truth] == [False, True, True, False]


@pytest.mark.parametrize(
    "line", ["nan,nan,nan,nan", "1,1,0,5", "1,1,1e-200,1e-200", "1.5e308,1,1e308,1"]
)
def test_what_is_no_box_is_an_absent_target(tmp_path: Path, line: str) -> None:
    pictures(tmp_path)
    (tmp_path / "groundtruth.txt").write_text(f"1,2,3,4\n{line}\n1,2,3,4\n")
    (sequence,), _ = load_dataset(tmp_path)
    assert [box is None for box in sequence.truth] == [False, True, False]


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ("", "needs one line an image"),
        ("1,2,3,4\n", "needs more than the first box: it is held back"),
        ("1,2,3,4\n" * 2, "needs one line an image"),
        ("1,2,3\n" * 3, "no box in '1,2,3'"),
        ("a,b,c,d\n" * 3, "no box in 'a,b,c,d'"),
        ("0,0,0,0\n" * 3, "a box in the first"),
    ],
)
def test_a_broken_sequence_is_skipped_by_name(tmp_path: Path, lines: str, why: str) -> None:
    for name, text in (("bad", lines), ("good", "1,2,3,4\n" * 3)):
        pictures(tmp_path / name / "img")
        (tmp_path / name / "groundtruth.txt").write_text(text)
    (sequence,), (remark,) = load_dataset(tmp_path)
    assert sequence.name == "good"
    assert "bad" in remark
    assert why in remark


def test_no_sequence_is_an_error_in_one_line(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DatasetError) as caught:
            load_dataset(folder)
        assert "\n" not in str(caught.value)


def numbered(folder: Path, number: int) -> None:
    """Write images whose grey value is their number in the folder, from 1."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(1, number + 1):
        cv2.imwrite(str(folder / f"{index:06}.png"), np.full((4, 4, 3), index % 256, np.uint8))


def grey(sequence: Sequence) -> list[int]:
    return [int(image[0, 0, 0]) for image in sequence.frames()]


def test_uav123_cuts_several_sequences_out_of_one_film(tmp_path: Path) -> None:
    root = tmp_path / "UAV123_10fps"
    numbered(root / "data_seq" / "UAV123_10fps" / "car16", 145)
    anno = root / "anno" / "UAV123_10fps"
    anno.mkdir(parents=True)
    (anno / "car16_1.txt").write_text("1,2,3,4\n" * 139)
    (anno / "car16_2.txt").write_text("1,2,3,4\n" * 7)
    sequences, remarks = load_dataset(root)
    assert remarks == []
    first, second = sequences
    assert (first.name, grey(first)[0], grey(first)[-1], len(first.images)) == (
        "car16_1",
        1,
        139,
        139,
    )
    assert (second.name, grey(second)) == ("car16_2", list(range(139, 146)))
    assert {first.rate_hz, second.rate_hz} == {10.0}


def test_uav123_at_full_rate_starts_its_parts_later(tmp_path: Path) -> None:
    numbered(tmp_path / "data_seq" / "UAV123" / "car16", 420)
    (tmp_path / "anno" / "UAV123").mkdir(parents=True)
    (tmp_path / "anno" / "UAV123" / "car16_2.txt").write_text("1,2,3,4\n" * 6)
    (sequence,), _ = load_dataset(tmp_path)
    assert grey(sequence) == [number % 256 for number in range(415, 421)]
    assert sequence.rate_hz == 30.0


def test_uav20l_uses_whole_films_and_a_name_of_its_own(tmp_path: Path) -> None:
    numbered(tmp_path / "data_seq" / "UAV123" / "car16", 5)
    numbered(tmp_path / "data_seq" / "UAV123" / "bike1", 3)
    for subset, name, rows in (
        ("UAV20L", "car16", 5),
        ("UAV20L", "bike1", 3),
        ("UAV123", "bike1", 3),
    ):
        (tmp_path / "anno" / subset).mkdir(parents=True, exist_ok=True)
        (tmp_path / "anno" / subset / f"{name}.txt").write_text("1,2,3,4\n" * rows)
    sequences, remarks = load_dataset(tmp_path)
    assert remarks == []
    assert sorted(s.name for s in sequences) == ["UAV123-bike1", "UAV20L-bike1", "car16"]


def test_uav123_attributes_are_flags_in_the_order_of_its_paper(tmp_path: Path) -> None:
    numbered(tmp_path / "data_seq" / "UAV123" / "bike1", 3)
    (tmp_path / "anno" / "UAV123" / "att").mkdir(parents=True)
    (tmp_path / "anno" / "UAV123" / "bike1.txt").write_text("1,2,3,4\n" * 3)
    (tmp_path / "anno" / "UAV123" / "att" / "bike1.txt").write_text("1,1,0,1,0,0,0,0,1,1,1,1\n")
    (sequence,), _ = load_dataset(tmp_path)
    assert set(sequence.attributes) == {
        "scale variation", "aspect ratio change", "fast motion", "illumination variation",
        "viewpoint change", "camera motion", "similar object",
    }  # fmt: skip
    assert set(sequence.attributes.values()) == {(True, True, True)}


def test_a_part_that_the_film_does_not_hold_is_named(tmp_path: Path) -> None:
    numbered(tmp_path / "data_seq" / "UAV123" / "car16", 3)
    (tmp_path / "anno" / "UAV123").mkdir(parents=True)
    (tmp_path / "anno" / "UAV123" / "car16_2.txt").write_text("1,2,3,4\n" * 2)
    sequences, (remark,) = load_dataset(tmp_path)
    assert sequences == []
    assert "car16_2" in remark


def test_otb_attributes_and_several_targets(tmp_path: Path) -> None:
    pictures(tmp_path / "Jogging" / "img")
    (tmp_path / "Jogging" / "attrs.txt").write_text("OCC, DEF, OPR")
    for target in (1, 2):
        (tmp_path / "Jogging" / f"groundtruth_rect.{target}.txt").write_text("1,2,3,4\n" * 3)
    pictures(tmp_path / "Human4" / "img")
    (tmp_path / "Human4" / "groundtruth_rect.1.txt").write_text("")
    (tmp_path / "Human4" / "groundtruth_rect.2.txt").write_text("1,2,3,4\n" * 3)
    sequences, remarks = load_dataset(tmp_path)
    assert remarks == []
    assert [s.name for s in sequences] == ["Human4", "Jogging.1", "Jogging.2"]
    assert set(sequences[2].attributes) == {"occlusion", "deformation", "out-of-plane rotation"}


def test_otb_david_starts_at_its_300th_image(tmp_path: Path) -> None:
    numbered(tmp_path / "David" / "img", 310)
    (tmp_path / "David" / "groundtruth_rect.txt").write_text("1,2,3,4\n" * 8)
    (sequence,), _ = load_dataset(tmp_path)
    assert grey(sequence) == [number % 256 for number in range(300, 308)]


def test_vot_tags_hold_frame_by_frame(tmp_path: Path) -> None:
    pictures(tmp_path / "color", 4)
    (tmp_path / "groundtruth.txt").write_text("1,2,3,4\nnan,nan,nan,nan\n0\nm1,2,3,4,0,12\n")
    (tmp_path / "sequence").write_text("channels.color=color/%08d.jpg\r\nfps=24\r\nname=x\r\n")
    (tmp_path / "camera_motion.tag").write_text("0\n1\n1\n")
    (tmp_path / "size_change.label").write_text("0\n0\n0\n0\n")
    (sequence,), _ = load_dataset(tmp_path)
    assert sequence.truth == (Box.from_xywh(1, 2, 3, 4), None, None, Box.from_xywh(1, 2, 3, 4))
    assert sequence.attributes == {"camera motion": (False, True, True, False)}
    assert sequence.rate_hz == 24


def test_what_a_mac_puts_beside_each_file_is_passed_over(tmp_path: Path) -> None:
    pictures(tmp_path / "color", 3)
    (tmp_path / "groundtruth.txt").write_text("1,2,3,4\n" * 3)
    (tmp_path / "occlusion.tag").write_text("0\n1\n1\n")
    for path in [path for path in tmp_path.rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7Mac OS X\xff")
    (sequence,), remarks = load_dataset(tmp_path)
    assert remarks == []
    assert list(sequence.attributes) == ["occlusion"]


def test_got10k_labels_and_classes(tmp_path: Path) -> None:
    pictures(tmp_path, 4)
    (tmp_path / "groundtruth.txt").write_text("1.5,2,3,4\n" * 4)
    (tmp_path / "absence.label").write_text("0\n0\n1\n0\n")
    (tmp_path / "cover.label").write_text("8\n5\n0\n2\n")
    (tmp_path / "cut_by_image.label").write_text("0\n0\n0\n1\n")
    (tmp_path / "meta_info.ini").write_text(
        "[METAINFO]\nurl: https://x.org/%20y\nanno_fps: 10Hz\nobject_class: ctenophore\n"
        "motion_class: swimming\nmajor_class: invertebrate\n"
    )
    (sequence,), _ = load_dataset(tmp_path)
    assert [box is None for box in sequence.truth] == [False, False, True, False]
    assert sequence.rate_hz == 10
    assert sequence.attributes["partly covered"] == (False, True, True, True)
    assert sequence.attributes["mostly covered"] == (False, False, True, True)
    assert sequence.attributes["cut by image"] == (False, False, False, True)
    assert {"object: ctenophore", "motion: swimming", "kind: invertebrate"} <= set(
        sequence.attributes
    )


def test_uavdt_pairs_its_two_archives_and_reads_nine_flags(tmp_path: Path) -> None:
    anno = tmp_path / "UAV-benchmark-SOT_v1.0" / "anno"
    (anno / "att").mkdir(parents=True)
    for name, size in (("S0101", 3), ("S1702", 4)):
        numbered(tmp_path / "UAV-benchmark-S" / name, size)
        (anno / f"{name}_gt.txt").write_text("1,2,3,4\n" * size)
    (anno / "att" / "S0101_att.txt").write_text("1,0,0,1,0,0,0,1,1\n")
    sequences, remarks = load_dataset(tmp_path)
    assert remarks == []
    assert [(s.name, len(s.images), s.rate_hz) for s in sequences] == [
        ("S0101", 3, 30.0),
        ("S1702", 4, 30.0),
    ]
    assert set(sequences[0].attributes) == {
        "background clutter", "small object", "long-term tracking", "large occlusion",
    }  # fmt: skip
    assert sequences[1].attributes == {}


def test_visdrone_pairs_sequences_with_annotations_and_reads_twelve_flags(tmp_path: Path) -> None:
    root = tmp_path / "VisDrone2018-SOT-test-dev"
    name = "uav0000011_00000_s"
    numbered(root / "sequences" / name, 3)
    for folder, file, text in (
        ("annotations", f"{name}.txt", "1,2,3,4\n0,0,0,0\n1,2,3,4\n"),
        ("attributes", f"{name}_attr.txt", "1,0,0,1,0,0,0,0,0,1,0,1"),
    ):
        (root / folder).mkdir()
        (root / folder / file).write_text(text)
    for folder in (tmp_path, root):
        (sequence,), remarks = load_dataset(folder)
        assert (sequence.name, remarks) == (name, [])
        assert [box is None for box in sequence.truth] == [False, True, False]
        assert set(sequence.attributes) == {
            "aspect ratio change", "fast motion", "similar object", "viewpoint change",
        }  # fmt: skip


def test_lasot_has_categories_absent_frames_and_its_toolkits_attributes(tmp_path: Path) -> None:
    for name in ("airplane-1", "bear-2"):
        folder = tmp_path / name.partition("-")[0] / name
        numbered(folder / "img", 4)
        (folder / "groundtruth.txt").write_text("1,2,3,4\n" * 4)
        (folder / "full_occlusion.txt").write_text("0,0,0,0")
        (folder / "out_of_view.txt").write_text("0,0,1,0" if name == "bear-2" else "0,0,0,0")
    (tmp_path / "att").mkdir()
    (tmp_path / "att" / "airplane-1.txt").write_text("0,1,0,0,0,1,0,0,1,0,0,0,1,0\n")
    sequences, remarks = load_dataset(tmp_path)
    assert remarks == []
    assert [s.name for s in sequences] == ["airplane-1", "bear-2"]
    assert set(sequences[0].attributes) == {
        "partial occlusion", "rotation", "scale variation", "low resolution",
    }  # fmt: skip
    assert [box is None for box in sequences[1].truth] == [False, False, True, False]
    assert sequences[1].attributes == {"out of view": (True,) * 4}


def test_trackingnets_parts_have_images_that_count_without_zeros(tmp_path: Path) -> None:
    for number in range(12):
        folder = tmp_path / "TRAIN_3" / "frames" / "video"
        folder.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / f"{number}.jpg"), np.full((8, 8, 3), 20 * number, np.uint8))
    (tmp_path / "TRAIN_3" / "anno").mkdir()
    (tmp_path / "TRAIN_3" / "anno" / "video.txt").write_text("1.5,2,3,4\n" * 12)
    (sequence,), remarks = load_dataset(tmp_path)
    assert (sequence.name, remarks) == ("video", [])
    assert grey(sequence) == pytest.approx([20 * number for number in range(12)], abs=2)


def test_got10ks_and_trackingnets_held_back_boxes_are_said_in_one_line(tmp_path: Path) -> None:
    root = tmp_path / "got10k"
    for part, boxes in (("val", 3), ("test", 1)):
        folder = root / part / f"GOT-10k_{part}_000001"
        numbered(folder, 3)
        (folder / "groundtruth.txt").write_text("1.0,2.0,3.0,4.0\n" * boxes)
        (root / part / "list.txt").write_text(f"{folder.name}\n")
    (sequence,), (remark,) = load_dataset(root)
    assert sequence.name == "GOT-10k_val_000001"
    assert "skipped GOT-10k_test_000001" in remark
    assert "held back" in remark


@pytest.mark.parametrize(
    ("line", "rectangles"),
    [("1,2,3,4", True), ("1,6,1,2,4,2,4,6", False), ("m1,2,3,4,0,12", False)],
)
def test_it_is_known_whether_the_truth_is_a_box_or_lies_in_one(
    tmp_path: Path, line: str, rectangles: bool
) -> None:
    pictures(tmp_path / "color", 3)
    (tmp_path / "groundtruth.txt").write_text(f"{line}\n0\n{line}\n")
    (sequence,), _ = load_dataset(tmp_path)
    assert sequence.rectangles == rectangles
    assert sequence.initial == Box.from_xywh(1, 2, 3, 4)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        *[(f"{one}.label", "1\n1\n", "2 numbers for 3 boxes") for one in ("absence", "cover")],
        ("out_of_view.txt", "1\n1\n", "2 numbers for 3 boxes"),
        ("occlusion.tag", "0\nx\n0\n", ""),
        ("occlusion.tag", "0\n" * 9, ""),
    ],
)
def test_a_broken_file_beside_the_boxes_is_named(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    pictures(tmp_path, 3)
    (tmp_path / "groundtruth.txt").write_text("1,2,3,4\n" * 3)
    (tmp_path / name).write_text(text)
    sequences, (remark,) = load_dataset(tmp_path)
    assert sequences == []
    assert name in remark
    assert said in remark
