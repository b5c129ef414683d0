"""How a user names the targets: by box, by detected object, or by colour."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from follower.flight.target.selectors import (
    ObjectSelector,
    TargetsSelector,
    Wanted,
    all_selected,
    box_selector,
    colour_selector,
)
from follower.ui.terminal.cli_options import parse_box
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detector
from follower_vision.fusion.multi import MOST_TARGETS
from follower_vision.geometry.box import Box
from follower_vision.onnx_network import ModelError

LIST = "list"
"""What `follower track --select` takes instead of an object, to have them listed."""


@dataclass(frozen=True, slots=True)
class TargetChoice:
    """The targets as the command line names them, in one way alone.

    Attributes:
        boxes: in pixels, in the frame in which the choice is made.
        select: objects that a detector finds.
        colour: "#rrggbb".

    Raises:
        SettingsError: the options contradict each other.
    """

    boxes: tuple[Box, ...] = ()
    select: tuple[str, ...] = ()
    colour: str | None = None

    def __post_init__(self) -> None:
        if sum(map(bool, (self.boxes, self.select, self.colour))) > 1:
            raise SettingsError(
                "choose by one of --target, --select and --colour alone; `follower track --select "
                "list` prints the boxes of what is seen, which --target takes"
            )
        if self.count > MOST_TARGETS:
            raise SettingsError(f"at most {MOST_TARGETS} targets can be followed, not {self.count}")
        if LIST in self.select and len(self.select) > 1:
            raise SettingsError("--select list stands alone: it lists and follows nothing")

    @classmethod
    def of(
        cls, targets: Iterable[str] = (), select: Iterable[str] = (), colour: str | None = None
    ) -> TargetChoice:
        """Read the options `--target`, `--select` and `--colour`.

        Raises:
            SettingsError: an option cannot be read, or they contradict each other.
        """
        return cls(tuple(map(parse_box, targets)), tuple(select), colour)

    @classmethod
    def one(cls, target: Box | str) -> TargetChoice:
        """Return the choice of one target: a box in pixels, "#rrggbb", or an object's class.

        Raises:
            SettingsError: it is none of these.
        """
        if isinstance(target, Box):
            return cls(boxes=(target,))
        if not (isinstance(target, str) and target.strip()):
            raise SettingsError(
                f"which target? give a Box, a colour '#rrggbb' or a class, not {target!r}"
            )
        return cls(colour=target) if target.startswith("#") else cls(select=(target,))

    @property
    def given(self) -> bool:
        """Whether there is a choice."""
        return bool(self.boxes or self.select or self.colour)

    @property
    def count(self) -> int:
        """How many targets."""
        return max(1, len(self.boxes), len(self.select))

    def __str__(self) -> str:
        """Return the targets in words."""
        if self.select:
            return ", ".join(self.select)
        return "the target" if self.colour is None else f"something of colour {self.colour}"

    def selector(self, detector: Detector | None) -> TargetsSelector:
        """Return what finds the targets in a frame.

        Raises:
            SettingsError: what was asked for is no class or colour.
            ModelError: a class was asked for, and there is no detector.
        """
        if self.select:
            found = needed(detector)
            return ObjectSelector(
                [Wanted.parse(one, found.class_names) for one in self.select], found
            )
        if self.colour is not None:
            return all_selected([colour_selector(self.colour)])
        return all_selected([box_selector(box) for box in self.boxes])


def needed(detector: Detector | None) -> Detector:
    """Return the detector.

    Raises:
        ModelError: there is none.
    """
    if detector is None:
        raise ModelError("--select needs a detector; name one by --detector")
    return detector
