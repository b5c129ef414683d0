"""How far a whole image moved, also where single corners cannot be followed."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

_LEAST_RESPONSE = 0.2

Grey = npt.NDArray[np.uint8]


def global_shift(last: Grey, grey: Grey) -> tuple[float, float] | None:
    """Return the shift between two images of one size, (H, W) uint8, by phase correlation.

    It finds shifts of up to a third of the image, through blur and over water, where optical flow
    follows nothing; it is blind to rotation and zoom.

    Returns:
        Pixels right and down; None if no shift stands out.
    """
    window = _window(grey.shape[1], grey.shape[0])
    first, second = last.astype(np.float32), grey.astype(np.float32)
    (right, down), response = cv2.phaseCorrelate(first, second, window)
    return (right, down) if response >= _LEAST_RESPONSE else None


@lru_cache(maxsize=4)
def _window(width: int, height: int) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.createHanningWindow((width, height), cv2.CV_32F), np.float32)
