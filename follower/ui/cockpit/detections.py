"""Numbered detections that a client can select, while any client shows them."""

import threading
from collections.abc import Callable
from typing import Any

from follower.flight.target.candidate_image import numbered
from follower_vision.clock import Clock
from follower_vision.detection import Detector
from follower_vision.detection.detectors import scan
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.onnx_network import ModelError
from follower_vision.plugins import PluginError

_EVERY_S = 0.4
_MOST = 40


class Objects:
    """Detects objects in the newest frame a few times a second, on its own thread.

    Args:
        make: makes the detector, on that thread.
        newest: returns the newest frame, None before the first.
        show: takes what is seen.
        say: takes the reason why nothing is.
        clock: for the pace.
    """

    def __init__(
        self,
        make: Callable[[], Detector],
        newest: Callable[[], Frame | None],
        show: Callable[[list[dict[str, Any]]], None],
        say: Callable[[str], None],
        clock: Clock,
    ) -> None:
        self._make = make
        self._newest = newest
        self._show = show
        self._say = say
        self._clock = clock
        self._wanted: frozenset[str] = frozenset()
        self._wake = threading.Event()
        threading.Thread(target=self._run, name="objects", daemon=True).start()

    def want(self, client: str, wanted: bool) -> None:
        """Detect for as long as any client wants it."""
        self._wanted = self._wanted | {client} if wanted else self._wanted - {client}
        if self._wanted:
            self._wake.set()
        else:
            self._wake.clear()

    def _run(self) -> None:
        self._wake.wait()
        try:
            detector = self._make()
        except (ModelError, PluginError) as error:
            self._say(f"Nothing is numbered on the page: {error}")
            return
        try:
            self._scan_all(detector)
        finally:  # only an error ends it
            self._show([])
            self._say("Nothing is numbered on the page any more: an error in the detector")

    def _scan_all(self, detector: Detector) -> None:
        seen = -1
        while True:
            self._wake.wait()
            frame = self._newest()
            if frame is not None and frame.sequence != seen:
                seen = frame.sequence
                self._show(objects_in(frame, detector))
            self._clock.sleep_until(self._clock.now() + _EVERY_S)


def objects_in(frame: Frame, detector: Detector) -> list[dict[str, Any]]:
    """Return what is seen, the nearest to the centre first; boxes as shares of the image."""
    candidates = numbered(scan(detector, frame.image), frame)[:_MOST]
    return [
        {
            "number": one.number,
            "name": one.name,
            "score": round(one.score, 2),
            "box": [min(max(s, 0.0), 1.0) for s in box_shares(one.box, frame.width, frame.height)],
        }
        for one in candidates
    ]


def box_shares(box: Box, width: int, height: int) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom as shares of an image of this size in pixels."""
    return box.left / width, box.top / height, box.right / width, box.bottom / height
