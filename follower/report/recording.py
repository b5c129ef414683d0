"""What a recording holds and what it lacks."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

from follower.recorder import RecordedFlight
from follower.recorder.messages import MESSAGES
from follower.report import html
from follower_vision.track import TrackState


def recording_section(recorded: RecordedFlight, length_s: float) -> str:
    """Return what was recorded, how often it came, and what was dropped."""
    return html.section(
        "Recording",
        html.table(("Frames", "Number"), frame_rows(recorded), numbers=(1,)),
        html.table(
            ("Message", "Number", "A second", "Meant"), _message_rows(recorded, length_s), (1, 2)
        ),
        html.table(("Sightings", "Number"), _verdict_rows(recorded), numbers=(1,)),
        *(html.paragraph(remark) for remark in recorded.remarks),
    )


def frame_rows(recorded: RecordedFlight) -> list[tuple[str, str]]:
    """Return what became of the frames: (what, how many)."""
    frames = recorded.frames
    missed = sum(max(0, b.sequence - a.sequence - 1) for a, b in pairwise(frames))
    in_video = sum(frame.video_index is not None for frame in frames)
    return [
        ("that vision took", str(len(frames))),
        ("that it did not take (gaps in the source's numbers)", str(missed)),
        ("in the video", str(in_video)),
        ("left out of the video", str(len(frames) - in_video)),
        ("without an answer in the log", str(max(0, len(frames) - len(recorded.log.tracks)))),
    ]


def dropped(recorded: RecordedFlight) -> list[str]:
    """Return what the recording lacks, in sentences: the recorder's words and the reader's."""
    said = [event.text for event in recorded.log.events if event.source == "recorder"]
    return [*(f"The recorder said: {text}." for text in said), *recorded.remarks]


def seen_share(recorded: RecordedFlight) -> float | None:
    """Return the share of the frames with a chosen target in which vision saw it."""
    states = [record.track.state for record in recorded.log.tracks if record.track is not None]
    return states.count(TrackState.TRACKING) / len(states) if states else None


def _message_rows(recorded: RecordedFlight, length_s: float) -> list[tuple[str, str, str, str]]:
    counts = Counter(type(message) for _, message in recorded.messages())
    packets = sum(1 for _ in recorded.packets())
    rows = [
        (one.topic, str(counts[one.record]), _rate(counts[one.record], length_s), one.rate)
        for one in MESSAGES
        if counts[one.record]
    ]
    link = ("MAVLink packets, both ways", str(packets), _rate(packets, length_s), "as they come")
    return [*rows, link] if packets else rows


def _rate(count: int, length_s: float) -> str:
    return f"{count / length_s:.1f}" if length_s > 0 else ""


def _verdict_rows(recorded: RecordedFlight) -> list[tuple[str, str]]:
    counts = Counter(str(one.verdict) for one in recorded.observations)
    return [(name, str(number)) for name, number in counts.most_common()]
