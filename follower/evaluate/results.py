"""One file a run, whole or not there, so that an evaluation can go on where it stopped."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

from follower.evaluate.contender import Contender
from follower.report.writer import write_whole
from follower_vision.box import Box
from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.ope import Sequence, read_image
from follower_vision.track import TrackState


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run starts: `kind` is "ope", "tre" or "sre"."""

    kind: str
    number: int
    frame: int
    box: Box


@dataclass(frozen=True, slots=True)
class Result:
    """What a tracker answered, from its first frame on.

    Attributes:
        boxes: one a frame; None where it gave none.
        states: one a frame; None for a tracker that knows no states.
        busy_s: time of all updates by the clock.
        processor_s: the same by the processor, all threads together.
    """

    boxes: tuple[Box | None, ...]
    states: tuple[TrackState, ...] | None = None
    busy_s: float = 0.0
    processor_s: float = 0.0


def run(
    contender: Contender, sequence: Sequence, start: Start, rate_hz: float, clock: Clock
) -> Result:
    """Run a fresh tracker from a start to the sequence's end; reading images is not timed.

    Args:
        contender: what to run.
        sequence: what to run over.
        start: where to begin.
        rate_hz: the frames a second that the tracker is told.
        clock: times the updates.

    Raises:
        OSError: an image cannot be read.
        ModelError: a network is missing.
    """
    images = sequence.images[start.frame :]
    tracker = contender.make()
    tracks = [tracker.start(Frame(read_image(images[0]), 0.0, 0), start.box)]
    busy_s = processor_s = 0.0
    for number, path in enumerate(images[1:], 1):
        frame = Frame(read_image(path), number / rate_hz, number)
        begin_s, processor_begin_s = clock.now(), time.process_time()
        tracks.append(tracker.step(frame))
        busy_s += clock.now() - begin_s
        processor_s += time.process_time() - processor_begin_s
    boxes = (start.box, *(track.box for track in tracks[1:]))
    states = tuple(track.state for track in tracks) if contender.has_states else None
    return Result(boxes, states, busy_s, processor_s)


class ResultStore:
    """The results in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def save(
        self,
        contender: Contender,
        sequence: Sequence,
        start: Start,
        rate_hz: float,
        result: Result,
    ) -> None:
        """Write a result atomically."""
        path = self._path(contender, sequence, start)
        path.parent.mkdir(parents=True, exist_ok=True)
        stored = {
            "run": _key(contender, start, rate_hz),
            "busy_s": result.busy_s,
            "processor_s": result.processor_s,
            "boxes": [None if box is None else list(box.xywh) for box in result.boxes],
            "states": result.states and [str(state) for state in result.states],
        }
        write_whole(path, json.dumps(stored))

    def load(
        self, contender: Contender, sequence: Sequence, start: Start, rate_hz: float
    ) -> Result | None:
        """Return the result of the same run, None if there is none or it is of another run."""
        path = self._path(contender, sequence, start)
        if not path.is_file():
            return None
        try:
            stored = json.loads(path.read_text("utf-8"))
            same = stored["run"] == _key(contender, start, rate_hz)
            result = _result(stored)
        except (ValueError, KeyError, TypeError):
            return None
        whole = len(result.boxes) == len(sequence.images) - start.frame
        return result if same and whole else None

    def _path(self, contender: Contender, sequence: Sequence, start: Start) -> Path:
        name = contender.name.replace(":", "@").replace("/", "_")
        return self._folder / name / sequence.name / f"{start.kind}-{start.number}.json"


def _key(contender: Contender, start: Start, rate_hz: float) -> list[object]:
    return [contender.identity, rate_hz, start.frame, list(start.box.xywh)]


def _result(stored: dict[str, object]) -> Result:
    boxes, states = stored["boxes"], stored["states"]
    if not isinstance(boxes, list) or (states is not None and not isinstance(states, list)):
        raise TypeError("no result")
    return Result(
        tuple(None if box is None else Box.from_xywh(*box) for box in boxes),
        None if states is None else tuple(TrackState(state) for state in states),
        float(str(stored["busy_s"])),
        float(str(stored["processor_s"])),
    )
