"""OpenCV's own trackers behind the motion-tracker seam, as far as this OpenCV has them."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.onnx_network import ModelError, check_model
from follower_vision.trackers.motion_tracker import MotionEstimate

_LEAST_MIL_AREA = 25


@dataclass(frozen=True, slots=True)
class OpenCvKind:
    """How to make one of OpenCV's trackers.

    Attributes:
        classes: where OpenCV may keep its class, in order of preference; "legacy" is in
            opencv-contrib alone.
        files: the parameter that takes each network's file, and the file's name.
    """

    classes: tuple[str, ...]
    files: Mapping[str, str]


OPENCV_KINDS: Mapping[str, OpenCvKind] = {
    "mil": OpenCvKind(("TrackerMIL", "legacy.TrackerMIL"), {}),
    "nano": OpenCvKind(
        ("TrackerNano",),
        {"backbone": "nanotrackv2_backbone.onnx", "neckhead": "nanotrackv2_head.onnx"},
    ),
    "vit": OpenCvKind(("TrackerVit",), {"net": "vittrack.onnx"}),
    "dasiamrpn": OpenCvKind(
        ("TrackerDaSiamRPN",),
        {
            "model": "dasiamrpn_model.onnx",
            "kernel_r1": "dasiamrpn_kernel_r1.onnx",
            "kernel_cls1": "dasiamrpn_kernel_cls1.onnx",
        },
    ),
    "csrt": OpenCvKind(("TrackerCSRT", "legacy.TrackerCSRT"), {}),
    "kcf": OpenCvKind(("TrackerKCF", "legacy.TrackerKCF"), {}),
    "boosting": OpenCvKind(("legacy.TrackerBoosting",), {}),
    "medianflow": OpenCvKind(("legacy.TrackerMedianFlow",), {}),
    "tld": OpenCvKind(("legacy.TrackerTLD",), {}),
    "mosse": OpenCvKind(("legacy.TrackerMOSSE",), {}),
}


def opencv_tracker_names() -> list[str]:
    """Return the names of those that this OpenCV was built with."""
    return [name for name, kind in OPENCV_KINDS.items() if _find_class(kind) is not None]


class OpenCvTracker:
    """One of OpenCV's trackers. The start is rounded to whole pixels, because OpenCV wants that.

    Attributes:
        name: a short name for tables and logs.
    """

    def __init__(self, name: str, find_file: Callable[[str], Path]) -> None:
        """Make a tracker, with its networks loaded.

        Args:
            name: a key of `OPENCV_KINDS`.
            find_file: gives the path of a network's file by its name.

        Raises:
            ValueError: this OpenCV was built without that tracker.
            ModelError: a network's file is missing, or OpenCV cannot load it.
        """
        kind = OPENCV_KINDS[name]
        tracker_class = _find_class(kind)
        if tracker_class is None:
            raise ValueError(
                f"this OpenCV has no {name} tracker; it has {', '.join(opencv_tracker_names())} "
                "(opencv-contrib-python-headless has more)"
            )
        self._class = tracker_class
        self._files = {part: _existing(find_file(file)) for part, file in kind.files.items()}
        self.name = name
        self._loaded = self._load() if self._files else None
        self._tracker: Any = None
        self._box: Box | None = None

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR.

        Raises:
            ValueError: OpenCV refuses the box.
        """
        start = _whole_pixels(box, image)
        if self.name == "mil":
            _check_for_mil(start, image)
        tracker, self._loaded, self._tracker = self._loaded or self._load(), None, None
        try:
            tracker.init(image, start)
        except (cv2.error, SystemError) as error:
            raise ValueError(
                f"OpenCV's {self.name} tracker cannot start: {_said(error)}"
            ) from error
        self._tracker, self._box = tracker, box

    def _load(self) -> Any:
        """Return OpenCV's tracker, not started yet."""
        try:
            with _no_warnings():
                return _create(self._class, self._files)
        except (cv2.error, SystemError) as error:
            files = ", ".join(self._files.values())
            raise ModelError(
                f"OpenCV's {self.name} tracker cannot load {files}: {_said(error)}; "
                "`follower models verify` says which file is wrong"
            ) from error

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image; confidence 0 and the last box where OpenCV does not.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._tracker is None or self._box is None:
            raise RuntimeError("the tracker was not started")
        try:
            found, (x, y, width, height) = self._tracker.update(image)
        except cv2.error:
            # Some of OpenCV's trackers raise when the box has left the image.
            return MotionEstimate(self._box, 0.0)
        if not found or width <= 0 or height <= 0:
            return MotionEstimate(self._box, 0.0)
        self._box = Box.from_xywh(float(x), float(y), float(width), float(height))
        return MotionEstimate(self._box, self._score())

    def _score(self) -> float:
        """Return the tracker's own score, or 1 for those without a network: they have none."""
        if not self._files:
            return 1.0
        return min(max(float(self._tracker.getTrackingScore()), 0.0), 1.0)


def _said(error: Exception) -> str:
    return str(error).splitlines()[0]


def _find_class(kind: OpenCvKind) -> Any:
    for path in kind.classes:
        try:
            return attrgetter(path)(cv2)
        except AttributeError:
            continue
    return None


def _existing(path: Path) -> str:
    check_model(path)
    return str(path)


def _create(tracker_class: Any, files: Mapping[str, str]) -> Any:
    # The classes of OpenCV's legacy module are made by a function beside them.
    if not hasattr(tracker_class, "create"):
        name = tracker_class.__name__.removeprefix("legacy_")
        return attrgetter(f"legacy.{name}_create")(cv2)()
    if not files:
        return tracker_class.create()
    parameters = getattr(cv2, f"{tracker_class.__name__}_Params")()
    for part, path in files.items():
        setattr(parameters, part, path)
    return tracker_class.create(parameters)


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Keep OpenCV from warning, of each network it loads, that its engine takes no target."""
    logging = cv2.utils.logging
    before = logging.getLogLevel()
    logging.setLogLevel(min(before, logging.LOG_LEVEL_ERROR))
    try:
        yield
    finally:
        logging.setLogLevel(before)


def _check_for_mil(start: tuple[int, int, int, int], image: Image) -> None:
    """Refuse boxes that OpenCV's MIL draws samples for without end."""
    _, _, width, height = start
    if width * height < _LEAST_MIL_AREA:
        raise ValueError(f"OpenCV's mil tracker needs a larger box than {width}x{height} pixels")
    if width >= image.shape[1] or height >= image.shape[0]:
        raise ValueError("OpenCV's mil tracker needs some image around the box")


def _whole_pixels(box: Box, image: Image) -> tuple[int, int, int, int]:
    """Round to whole pixels and cut at the image's edges, which OpenCV needs."""
    height, width = image.shape[:2]
    left = min(max(round(box.left), 0), width - 1)
    top = min(max(round(box.top), 0), height - 1)
    right = min(max(round(box.right), left + 1), width)
    bottom = min(max(round(box.bottom), top + 1), height)
    return left, top, right - left, bottom - top
