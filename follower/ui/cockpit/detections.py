"""What a detector sees, numbered to be tapped, while somebody wants to see it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from follower.candidates import Candidate, numbered
from follower_vision.clock import Clock
from follower_vision.detection import Detector
from follower_vision.detection.scan import scan
from follower_vision.frame import Frame
from follower_vision.network import ModelError

_EVERY_S = 0.4
_MOST = 40


class Objects:
    """Looks at the newest frame a few times a second, on its own thread.

    Args:
        make: makes the detector, on that thread.
        newest: returns the newest frame, None before the first.
        show: takes what is seen.
        say: is told why nothing is.
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
        """Look for as long as any client wants it."""
        self._wanted = self._wanted | {client} if wanted else self._wanted - {client}
        if self._wanted:
            self._wake.set()
        else:
            self._wake.clear()

    def _run(self) -> None:
        self._wake.wait()
        try:
            detector = self._make()
        except ModelError as error:
            self._say(f"Nothing is numbered on the page: {error}")
            return
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
    return [_plain(one, frame) for one in candidates]


def _plain(one: Candidate, frame: Frame) -> dict[str, Any]:
    box = one.box
    return {
        "number": one.number,
        "name": one.name,
        "score": round(one.score, 2),
        "box": [
            max(0.0, box.left / frame.width),
            max(0.0, box.top / frame.height),
            min(1.0, box.right / frame.width),
            min(1.0, box.bottom / frame.height),
        ],
    }
