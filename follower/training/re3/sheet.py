"""What Re3 learns from, on one sheet to be looked at."""

from __future__ import annotations

import cv2
import numpy as np

from follower.training.re3.examples import Example, pair
from follower.training.scenes.maker import SceneMaker
from follower.training.scenes.scene import Scene
from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.re3_geometry import SEARCH_PX, TARGET_PX, TEMPLATE_PX, absolute_box

_ROWS = 6
_FRAMES = 24
_SHOWN = (0, 8, 16, 23)
_WHOLE_PX = (342, 256)
_FITTING, _DRAWN, _ANSWER = (80, 220, 60), (60, 170, 255), (80, 220, 60)


def sample_sheet(maker: SceneMaker) -> Image:
    """Return scenes with their boxes, and beside them what the network gets to see.

    Left, whole frames: green fits the mask, orange is the box to be followed. Right, examples of
    the same scene: memory, previous crop and present crop with the right answer.
    """
    return np.asarray(np.vstack([_row(maker.scene(index, _FRAMES)) for index in range(_ROWS)]))


def _row(scene: Scene) -> Image:
    rng = np.random.default_rng(0)
    wholes = [_whole(scene, frame) for frame in _SHOWN]
    examples = [_example(pair(rng, scene)) for _ in range(2)]
    return np.asarray(np.hstack([*wholes, *examples]))


def _whole(scene: Scene, frame: int) -> Image:
    image = scene.whole(frame).image.copy()
    _draw(image, scene.box(frame), _FITTING)
    _draw(image, scene.drawn_box(frame), _DRAWN)
    return np.asarray(cv2.resize(image, _WHOLE_PX, interpolation=cv2.INTER_AREA), np.uint8)


def _example(example: Example) -> Image:
    """Return memory above previous, beside present, 192 x 256 with a margin below."""
    width, height = (TARGET_PX * float(side) for side in example.size)
    last = Box(SEARCH_PX / 2, SEARCH_PX / 2, width, height)
    present = example.present.copy()
    if example.visible:
        box = absolute_box(np.array(example.answer, np.float32), last)
        _draw(present, box, _ANSWER, 1)
    small = np.vstack([example.memory, example.previous])
    both = np.hstack([small, present])
    blank = np.full((_WHOLE_PX[1] - SEARCH_PX, SEARCH_PX + TEMPLATE_PX, 3), 255, np.uint8)
    return np.asarray(np.vstack([both, blank]))


def _draw(image: Image, box: Box, colour: tuple[int, int, int], thickness: int = 2) -> None:
    first, last = (round(box.left), round(box.top)), (round(box.right), round(box.bottom))
    cv2.rectangle(image, first, last, colour, thickness, cv2.LINE_AA)
