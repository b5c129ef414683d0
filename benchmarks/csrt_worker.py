"""Run one tracker over image files, told by lines of JSON; benchmarks/csrt.py starts it.

It stands alone, because CSRT's environment holds OpenCV and numpy only.

A request is {"images": [paths], "box": [x, y, w, h]} on one line of the standard input; the answer
is one line: {"boxes": [[x, y, w, h] or null, ...], "update_s": [seconds, ...], "processor_s":
[seconds, ...]}, the first box being the initial one.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]


class Tracker(Protocol):
    """What is started on an image from x, y, w, h, in pixels, by its constructor."""

    def __init__(self, image: Image, box: Sequence[float]) -> None: ...

    def update(self, image: Image) -> list[float] | None:
        """Return x, y, w, h, or None where it says that it lost the target."""


class Csrt:
    """OpenCV's CSRT with its own defaults; its boxes are whole pixels."""

    def __init__(self, image: Image, box: Sequence[float]) -> None:
        """Start on an image from x, y, w, h."""
        self._tracker = cv2.TrackerCSRT_create()  # type: ignore[attr-defined]  # of contrib
        self._tracker.init(image, tuple(round(value) for value in box))

    def update(self, image: Image) -> list[float] | None:
        """Return x, y, w, h, or None where it says that it lost the target."""
        found, box = self._tracker.update(image)
        return [float(value) for value in box] if found else None


class Correlation:
    """Our own tracker with its own defaults."""

    def __init__(self, image: Image, box: Sequence[float]) -> None:
        """Start on an image from x, y, w, h."""
        from follower_vision.geometry.box import Box
        from follower_vision.trackers.correlation import CorrelationTracker

        self._tracker = CorrelationTracker()
        self._tracker.start(image, Box.from_xywh(*box))

    def update(self, image: Image) -> list[float]:
        """Return x, y, w, h."""
        return list(self._tracker.update(image).box.xywh)


TRACKERS: dict[str, type[Tracker]] = {"csrt": Csrt, "correlation": Correlation}


def follow(
    tracker_type: type[Tracker], images: Sequence[str], box: list[float]
) -> dict[str, list[Any]]:
    """Track through image files; return boxes and the seconds of each update."""
    tracker = tracker_type(_read(images[0]), box)
    boxes: list[list[float] | None] = [box]
    update_s, processor_s = list[float](), list[float]()
    for path in images[1:]:
        image = _read(path)
        begin, processor_begin = time.perf_counter(), time.process_time()
        found = tracker.update(image)
        update_s.append(time.perf_counter() - begin)
        processor_s.append(time.process_time() - processor_begin)
        boxes.append(found)
    return {"boxes": boxes, "update_s": update_s, "processor_s": processor_s}


def _read(path: str) -> Image:
    return np.asarray(cv2.imread(path), np.uint8)


def main() -> None:
    """Answer requests until the input ends."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tracker", choices=TRACKERS)
    parser.add_argument("threads", type=int, help="of OpenCV; 0: its own choice")
    options = parser.parse_args()
    if options.threads:
        cv2.setNumThreads(options.threads)
    for line in sys.stdin:
        request = json.loads(line)
        answer = follow(TRACKERS[options.tracker], request["images"], request["box"])
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
