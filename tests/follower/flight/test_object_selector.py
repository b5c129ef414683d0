"""Targets chosen by class and number: what is meant, what is waited for, what is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from follower.flight.target.candidate_image import draw_candidates, numbered, summary
from follower.flight.target.selectors import ChoiceError, ObjectSelector, Wanted
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detection
from follower_vision.detection.detectors import scan
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image

CLASSES = ("person", "car", "traffic light")


class ScriptedDetector:
    """Sees in each image what it is told, by turns."""

    class_names = CLASSES

    def __init__(self, *answers: Sequence[Detection]) -> None:
        self.answers = list(answers)

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        return list(self.answers.pop(0) if len(self.answers) > 1 else self.answers[0])


def frame(number: int = 0, width: int = 400, height: int = 300) -> Frame:
    return Frame(np.full((height, width, 3), 90, np.uint8), number / 30, number)


def seen(name: str, cx: float, cy: float = 150, score: float = 0.8) -> Detection:
    return Detection(Box(cx, cy, 20, 40), CLASSES.index(name), name, score)


STREET = [seen("person", 100), seen("person", 190), seen("car", 230), seen("person", 300)]


def select(*texts: str, answers: Sequence[Sequence[Detection]] = (STREET,)) -> ObjectSelector:
    wanted = [Wanted.parse(text, CLASSES) for text in texts]
    return ObjectSelector(wanted, ScriptedDetector(*answers))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("person", ("person", None)),
        ("Person:2", ("person", 2)),
        ("traffic light:12", ("traffic light", 12)),
        ("3", (None, 3)),
    ],
)
def test_a_wish_is_a_class_a_number_or_both(text: str, expected: tuple[str | None, int]) -> None:
    wanted = Wanted.parse(text, CLASSES)
    assert (wanted.class_name, wanted.number) == expected


@pytest.mark.parametrize("text", ["", ":", "person:", "person:0", "person:two", "0", "person:-1"])
def test_what_is_no_wish_is_refused_with_examples(text: str) -> None:
    with pytest.raises(SettingsError, match="person:2"):
        Wanted.parse(text, CLASSES)


def test_an_unknown_class_is_refused_with_the_nearest_or_all() -> None:
    with pytest.raises(SettingsError, match="did you mean 'person'"):
        Wanted.parse("persn", CLASSES)
    with pytest.raises(SettingsError, match="it knows person, car, traffic light"):
        Wanted.parse("zeppelin", CLASSES)


def test_objects_are_numbered_from_the_images_centre() -> None:
    names = [(one.number, one.name) for one in numbered(STREET, frame())]
    assert names == [(1, "person:1"), (2, "car:1"), (3, "person:2"), (4, "person:3")]


@pytest.mark.parametrize(
    ("texts", "centres"),
    [
        (["person"], [190]),
        (["car"], [230]),
        (["person:2"], [100]),
        (["1"], [190]),
        (["2"], [230]),
        (["person:3", "car", "1"], [300, 230, 190]),
    ],
)
def test_the_objects_meant_are_found_in_the_order_asked_for(
    texts: list[str], centres: list[float]
) -> None:
    assert [box.cx for box in select(*texts)(frame())] == centres


def test_a_class_is_waited_for_and_all_targets_are_of_one_frame() -> None:
    answers = [[], [seen("car", 50)], [seen("car", 60), seen("person", 220)]]
    selector = select("car", "person", answers=answers)
    assert selector(frame(0)) == []
    assert selector(frame(1)) == []
    assert selector.candidates[0].name == "car:1"
    assert [box.cx for box in selector(frame(2))] == [60, 220]
    assert [one.name for one in selector.chosen] == ["car:1", "person:1"]


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["person:4"], "--select person:4: only 3 persons? in frame 7"),
        (["9"], "--select 9: only 3 person, 1 car in frame 7"),
        (["person", "person:1"], "person and person:1 are the same object"),
        (["car", "car"], "are the same object"),
    ],
)
def test_what_cannot_be_told_is_refused_and_comes_with_what_may_be_chosen(
    texts: list[str], message: str
) -> None:
    with pytest.raises(ChoiceError, match=message) as caught:
        select(*texts)(frame(7))
    assert len(caught.value.candidates) == 4
    assert caught.value.image.shape == (300, 400, 3)


def test_a_summary_counts_the_classes() -> None:
    assert summary(numbered(STREET, frame())) == "3 person, 1 car"
    assert summary([]) == "nothing"


def test_the_picture_of_candidates_is_enlarged_and_marks_each() -> None:
    picture = draw_candidates(frame().image, numbered(STREET, frame()))
    assert picture.shape == (900, 1200, 3)
    for one in STREET:
        edge = picture[round(3 * one.box.top) : round(3 * one.box.bottom), round(3 * one.box.left)]
        assert (edge != 90).any(axis=1).mean() > 0.9


def test_a_small_image_is_looked_at_once_and_a_large_one_in_parts_too() -> None:
    regions: list[Box | None] = []

    class Watched(ScriptedDetector):
        def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
            regions.append(region)
            return super().detect(image, region)

    scan(Watched([]), frame().image)
    assert regions == [None]
    regions.clear()
    scan(Watched([]), frame(width=1280, height=720).image)
    parts = [region for region in regions if region is not None]
    assert len(parts) == 4
    assert min(part.left for part in parts) == pytest.approx(0)
    assert max(part.right for part in parts) == pytest.approx(1280)
    assert max(part.bottom for part in parts) == pytest.approx(720)


def test_a_scan_keeps_the_better_of_two_boxes_of_one_object_and_drops_what_a_part_cuts() -> None:
    whole = [seen("person", 200, score=0.5)]
    cut = Detection(Box(210, 150, 10, 40), 0, "person", 0.9, cut=True)
    part = [seen("person", 202, score=0.7), seen("car", 205, score=0.4), cut]
    found = scan(ScriptedDetector(whole, part, [], [], []), frame(width=800).image)
    assert [(one.class_name, one.score) for one in found] == [("person", 0.7), ("car", 0.4)]
