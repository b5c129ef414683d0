"""The names of a detector's classes."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence

VOC_CLASSES = (
    "aeroplane",
    "bicycle",
    "bird",
    "boat",
    "bottle",
    "bus",
    "car",
    "cat",
    "chair",
    "cow",
    "diningtable",
    "dog",
    "horse",
    "motorbike",
    "person",
    "pottedplant",
    "sheep",
    "sofa",
    "train",
    "tvmonitor",
)
COCO_CLASSES = (
    "person",
    "bicycle",
    "car",
    "motorcycle",
    "airplane",
    "bus",
    "train",
    "truck",
    "boat",
    "traffic light",
    "fire hydrant",
    "stop sign",
    "parking meter",
    "bench",
    "bird",
    "cat",
    "dog",
    "horse",
    "sheep",
    "cow",
    "elephant",
    "bear",
    "zebra",
    "giraffe",
    "backpack",
    "umbrella",
    "handbag",
    "tie",
    "suitcase",
    "frisbee",
    "skis",
    "snowboard",
    "sports ball",
    "kite",
    "baseball bat",
    "baseball glove",
    "skateboard",
    "surfboard",
    "tennis racket",
    "bottle",
    "wine glass",
    "cup",
    "fork",
    "knife",
    "spoon",
    "bowl",
    "banana",
    "apple",
    "sandwich",
    "orange",
    "broccoli",
    "carrot",
    "hot dog",
    "pizza",
    "donut",
    "cake",
    "chair",
    "couch",
    "potted plant",
    "bed",
    "dining table",
    "toilet",
    "tv",
    "laptop",
    "mouse",
    "remote",
    "keyboard",
    "cell phone",
    "microwave",
    "oven",
    "toaster",
    "sink",
    "refrigerator",
    "book",
    "clock",
    "vase",
    "scissors",
    "teddy bear",
    "hair drier",
    "toothbrush",
)


def choose_class_names(
    count: int, given: Sequence[str] | None, metadata: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the names: those given, else those in the file, else the usual for their number.

    Raises:
        ValueError: there are more or fewer names given than classes.
    """
    if given is not None:
        if len(given) != count:
            raise ValueError(f"{len(given)} class names were given for {count} classes")
        return tuple(given)
    written = _written_names(metadata.get("names", ""))
    if len(written) == count:
        return written
    usual = {80: COCO_CLASSES, 20: VOC_CLASSES}
    return usual.get(count) or tuple(f"class {number}" for number in range(count))


def _written_names(text: str) -> tuple[str, ...]:
    """Read a list or a numbered table of names, as exporters write them; () if it is neither."""
    try:
        names = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError):
        return ()
    if isinstance(names, dict):
        names = [names.get(number) for number in range(len(names))]
    if not isinstance(names, list | tuple):
        return ()
    return tuple(str(name) for name in names)
