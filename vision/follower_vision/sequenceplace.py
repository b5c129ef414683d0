"""Where a sequence's files lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class SequencePlace:
    """A sequence as it was found, not yet read.

    Attributes:
        name: for tables.
        folder: the images, or the folder above them.
        truth: the file of boxes.
        first: number of the image that the first box belongs to, from 1; used only where the
            folder has more images than the file has boxes.
        rate_hz: frames a second, None if the layout does not tell.
    """

    name: str
    folder: Path
    truth: Path
    first: int = 1
    rate_hz: float | None = None
