"""One image in memory that two processes share."""

from __future__ import annotations

import mmap
import os

import numpy as np

from follower_vision.frame import Image

_MOST_BYTES = 100_000_000


class SharedImage:
    """One slot: the writer waits with the next image until the reader has copied this one.

    Args:
        descriptor: of the memory; both processes have it.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._map: mmap.mmap | None = None
        self._bytes = 0

    @classmethod
    def make(cls) -> SharedImage:
        """Return a slot of new memory, which the child inherits by its descriptor."""
        return cls(os.memfd_create("follower-image"))

    def write(self, image: Image) -> None:
        """Put an image, (H, W, 3) uint8 BGR, into the slot."""
        if image.nbytes > self._bytes:
            os.ftruncate(self.descriptor, image.nbytes)
        np.copyto(self._view(image.shape[0], image.shape[1]), image)

    def read(self, height: int, width: int) -> Image:
        """Return a copy of the image, whose size the writer told.

        Raises:
            ValueError: there is no image of that size.
        """
        return self._view(height, width).copy()

    def close(self) -> None:
        """Give the memory back."""
        self._map = None
        os.close(self.descriptor)

    def _view(self, height: int, width: int) -> Image:
        length = height * width * 3
        if not 0 < length <= _MOST_BYTES:
            raise ValueError(f"no image has {width}x{height} pixels")
        if self._map is None or length > self._bytes:
            if os.fstat(self.descriptor).st_size < length:
                raise ValueError("there is no image yet")
            self._map = mmap.mmap(self.descriptor, length)
            self._bytes = length
        return np.frombuffer(self._map, np.uint8, length).reshape(height, width, 3)
