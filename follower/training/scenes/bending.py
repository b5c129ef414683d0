"""Objects that change their shape as people and animals do."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower.training.scenes.cutout import Cutout


class Bending:
    """A smooth displacement of an object's pixels that swings over time."""

    def __init__(self, fields: npt.NDArray[np.float32], swings: npt.NDArray[np.float64]) -> None:
        """Make a bending.

        Args:
            fields: (2, H, W, 2) two displacements at full swing, in the object's pixels.
            swings: (T, 2) how far each is swung in each frame.
        """
        self.fields = fields
        self.swings = swings
        self._last: dict[int, Cutout] = {}

    def bent(self, cutout: Cutout, frame: int) -> Cutout:
        """Return the object's shape in a frame; the last two answers are kept."""
        if frame not in self._last:
            kept = list(self._last.items())[-1:]
            self._last = dict(kept) | {frame: self._shape(cutout, frame)}
        return self._last[frame]

    def _shape(self, cutout: Cutout, frame: int) -> Cutout:
        picture = cutout.levels[0]
        height, width = picture.shape[:2]
        columns, rows = np.meshgrid(
            np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
        )
        first, second = (np.float32(swing) for swing in self.swings[frame])
        shift = first * self.fields[0] + second * self.fields[1]
        bent = cv2.remap(
            picture,
            columns + shift[:, :, 0],
            rows + shift[:, :, 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        )
        return Cutout.premultiplied(np.asarray(bent, dtype=np.uint8))


def random_bending(rng: np.random.Generator, cutout: Cutout, frames: int) -> Bending:
    """Return a bending for an object, at most a few tenths of its size."""
    width, height = cutout.size
    most = rng.uniform(0.03, 0.15) * min(width, height)
    coarse = rng.normal(0.0, 1.0, (2, 4, 4, 2)).astype(np.float32)
    fields = [
        most * cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC) for field in coarse
    ]
    time = np.arange(frames)
    speeds, phases = rng.uniform(0.05, 0.5, 2), rng.uniform(0, 2 * np.pi, 2)
    swings = np.sin(time[:, None] * speeds + phases)
    return Bending(np.stack(fields).astype(np.float32), swings)
