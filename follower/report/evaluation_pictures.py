"""Pictures of the frames in which trackers fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from follower.evaluate.summary import Scored
from follower.report import thumbnails
from follower.report.tracker_looks import TRUTH, Look
from follower_vision import ope
from follower_vision.box import Box

_MOST = 4
_MOST_SEQUENCES = 40
_LASTING = 5
_TOGETHER = 12


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
    window = thumbnails.window_of(image, [true, *shown.values()])
    drawn = thumbnails.cut(image, window)
    for name, box in shown.items():
        thumbnails.draw(drawn, box, window, looks[name].colour, str(looks[name].number))
    thumbnails.draw(drawn, true, window, TRUTH)
    said = "nobody fails" if not missed else f"missed by {', '.join(missed)}"
    return thumbnails.figure(drawn, sequence.name, f"frame {frame + 1}: {said}")


def _misses(box: Box | None, true: Box | None) -> bool:
    return true is not None and (box is None or box.iou(true) == 0)
