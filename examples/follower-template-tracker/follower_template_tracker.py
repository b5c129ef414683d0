"""A motion tracker that searches for the target's first picture: `--tracker mine`."""

import cv2

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.motion_tracker import MotionEstimate, MotionTracker
from follower_vision.trackers.registry import FindFile


class TemplateTracker(MotionTracker):
    """Takes the place in the image with the highest normalised cross-correlation."""

    name = "mine"
    _template: Image | None = None

    def start(self, image: Image, box: Box) -> None:
        """Cut the target out of `image`."""
        rows, columns = (round(max(edge, 0.0)) for edge in (box.top, box.left))
        self._template = image[rows : round(box.bottom), columns : round(box.right)]

    def update(self, image: Image) -> MotionEstimate:
        """Return the best place; its size is the first box's."""
        if self._template is None:
            raise RuntimeError("the tracker was not started")
        scores = cv2.matchTemplate(image, self._template, cv2.TM_CCOEFF_NORMED)
        _, score, _, (x, y) = cv2.minMaxLoc(scores)
        height, width = self._template.shape[:2]
        return MotionEstimate(Box.from_xywh(x, y, width, height), max(score, 0.0))


def make(_find_file: FindFile, _device: str) -> MotionTracker:
    """Return the tracker; one with a network asks for its file, and runs it on the device."""
    return TemplateTracker()
