"""What another node detects, as a detector."""

import math
from typing import Any

from follower.apps.ros.conversion import stamp_s
from follower.apps.ros.io_node import IoNode, interfaces
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

_FRESH_S = 0.25


class TopicDetector:
    """Gives the newest vision_msgs/Detection2DArray, while it is younger than 0.25 s.

    Classes are what the other node calls them. See `Detector`.

    Attributes:
        topic: its full name.
        class_names: those seen so far, and those that were asked for.

    Raises:
        SettingsError: vision_msgs is not installed.
    """

    def __init__(self, io: IoNode, topic: str) -> None:
        kind = interfaces("vision_msgs").Detection2DArray
        self._io, self.topic = io, io.name_of(topic)
        self._newest: tuple[float, list[Detection]] = (float("-inf"), [])
        self.class_names: tuple[str, ...] = ()
        io.subscribe(kind, topic, self._take)

    def know(self, name: str) -> None:
        """Take a class to be one that can be asked for, seen yet or not."""
        if name not in self.class_names:
            self.class_names = (*self.class_names, name)

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """Return what the other node saw last; only centres in `region` count, if it is given."""
        stamped_s, found = self._newest
        height, width = image.shape[:2]
        fresh = self._io.clock.now() - stamped_s <= _FRESH_S
        return [
            one
            for one in (found if fresh else ())
            if one.box.visible_share(width, height) > 0
            and (region is None or _is_inside(one.box, region))
        ]

    def _take(self, message: Any) -> None:
        stamped_s = self._io.clock.of_stamp(stamp_s(message.header.stamp))
        if stamped_s is None:
            return
        found = []
        for one in message.detections:
            try:
                found.append(self._read(one))
            except ValueError as error:
                self._io.left_out(f"a detection of {self.topic}", error)
        self._newest = stamped_s, sorted(found, key=lambda one: -one.score)

    def _read(self, m: Any) -> Detection:
        box, scores = box_of(m), [one.hypothesis.score for one in m.results]
        if not all(map(math.isfinite, scores)) or not 0 <= max(scores, default=-1) <= 1:
            raise ValueError(f"it needs a score from 0 to 1, not {scores}")
        best = max(m.results, key=lambda one: one.hypothesis.score)
        name = best.hypothesis.class_id
        self.know(name)
        return Detection(box, self.class_names.index(name), name, best.hypothesis.score)


def box_of(detection: Any) -> Box:
    """Return the box of a vision_msgs/Detection2D in pixels.

    Raises:
        ValueError: it is none.
    """
    place, box = detection.bbox.center.position, detection.bbox
    return Box(place.x, place.y, box.size_x, box.size_y)


def _is_inside(box: Box, region: Box) -> bool:
    """Whether a box's centre lies in a region."""
    within = abs(box.cx - region.cx) <= region.width / 2
    return within and abs(box.cy - region.cy) <= region.height / 2
