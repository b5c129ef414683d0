"""How the user's own pictures are used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class FolderSettings:
    """How a folder of labelled pictures is used.

    Attributes:
        held_out_share: of the pictures, kept from training to measure the quality; used where the
            folder itself does not part training from validation.
        views_a_picture: cut from a picture before the next one is read.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    held_out_share: float = 0.2
    views_a_picture: int = 3

    def __post_init__(self) -> None:
        if not 0 < self.held_out_share < 1:
            raise ValueError(f"held_out_share lies between 0 and 1, not {self.held_out_share}")
        if self.views_a_picture < 1:
            raise ValueError(f"views_a_picture is at least 1, not {self.views_a_picture}")
