"""Pictures of the frames in which trackers fail."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from follower.evaluate.summary import Scored
from follower.report import html
from follower.report.style import Colour
from follower.report.tracker_looks import TRUTH, Look
from follower_vision import ope
from follower_vision.box import Box
from follower_vision.frame import Image

_WIDTH, _HEIGHT = 400, 300
_MOST = 4
_MOST_SEQUENCES = 40
_LASTING = 5
_TOGETHER = 12
_SHAPE = _WIDTH / _HEIGHT
_MARGIN = 1.2
_FULL_COLOUR = 0x111111
"""JPEG's 4:4:4: thin lines keep their colour."""
_LEAST_SIDES = 6.0
_LEAST_PX = 120.0


def pictures(
    sequences: Sequence[ope.Sequence], runs: Sequence[Scored], looks: Mapping[str, Look]
) -> str:
    """Return up to four pictures of each sequence: where trackers lose their target.

    Of many sequences, only those with the most losses are shown.
    """
    lost = {sequence.name: _failures(sequence, runs) for sequence in sequences}
    worst = sorted(sequences, key=lambda sequence: -len(lost[sequence.name]))[:_MOST_SEQUENCES]
    kept = {sequence.name for sequence in worst}
    shown = (
        _picture(sequence, runs, looks, frame)
        for sequence in sequences
        if sequence.name in kept
        for frame in _grouped(lost[sequence.name]) or [_present(sequence, len(sequence.truth) // 2)]
    )
    return f'<div class="pictures">{"".join(shown)}</div>'


def _failures(sequence: ope.Sequence, runs: Sequence[Scored]) -> list[int]:
    """Return the frames in which trackers have lost a sequence's target, in order."""
    boxes = [one.result.boxes for one in runs if one.sequence == sequence.name]
    frames = (_first_failure(answered, sequence.truth) for answered in boxes)
    return sorted(frame for frame in frames if frame is not None)


def _first_failure(boxes: Sequence[Box | None], truth: Sequence[Box | None]) -> int | None:
    """Return the last of the first frames in a row that miss the target, None if there are none."""
    row = 0
    for frame, (box, true) in enumerate(zip(boxes, truth, strict=True)):
        if true is not None:
            row = row + 1 if box is None or box.iou(true) == 0 else 0
        if row == _LASTING:
            return frame
    return None


def _grouped(frames: Sequence[int]) -> list[int]:
    """Return one frame for those close together, of the groups with the most trackers."""
    groups: list[list[int]] = []
    for frame in frames:
        if groups and frame - groups[-1][0] <= _TOGETHER:
            groups[-1].append(frame)
        else:
            groups.append([frame])
    biggest = sorted(groups, key=len, reverse=True)[:_MOST]
    return sorted(group[-1] for group in biggest)


def _present(sequence: ope.Sequence, frame: int) -> int:
    """Return the first frame from `frame` on with a target, or the first of all."""
    later = range(frame, len(sequence.truth))
    return next((number for number in later if sequence.truth[number] is not None), 0)


def _picture(
    sequence: ope.Sequence, runs: Sequence[Scored], looks: Mapping[str, Look], frame: int
) -> str:
    true = sequence.truth[frame]
    mine = [one for one in runs if one.sequence == sequence.name]
    boxes = {one.tracker: one.result.boxes[frame] for one in mine}
    missed = [name for name in boxes if _misses(boxes[name], true)]
    shown = {name: box for name, box in boxes.items() if name in missed or not missed}
    image = ope.read_image(sequence.images[frame])
    window = _window(image, [true, *shown.values()])
    drawn = _cut(image, window)
    for name, box in shown.items():
        _draw(drawn, box, window, looks[name].colour, str(looks[name].number))
    _draw(drawn, true, window, TRUTH, "")
    said = "nobody fails" if not missed else f"missed by {', '.join(missed)}"
    return _figure(drawn, sequence.name, f"frame {frame + 1}: {said}")


def _misses(box: Box | None, true: Box | None) -> bool:
    return true is not None and (box is None or box.iou(true) == 0)


def _figure(image: Image, title: str, caption: str) -> str:
    how = [cv2.IMWRITE_JPEG_QUALITY, 75, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, _FULL_COLOUR]
    _, coded = cv2.imencode(".jpg", image, how)
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    name, said = html.text_of(title), html.text_of(caption)
    return (
        f'<figure><img alt="{name}, {said}" width="{_WIDTH}" height="{_HEIGHT}" loading="lazy" '
        f'src="data:image/jpeg;base64,{data}"><figcaption><b>{name}</b> {said}</figcaption>'
        "</figure>"
    )


def _window(image: Image, boxes: Sequence[Box | None]) -> Box:
    """Return the part to show, of the picture's shape: the boxes with room around the target."""
    height, width = image.shape[:2]
    known = [box for box in boxes if box is not None] or [Box(width / 2, height / 2, width, height)]
    left, right = min(box.left for box in known), max(box.right for box in known)
    top, bottom = min(box.top for box in known), max(box.bottom for box in known)
    room = max(_LEAST_PX, _LEAST_SIDES * known[0].scale)
    across = max(_MARGIN * (right - left), room, _MARGIN * (bottom - top) * _SHAPE)
    across = min(across, max(width, height * _SHAPE))
    down = across / _SHAPE
    cx, cy = (_within((left + right) / 2, across, width), _within((top + bottom) / 2, down, height))
    return Box(cx, cy, across, down)


def _within(centre: float, side: float, whole: float) -> float:
    """Move a window's centre so that it lies in the image; what is larger goes to its middle."""
    return whole / 2 if side >= whole else min(max(centre, side / 2), whole - side / 2)


def _cut(image: Image, window: Box) -> Image:
    """Return the window at the picture's size; what lies outside the image is grey."""
    scale = _WIDTH / window.width
    shift = np.array([[scale, 0, -window.left * scale], [0, scale, -window.top * scale]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = (128, 128, 128)
    cut = cv2.warpAffine(image, shift, (_WIDTH, _HEIGHT), flags=flags, borderValue=grey)
    return np.asarray(cut, np.uint8)


def _draw(image: Image, box: Box | None, window: Box, colour: Colour, label: str) -> None:
    if box is None:
        return
    scale = _WIDTH / window.width
    edges = np.array([box.left, box.top, box.right, box.bottom])
    moved = (edges - [window.left, window.top, window.left, window.top]) * scale
    left, top, right, bottom = (int(edge) for edge in np.clip(moved, -1e4, 1e4))
    red, green, blue = bytes.fromhex(colour.light[1:])
    cv2.rectangle(image, (left, top), (right, bottom), (blue, green, red), 2, cv2.LINE_AA)
    if label:
        _draw_label(image, label, (left, top), (blue, green, red))


def _draw_label(
    image: Image, label: str, corner: tuple[int, int], tint: tuple[int, int, int]
) -> None:
    """Write white on the box's colour, above the box where there is room."""
    wide, high = 6 + 9 * len(label), 16
    left = min(max(corner[0], 0), _WIDTH - wide)
    top = min(max(corner[1] - high, 0), _HEIGHT - high)
    cv2.rectangle(image, (left, top), (left + wide, top + high), tint, cv2.FILLED)
    place = (left + 3, top + high - 4)
    white = (255, 255, 255)
    cv2.putText(image, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, white, 1, cv2.LINE_AA)
