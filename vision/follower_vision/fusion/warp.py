"""How the background moved between two images."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from follower_vision.box import Box


@dataclass(frozen=True, slots=True)
class Warp:
    """A similarity: rotation, one scale and a shift, from one image's pixels to another's.

    A point (x, y) goes to (cosine x - sine y + right, sine x + cosine y + down); `cosine` and
    `sine` carry the scale.
    """

    cosine: float = 1.0
    sine: float = 0.0
    right: float = 0.0
    down: float = 0.0

    @property
    def zoom(self) -> float:
        """How much larger things became."""
        return math.hypot(self.cosine, self.sine)

    def turn(self, x: float, y: float) -> tuple[float, float]:
        """Return a direction or velocity after the motion."""
        return self.cosine * x - self.sine * y, self.sine * x + self.cosine * y

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Return where a point of the background went."""
        across, along = self.turn(x, y)
        return across + self.right, along + self.down

    def box(self, box: Box) -> Box:
        """Return where a box that stands still in the world went; its size stays.

        The zoom of a few hundred milliseconds is small and badly measured where the target fills
        much of the image.
        """
        return box.moved_to(*self.point(box.cx, box.cy))

    def then(self, later: Warp) -> Warp:
        """Return this motion followed by a later one."""
        cosine, sine = later.turn(self.cosine, self.sine)
        right, down = later.point(self.right, self.down)
        return Warp(cosine, sine, right, down)

    def halved(self) -> Warp:
        """Return the motion that, done twice, is this one."""
        root = cmath.sqrt(complex(self.cosine, self.sine))
        shift = complex(self.right, self.down) / (1 + root)
        return Warp(root.real, root.imag, shift.real, shift.imag)

    def back(self) -> Warp:
        """Return the motion that undoes this one."""
        square = self.zoom**2
        inverse = Warp(self.cosine / square, -self.sine / square)
        right, down = inverse.turn(self.right, self.down)
        return Warp(inverse.cosine, inverse.sine, -right, -down)
