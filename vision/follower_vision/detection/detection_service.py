"""Runs the detector for trackers: at once, or in the background."""

import atexit
import math
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from follower_vision.clock import Clock, MonotonicClock
from follower_vision.detection.detection import Detection, Detector
from follower_vision.geometry.box import Box, lies_in
from follower_vision.images.frame import Image


@dataclass(frozen=True, slots=True, eq=False)
class DetectionRequest:
    """A wish to see what is in an image.

    Attributes:
        owner: who asks.
        index: the asker's number of the frame.
        image: (H, W, 3) uint8 BGR.
        region: where to look; None is the whole image.
    """

    owner: object
    index: int
    image: Image
    region: Box | None


@dataclass(frozen=True, slots=True, eq=False)
class DetectionAnswer:
    """What was seen."""

    request: DetectionRequest
    detections: list[Detection]


class DetectionService(Protocol):
    """Takes requests and has answers later, or at once."""

    def ready(self, *, urgent: bool = False) -> bool:
        """Tell whether a request should be handed in now; `urgent`: the target is lost."""
        ...

    def submit(self, request: DetectionRequest) -> None:
        """Hand in a request; it may be dropped if the service is not ready."""
        ...

    def take(self, owner: object) -> list[DetectionAnswer]:
        """Return the answers to one asker's requests that have come in, the oldest first."""
        ...

    def forget(self, owner: object) -> None:
        """Drop what was asked for and answered for an asker who will not come for it."""
        ...

    def close(self) -> None:
        """Let go of threads."""
        ...


class InlineDetection:
    """Detects at once, when the answers are fetched: the same every time, and slow."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self._waiting: list[DetectionRequest] = []

    def ready(self, *, urgent: bool = False) -> bool:  # noqa: ARG002
        """Tell that a request is always taken."""
        return True

    def submit(self, request: DetectionRequest) -> None:
        """Keep a request until its answer is fetched."""
        self._waiting.append(request)

    def take(self, owner: object) -> list[DetectionAnswer]:
        """Detect what was asked for by `owner`."""
        mine = [request for request in self._waiting if request.owner is owner]
        self.forget(owner)
        return [_answer(self._detector, request) for request in mine]

    def forget(self, owner: object) -> None:
        """Drop an asker's requests."""
        self._waiting = [request for request in self._waiting if request.owner is not owner]

    def close(self) -> None:
        """Forget the requests."""
        self._waiting = []


_NICENESS = 10
_PATIENCE_S = 5.0
REST_SHARE, URGENT_REST_SHARE = 4.0, 0.5
"""How long the background thread rests, in the processor time of its last detection: usually, and
while the target is lost."""


