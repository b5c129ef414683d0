"""One detector for several trackers: regions that lie together are looked at in one pass."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.detection.detection import Detection
from follower_vision.fusion.detection_service import (
    DetectionAnswer,
    DetectionRequest,
    DetectionService,
    Need,
)

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

    def ready(self, need: Need = Need.USUAL) -> bool:  # noqa: ARG002
        """Tell that a request is always taken: it waits for its turn."""
        return True

    def submit(self, request: DetectionRequest) -> None:
        """Queue a request, unless the asker still has one waiting."""
        if all(one.owner is not request.owner for one in self._waiting):
            self._waiting.append(request)

    def flush(self) -> None:
        """Begin the next pass, if the detector is free."""
        if not self._waiting or not self._service.ready(Need.URGENT):
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
            self._answers += [
                DetectionAnswer(one, _within(answer.detections, one.region)) for one in group
            ]
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


def _within(detections: list[Detection], region: Box | None) -> list[Detection]:
    if region is None:
        return list(detections)
    return [
        one
        for one in detections
        if region.left <= one.box.cx <= region.right and region.top <= one.box.cy <= region.bottom
    ]
