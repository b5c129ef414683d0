"""When the target was out of sight, for how long, and what was seen around it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from follower.flightlog import TrackRecord
from follower.report import html, style, thumbnails
from follower.report.flight import Flight
from follower.report.style import Colour
from follower_vision.frame import Frame, Image
from follower_vision.track import TrackState

_MOST_SHOWN = 8
_LONG = 25


@dataclass(frozen=True, slots=True)
class Loss:
    """A stretch of frames in which vision did not see its target; times since the flight's start.

    Attributes:
        start_s: the first such frame.
        end_s: when it was seen again, or the last frame.
        seen_before: the last answer that saw it.
        meanwhile: the answers that did not.
        seen_again: the first one that did; None if the recording ends before.
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
        """For how long."""
        return self.end_s - self.start_s

    @property
    def said(self) -> str:
        """What vision said meanwhile, e.g. "coasting, lost"."""
        states = (str(record.track.state) for record in self.meanwhile if record.track is not None)
        return ", ".join(dict.fromkeys(states)) or "no target"

    @property
    def moments(self) -> list[tuple[str, TrackRecord]]:
        """Before, in the middle and after, each with a word for it."""
        middle = self.meanwhile[len(self.meanwhile) // 2]
        found = [("seen last", self.seen_before), ("unseen", middle)]
        return found if self.seen_again is None else [*found, ("seen again", self.seen_again)]


def losses(flight: Flight) -> list[Loss]:
    """Return all losses, in the order of time."""
    found: list[Loss] = []
    before: TrackRecord | None = None
    meanwhile: list[TrackRecord] = []
    for record in flight.log.tracks:
        if record.track is None or record.track.state is not TrackState.TRACKING:
            meanwhile.append(record)
            continue
        if before is not None and meanwhile:
            found.append(_loss(flight, before, meanwhile, record))
        before, meanwhile = record, []
    if before is not None and meanwhile:
        found.append(_loss(flight, before, meanwhile, None))
    return found


def losses_section(
    found: Sequence[Loss], pictures: Mapping[int, Image], start_s: float, remark: str = ""
) -> str:
    """Return the losses as a table, the longest with pictures.

    Args:
        found: the losses.
        pictures: the images of the frames that `wanted_frames` names, as far as there are any.
        start_s: the flight's first moment, from which times are counted.
        remark: what the reader has to know, e.g. why there are no pictures.
    """
    if not found:
        return html.section("Losses", html.paragraph("The target was seen in every frame."))
    rows = [
        (f"{one.start_s:.2f}", f"{one.length_s:.2f}", one.said, ", ".join(one.reactions), _end(one))
        for one in found
    ]
    head = ("From [s]", "For [s]", "Vision said", "Supervisor", "Ended")
    table = html.table(head, rows, numbers=(0, 1))
    listed = html.folded(f"{len(rows)} losses", table) if len(rows) > _LONG else table
    shown = "".join(_pictures(one, pictures, start_s) for one in _longest(found))
    return html.section("Losses", listed, html.paragraph(remark) if remark else "", shown)


def wanted_frames(found: Sequence[Loss]) -> set[int]:
    """Return the numbers of the frames to show."""
    return {record.sequence for one in _longest(found) for _, record in one.moments}


def pick_images(frames: Iterable[Frame], wanted: set[int]) -> dict[int, Image]:
    """Return the images of the wanted frames; stops reading after the last of them."""
    return {frame.sequence: frame.image for frame in _up_to(frames, wanted)}


def _up_to(frames: Iterable[Frame], wanted: set[int]) -> Iterator[Frame]:
    last = max(wanted, default=-1)
    if last < 0:
        return
    for frame in frames:
        if frame.sequence in wanted:
            yield frame
        if frame.sequence >= last:
            return


def _loss(
    flight: Flight, before: TrackRecord, meanwhile: Sequence[TrackRecord], after: TrackRecord | None
) -> Loss:
    start_s = meanwhile[0].captured_s - flight.start_s
    end_s = (meanwhile[-1] if after is None else after).captured_s - flight.start_s
    reactions = (s.state for s in flight.states if s.end_s >= start_s and s.start_s <= end_s)
    return Loss(start_s, end_s, before, tuple(meanwhile), after, tuple(dict.fromkeys(reactions)))


def _longest(found: Sequence[Loss]) -> list[Loss]:
    kept = sorted(found, key=lambda one: -one.length_s)[:_MOST_SHOWN]
    return sorted(kept, key=lambda one: one.start_s)


def _end(loss: Loss) -> str:
    return "never" if loss.seen_again is None else "seen again"


def _pictures(loss: Loss, pictures: Mapping[int, Image], start_s: float) -> str:
    figures = [
        _thumbnail(pictures[record.sequence], record, word, start_s)
        for word, record in loss.moments
        if record.sequence in pictures
    ]
    if not figures:
        return ""
    title = f"From {loss.start_s:.2f} s, for {loss.length_s:.2f} s"
    return f'<h3>{title}</h3><div class="pictures">{"".join(figures)}</div>'


def _thumbnail(image: Image, record: TrackRecord, word: str, start_s: float) -> str:
    track = record.track
    box = None if track is None else track.box
    window = thumbnails.window_of(image, [box])
    drawn = thumbnails.cut(image, window)
    thumbnails.draw(drawn, box, window, _colour(record))
    state = "no target" if track is None else f"{track.state}, confidence {track.confidence:.2f}"
    time_s = record.captured_s - start_s
    return thumbnails.figure(drawn, word, f"{time_s:.2f} s, frame {record.sequence}: {state}")


def _colour(record: TrackRecord) -> Colour:
    state = "none" if record.track is None else str(record.track.state)
    return style.TRACK_STATES[state]