class BackgroundDetection:
    """Detects in one thread of its own; nobody ever waits for it.

    Where the system allows it (Linux), the thread has a lower priority than its asker's.

    One request is worked on at a time; while that lasts, others are refused (`ready`) or dropped.
    Then the thread rests for four times the processor time that it took, half of it while the
    target is lost. A detector that never pauses slows the
    motion tracker down, with which it shares memory, caches and often a core. With a detection of
    16 ms and a camera of 30 frames a second no request is held back.
    An error of the detector is raised by the next `take`.
    """

    def __init__(self, detector: Detector, clock: Clock | None = None) -> None:
        """Start the thread; the clock is the computer's if none is given."""
        self._detector = detector
        self._clock = clock or MonotonicClock()
        self._ended_s, self._worked_s = -math.inf, 0.0
        self._changed = threading.Condition()
        self._request: DetectionRequest | None = None
        self._dropped: DetectionRequest | None = None
        self._answers: list[DetectionAnswer] = []
        self._error: Exception | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="detection", daemon=True)
        self._thread.start()
        # A thread that is inside a network when the interpreter ends would crash it.
        atexit.register(self.close)

    def ready(self, *, urgent: bool = False) -> bool:
        """Tell whether the thread is idle and has rested."""
        with self._changed:
            share = URGENT_REST_SHARE if urgent else REST_SHARE
            rested = self._clock.now() >= self._ended_s + share * self._worked_s
            return rested and self._request is None

    def submit(self, request: DetectionRequest) -> None:
        """Hand a request to the thread, unless it is busy."""
        with self._changed:
            if self._request is None and not self._closed:
                self._request = request
                self._changed.notify_all()

    def take(self, owner: object) -> list[DetectionAnswer]:
        """Return what has come in for `owner`.

        Raises:
            RuntimeError: the detector failed.
        """
        with self._changed:
            if self._error is not None:
                raise RuntimeError("detection in the background failed") from self._error
            mine = [answer for answer in self._answers if answer.request.owner is owner]
            self._answers = [one for one in self._answers if one.request.owner is not owner]
        return mine

    def forget(self, owner: object) -> None:
        """Drop the answers for `owner`; also the one that is still worked on."""
        with self._changed:
            self._answers = [one for one in self._answers if one.request.owner is not owner]
            if self._request is not None and self._request.owner is owner:
                self._dropped = self._request

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until the thread has nothing to do; for tests and the end of a recording."""
        with self._changed:
            return self._changed.wait_for(lambda: self._request is None, timeout_s)

    def close(self) -> None:
        """Stop the thread after what it is doing."""
        atexit.unregister(self.close)
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(_PATIENCE_S)  # one that hangs is left behind

    def _work(self) -> None:
        _step_back()
        while (request := self._next()) is not None:
            began_s = time.thread_time()
            try:
                answer = _answer(self._detector, request)
            except Exception as error:  # handed on, whatever it is: see `take`
                self._put(None, error, began_s)
                return
            self._put(answer, None, began_s)

    def _next(self) -> DetectionRequest | None:
        with self._changed:
            self._changed.wait_for(lambda: self._request is not None or self._closed)
            return None if self._closed else self._request

    def _put(self, answer: DetectionAnswer | None, error: Exception | None, began_s: float) -> None:
        with self._changed:
            self._ended_s = self._clock.now()
            self._worked_s = time.thread_time() - began_s
            if answer is not None and self._request is not self._dropped:
                self._answers.append(answer)
            self._error = error
            self._request = self._dropped = None
            self._changed.notify_all()


DetectionMode = Callable[[Detector], DetectionService]
"""`InlineDetection` or `BackgroundDetection`."""


def _step_back() -> None:
    """Let every other thread of the program go first; only Linux has priorities of threads."""
    if sys.platform != "linux":
        return
    thread = threading.get_native_id()
    with suppress(OSError):  # a sandbox may forbid it; the work is the same
        usual = os.getpriority(os.PRIO_PROCESS, thread)
        os.setpriority(os.PRIO_PROCESS, thread, usual + _NICENESS)


def _answer(detector: Detector, request: DetectionRequest) -> DetectionAnswer:
    return DetectionAnswer(request, detector.detect(request.image, request.region))


_MOST_GROWTH = 2.0


class SharedDetection:
    """Stands between several askers and one detection service.

    At most one pass is begun per `flush`. It serves the request that has waited longest, and all
    others on the same image whose regions fit into a common one without being shown at less than
    half the size. The rest wait; their answers come later, for their own image.
    """

    def __init__(self, service: DetectionService) -> None:
        self._service = service
        self._waiting: list[DetectionRequest] = []
        self._served: dict[int, list[DetectionRequest]] = {}
        self._answers: list[DetectionAnswer] = []
        self._passes = 0

    @property
    def passes(self) -> int:
        """How many passes of the detector were begun."""
        return self._passes

    def ready(self, *, urgent: bool = False) -> bool:  # noqa: ARG002
        """Tell that a request is always taken: it waits for its turn."""
        return True

    def submit(self, request: DetectionRequest) -> None:
        """Queue a request, unless the asker still has one waiting."""
        if all(one.owner is not request.owner for one in self._waiting):
            self._waiting.append(request)

    def flush(self) -> None:
        """Begin the next pass, if the detector is free."""
        if not self._waiting or not self._service.ready(urgent=True):
            return
        group, region = self._next_group()
        self._waiting = [one for one in self._waiting if one not in group]
        self._passes += 1
        self._served[self._passes] = group
        self._service.submit(DetectionRequest(self, self._passes, group[0].image, region))

    def take(self, owner: object) -> list[DetectionAnswer]:
        """Return the answers to one asker's requests that have come in."""
        for answer in self._service.take(self):
            group = self._served.pop(answer.request.index)
            for one in group:
                inside = [d for d in answer.detections if lies_in(d.box, one.region)]
                self._answers.append(DetectionAnswer(one, inside))
        mine = [answer for answer in self._answers if answer.request.owner is owner]
        self._answers = [one for one in self._answers if one.request.owner is not owner]
        return mine

    def forget(self, owner: object) -> None:
        """Drop what one asker waits for."""
        self._waiting = [one for one in self._waiting if one.owner is not owner]
        self._answers = [one for one in self._answers if one.request.owner is not owner]
        for number, group in self._served.items():
            self._served[number] = [one for one in group if one.owner is not owner]

    def close(self) -> None:
        """Let go of the service's thread."""
        self._service.close()

    def _next_group(self) -> tuple[list[DetectionRequest], Box | None]:
        """The longest waiting request, and those that it can be served with."""
        group = [self._waiting[0]]
        region = group[0].region
        least = _side(region)
        for one in self._waiting[1:]:
            if one.image is not group[0].image:
                continue
            common = _common(region, one.region)
            smallest = min(least, _side(one.region))
            if common is None or common.width <= _MOST_GROWTH * smallest:
                if common is None and (region is not None or one.region is not None):
                    continue
                group.append(one)
                region, least = common, smallest
        return group, region


def _side(region: Box | None) -> float:
    return float("inf") if region is None else region.width


def _common(one: Box | None, two: Box | None) -> Box | None:
    """The smallest square that holds two regions; None if one of them is the whole image."""
    if one is None or two is None:
        return None
    left, top = min(one.left, two.left), min(one.top, two.top)
    right, bottom = max(one.right, two.right), max(one.bottom, two.bottom)
    side = max(right - left, bottom - top)
    return Box((left + right) / 2, (top + bottom) / 2, side, side)
