"""One file a run, whole or not there, so that an evaluation can go on where it stopped."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from follower.evaluate.contender import Contender
from follower.report.writer import write_whole
from follower_vision.box import Box
from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.ope import Sequence, read_image

_FRAME_S = 1 / 30
"""Data sets say no times; the trackers are told thirty frames a second."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run starts: `kind` is "ope", "tre" or "sre"."""

    kind: str
    number: int
    frame: int
    box: Box


@dataclass(frozen=True, slots=True)
class Result:
    """A run's boxes from its first frame on (None: no answer), and the time of all updates."""

    boxes: tuple[Box | None, ...]
    busy_s: float


def run(contender: Contender, sequence: Sequence, start: Start, clock: Clock) -> Result:
    """Run a fresh tracker from a start to the sequence's end; reading images is not timed.

    Raises:
        OSError: an image cannot be read.
        ModelError: a network is missing.
    """
    images = sequence.images[start.frame :]
    tracker = contender.make()
    tracker.start(Frame(read_image(images[0]), 0.0, 0), start.box)
    boxes: list[Box | None] = [start.box]
    busy_s = 0.0
    for number, path in enumerate(images[1:], 1):
        frame = Frame(read_image(path), number * _FRAME_S, number)
        begin = clock.now()
        boxes.append(tracker.step(frame).box)
        busy_s += clock.now() - begin
    return Result(tuple(boxes), busy_s)


class ResultStore:
    """The results in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def save(self, contender: Contender, sequence: Sequence, start: Start, result: Result) -> None:
        """Write a result atomically."""
        path = self._path(contender, sequence, start)
        path.parent.mkdir(parents=True, exist_ok=True)
        boxes = [None if box is None else list(box.xywh) for box in result.boxes]
        stored = {"run": self._key(contender, start), "busy_s": result.busy_s, "boxes": boxes}
        write_whole(path, json.dumps(stored))

    def load(self, contender: Contender, sequence: Sequence, start: Start) -> Result | None:
        """Return the result of the same run, None if there is none or it is of another run."""
        path = self._path(contender, sequence, start)
        if not path.is_file():
            return None
        try:
            stored = json.loads(path.read_text("utf-8"))
            same = stored["run"] == self._key(contender, start)
            boxes = tuple(None if b is None else Box.from_xywh(*b) for b in stored["boxes"])
            result = Result(boxes, float(stored["busy_s"]))
        except (ValueError, KeyError, TypeError):
            return None
        whole = len(boxes) == len(sequence.images) - start.frame
        return result if same and whole else None

    @staticmethod
    def _key(contender: Contender, start: Start) -> list[object]:
        return [contender.identity, start.frame, list(start.box.xywh)]

    def _path(self, contender: Contender, sequence: Sequence, start: Start) -> Path:
        name = contender.name.replace(":", "@")
        return self._folder / name / sequence.name / f"{start.kind}-{start.number}.json"
