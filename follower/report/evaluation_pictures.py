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
_LASTING = 5
_TOGETHER = 12
_LEAST_SIDES = 6.0
_LEAST_PX = 120.0


def pictures(sequence: ope.Sequence, runs: Sequence[Scored], looks: Mapping[str, Look]) -> str:
    """Return up to four pictures of a sequence: where trackers lose their target."""
    mine = [one for one in runs if one.sequence == sequence.name]
    lost = {one.tracker: _first_failure(one.result.boxes, sequence.truth) for one in mine}
    frames = _grouped(sorted(frame for frame in lost.values() if frame is not None))
    shown = frames or [_present(sequence, len(sequence.truth) // 2)]
    figures = "".join(_picture(sequence, mine, looks, frame) for frame in shown)
    return f'<h3>{html.text_of(sequence.name)}</h3><div class="pictures">{figures}</div>'


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
    boxes = {one.tracker: one.result.boxes[frame] for one in runs}
    missed = [name for name in boxes if _misses(boxes[name], true)]
    shown = {name: box for name, box in boxes.items() if name in missed or not missed}
    image = ope.read_image(sequence.images[frame])
    window = _window(image, [true, *shown.values()])
    drawn = _cut(image, window)
    for name, box in shown.items():
        _draw(drawn, box, window, looks[name].colour, str(looks[name].number))
    _draw(drawn, true, window, TRUTH, "")
    said = "nobody fails" if not missed else f"missed by {', '.join(missed)}"
    return _figure(drawn, f"frame {frame + 1}: {said}")


def _misses(box: Box | None, true: Box | None) -> bool:
    return true is not None and (box is None or box.iou(true) == 0)


def _figure(image: Image, caption: str) -> str:
    _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 75])
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    said = html.text_of(caption)
    return (
        f'<figure><img alt="{said}" width="{_WIDTH}" height="{_HEIGHT}" loading="lazy" '
        f'src="data:image/jpeg;base64,{data}"><figcaption>{said}</figcaption></figure>'
    )


def _window(image: Image, boxes: Sequence[Box | None]) -> Box:
    """Return the part to show, of the picture's shape: the boxes with room around the target."""
    height, width = image.shape[:2]
    known = [box for box in boxes if box is not None]
    room = max([_LEAST_PX, *(_LEAST_SIDES * box.scale for box in known[:1])])
    left = max(0.0, min([box.left for box in known], default=0.0))
    right = min(float(width), max([box.right for box in known], default=float(width)))
    top = max(0.0, min([box.top for box in known], default=0.0))
    bottom = min(float(height), max([box.bottom for box in known], default=float(height)))
    across = max(1.2 * (right - left), room, 1.2 * (bottom - top) * _WIDTH / _HEIGHT)
    return Box((left + right) / 2, (top + bottom) / 2, across, across * _HEIGHT / _WIDTH)


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
    cv2.rectangle(image, (left, top), (right, bottom), (255, 255, 255), 4, cv2.LINE_AA)
    cv2.rectangle(image, (left, top), (right, bottom), (blue, green, red), 2, cv2.LINE_AA)
    place = (min(max(left, 2), _WIDTH - 22), min(max(top - 4, 14), _HEIGHT - 4))
    for tint, thick in (((255, 255, 255), 4), ((blue, green, red), 1)):
        cv2.putText(image, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, tint, thick, cv2.LINE_AA)
