"""One image with the time at which it was taken."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Image: TypeAlias = npt.NDArray[np.uint8]
"""Shape (H, W, 3), uint8, channels blue, green, red (OpenCV's order)."""


@dataclass(frozen=True, slots=True)
class Frame:
    """An image from a camera or a file. `image` is read-only by convention.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        captured_s: time of the middle of the exposure, on the system's clock.
        sequence: the source's frame number from 0; a gap means dropped frames.

    Raises:
        ValueError: the image has another shape or type.

    Examples:
        >>> import follower, numpy
        >>> image = numpy.zeros((480, 640, 3), numpy.uint8)  # from a camera of your own
        >>> frame = follower.Frame(image, captured_s=12.5, sequence=375)
        >>> frame.width, frame.height
        (640, 480)
    """

    image: Image
    captured_s: float
    sequence: int

    def __post_init__(self) -> None:
        if self.image.ndim != 3 or self.image.shape[2] != 3 or self.image.dtype != np.uint8:
            raise ValueError(
                f"a frame's image is (H, W, 3) uint8, not {self.image.shape} {self.image.dtype}"
            )

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return int(self.image.shape[1])

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return int(self.image.shape[0])


def load_image(path: Path) -> Image | None:
    """Read an image file of whatever name; None if it is missing or no image.

    OpenCV's own reading does not get along with names that are not UTF-8: it ends the program.
    """
    try:
        content = np.fromfile(path, np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
    return None if image is None else np.asarray(image, np.uint8)
