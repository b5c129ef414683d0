"""The shapes by which a detector's family is recognised."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NetworkLayout:
    """What goes into a detection network and comes out.

    Attributes:
        height: of the input, in pixels.
        width: of the input, in pixels.
        outputs: name and shape of every output, in order.
        anchors: widths and heights, in cells, that the file names; () if it names none.
    """

    height: int
    width: int
    outputs: tuple[tuple[str, tuple[int, ...]], ...]
    anchors: tuple[tuple[float, float], ...] = ()

    @property
    def only_output(self) -> tuple[int, ...]:
        """The shape of the output if there is one alone, else ()."""
        return self.outputs[0][1] if len(self.outputs) == 1 else ()

    def grid(self, stride: int) -> tuple[int, int]:
        """Return rows and columns of the grid of cells of `stride` pixels."""
        return math.ceil(self.height / stride), math.ceil(self.width / stride)

    def cells(self, strides: Sequence[int]) -> int:
        """Return the number of cells on all grids together."""
        return sum(math.prod(self.grid(stride)) for stride in strides)

    def __str__(self) -> str:
        outputs = ", ".join(f"{name} {shape}" for name, shape in self.outputs)
        return f"input {self.width}x{self.height}, outputs {outputs}"
