"""When the target was not seen, for how long, and what was seen around it."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from follower.flight.log import TrackRecord
from follower.report import html, style
from follower.report.series import LoggedFlight
from follower.report.style import Colour
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.track import TrackState

TITLE = "Target not seen"
"""Of the section; the score counts searches begun, which are fewer."""
_MOST_SHOWN = 8


@dataclass(frozen=True, slots=True)
class TrackLoss:
    """A stretch of frames in which vision did not see its target; times since the flight's start.

    Attributes:
        start_s: the first such frame.
        end_s: when it was seen again, or the last frame.
        seen_before: the last answer that saw it.
        meanwhile: the answers that did not.
        seen_again: the first one that did; None if the recording ended or the target was given up
            before.
        reactions: the supervisor's states meanwhile, in their order.
    """

    start_s: float
    end_s: float
    seen_before: TrackRecord
    meanwhile: tuple[TrackRecord, ...]
    seen_again: TrackRecord | None
    reactions: tuple[str, ...]

    @property
    def length_s(self) -> float:
        """For how many seconds."""
        return self.end_s - self.start_s

    @property
    def said(self) -> str:
        """What vision said meanwhile, e.g. "coasting, lost"."""
        states = (str(record.track.state) for record in self.meanwhile if record.track is not None)
        return ", ".join(dict.fromkeys(states))

    @property
    def ended(self) -> str:
        """How it ended, in words."""
        return "never" if self.seen_again is None else "seen again"

    @property
    def shown_records(self) -> list[tuple[str, TrackRecord]]:
        """Before, in the middle and after, each with a word for it."""
        middle = self.meanwhile[len(self.meanwhile) // 2]
        found = [("seen last", self.seen_before), ("unseen", middle)]
        return found if self.seen_again is None else [*found, ("seen again", self.seen_again)]


def losses(flight: LoggedFlight) -> list[TrackLoss]:
    """Return all losses, in the order of time; a target that was given up is not lost."""
    found: list[TrackLoss] = []
    before: TrackRecord | None = None
    meanwhile: list[TrackRecord] = []
    for record in flight.log.tracks:
        if record.track is not None and record.track.state is not TrackState.TRACKING:
            meanwhile.append(record)
            continue
        seen = None if record.track is None else record
        if before is not None and meanwhile:
            found.append(_loss(flight, before, meanwhile, seen))
        before, meanwhile = seen, []
    if before is not None and meanwhile:
        found.append(_loss(flight, before, meanwhile, None))
    return found


def losses_section(
    found: Sequence[TrackLoss], pictures: Mapping[int, Image], start_s: float, remark: str = ""
) -> str:
    """Return the losses as a table, the longest with pictures.

    Args:
        found: the losses.
        pictures: the images of the frames that `wanted_frames` names, as far as there are any.
        start_s: when the flight began in seconds, from which times are counted.
        remark: what the reader has to know, e.g. why there are no pictures.
    """
    if not found:
        return html.section(TITLE, html.paragraph("Once seen, the target was seen in every frame."))
    rows = [
        (f"{one.start_s:.2f}", f"{one.length_s:.2f}", one.said, ", ".join(one.reactions), one.ended)
        for one in found
    ]
    head = ("From [s]", "For [s]", "Vision said", "Supervisor", "Ended")
    table = html.table(head, rows, numbers=(0, 1))
    listed = html.folded_if_long(table, len(rows), "times")
    shown = "".join(_pictures(one, pictures, start_s) for one in _longest(found))
    return html.section(TITLE, listed, html.paragraph(remark) if remark else "", shown)


def wanted_frames(found: Sequence[TrackLoss]) -> set[int]:
    """Return the numbers of the frames to show."""
    return {record.sequence for one in _longest(found) for _, record in one.shown_records}


def pick_images(frames: Iterable[Frame], wanted: set[int]) -> dict[int, Image]:
    """Return the images of the wanted frames; stops reading after the last of them."""
    found: dict[int, Image] = {}
    frames = iter(frames)
    while len(found) < len(wanted) and (frame := next(frames, None)) is not None:
        if frame.sequence in wanted:
            found[frame.sequence] = frame.image
        elif frame.sequence > max(wanted):
            break
    return found


def _loss(
    flight: LoggedFlight,
    before: TrackRecord,
    meanwhile: Sequence[TrackRecord],
    after: TrackRecord | None,
) -> TrackLoss:
    start_s = meanwhile[0].captured_s - flight.start_s
    end_s = (meanwhile[-1] if after is None else after).captured_s - flight.start_s
    reactions = (s.state for s in flight.states if s.end_s >= start_s and s.start_s <= end_s)
    return TrackLoss(
        start_s, end_s, before, tuple(meanwhile), after, tuple(dict.fromkeys(reactions))
    )


def _longest(found: Sequence[TrackLoss]) -> list[TrackLoss]:
    kept = sorted(found, key=lambda one: -one.length_s)[:_MOST_SHOWN]
    return sorted(kept, key=lambda one: one.start_s)


def _pictures(loss: TrackLoss, pictures: Mapping[int, Image], start_s: float) -> str:
    figures = [
        _thumbnail(pictures[record.sequence], record, word, start_s)
        for word, record in loss.shown_records
        if record.sequence in pictures
    ]
    if not figures:
        return ""
    title = f"From {loss.start_s:.2f} s, for {loss.length_s:.2f} s"
    return f'<h3>{title}</h3><div class="pictures">{"".join(figures)}</div>'


def _thumbnail(image: Image, record: TrackRecord, word: str, start_s: float) -> str:
    track = record.track
    box = None if track is None else track.box
    window = window_of(image, [box])
    drawn = cut(image, window)
    colour = style.TRACK_STATES["none" if track is None else str(track.state)]
    draw(drawn, box, window, colour)
    state = "no target" if track is None else f"{track.state}, confidence {track.confidence:.2f}"
    time_s = record.captured_s - start_s
    return figure(drawn, word, f"{time_s:.2f} s, frame {record.sequence}: {state}")


_WIDTH, _HEIGHT = 400, 300
_SHAPE = _WIDTH / _HEIGHT
_MARGIN = 1.2
_FULL_COLOUR = 0x111111
"""JPEG's 4:4:4: thin lines keep their colour."""
_LEAST_SIDES = 6.0
_LEAST_PX = 120.0


def figure(image: Image, title: str, caption: str) -> str:
    """Return a picture that the page carries in itself, with what it shows."""
    how = [cv2.IMWRITE_JPEG_QUALITY, 75, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, _FULL_COLOUR]
    _, coded = cv2.imencode(".jpg", image, how)
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    name, said = html.text_of(title), html.text_of(caption)
    return (
        f'<figure><img alt="{name}, {said}" width="{_WIDTH}" height="{_HEIGHT}" loading="lazy" '
        f'src="data:image/jpeg;base64,{data}"><figcaption><b>{name}</b> {said}</figcaption>'
        "</figure>"
    )


def window_of(image: Image, boxes: Sequence[Box | None]) -> Box:
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


def cut(image: Image, window: Box) -> Image:
    """Return the window at the picture's size; what lies outside the image is grey."""
    scale = _WIDTH / window.width
    shift = np.array([[scale, 0, -window.left * scale], [0, scale, -window.top * scale]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = (128, 128, 128)
    part = cv2.warpAffine(image, shift, (_WIDTH, _HEIGHT), flags=flags, borderValue=grey)
    return np.asarray(part, np.uint8)


def draw(image: Image, box: Box | None, window: Box, colour: Colour, label: str = "") -> None:
    """Draw a box into the picture that was cut by `window`, nothing for None."""
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
