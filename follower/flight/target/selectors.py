"""Ways to point out the target."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from follower.flight.target.candidate_image import NumberedObject, numbered, summary
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detector
from follower_vision.detection.detectors import scan
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.selection import ColourSearchSettings, colour_from_hex, find_by_colour
from follower_vision.sources.frame_source import SourceError

Selector: TypeAlias = Callable[[Frame], Box | None]
"""Finds the box to follow in a frame, or None if it is not there (yet)."""


TargetsSelector: TypeAlias = Callable[[Frame], list[Box]]
"""Finds the boxes of all targets in a frame, or none while one is not there (yet)."""

_LOGGER = logging.getLogger(__name__)
_LEAST_IN_IMAGE = 0.5


def box_selector(target: Box) -> Selector:
    """Select what `target` shows in the next frame; what of it lies outside is cut off, and told.

    The selector raises SourceError if less than half of the box lies in the image.
    """

    def select(frame: Frame) -> Box:
        check_in_image(target, frame.width, frame.height)
        inside = target.clipped(frame.width, frame.height) or target
        if inside is not target:
            said = "the target %s reaches beyond the image, which is %dx%d: %s is followed"
            _LOGGER.warning(said, _text(target), frame.width, frame.height, _text(inside))
        return inside

    return select


def check_in_image(target: Box, width: int, height: int) -> None:
    """Refuse a target that an image of this size, in pixels, does not show.

    Raises:
        SourceError: less than half of the box lies in the image.
    """
    share = target.visible_share(width, height)
    if share < _LEAST_IN_IMAGE:
        where = "outside" if share == 0 else f"with {share:.0%} of it only in"
        raise SourceError(
            f"the target {_text(target)} lies {where} the image, which is "
            f"{width}x{height}: give x,y,w,h of a box in the first frame"
        )


def _text(box: Box) -> str:
    return ",".join(f"{number:g}" for number in box.xywh)


def colour_selector(
    colour: str,
    search: ColourSearchSettings | None = None,
    pointed: Callable[[Frame], Box | None] | None = None,
) -> Selector:
    """Select the best thing of a colour ("#rrggbb"), as soon as one is seen.

    Args:
        colour: what it has.
        search: how like that it has to be.
        pointed: where in a frame somebody points who knows which of several is meant; what has its
            middle no farther than a size from there is meant. None: the best by itself.

    Raises:
        SettingsError: the text is no colour.
    """
    try:
        wanted = colour_from_hex(colour)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    settings = search or ColourSearchSettings()

    def select(frame: Frame) -> Box | None:
        candidates = find_by_colour(frame.image, wanted, settings)
        if pointed is None:
            return candidates[0] if candidates else None
        meant = pointed(frame)
        if meant is None:
            return None
        candidates = [box for box in candidates if box.distance(meant) < meant.scale]
        return min(candidates, key=meant.distance, default=None)

    return select


def all_selected(selectors: Sequence[Selector]) -> TargetsSelector:
    """Select several targets, in the first frame in which all of them are found."""

    def select(frame: Frame) -> list[Box]:
        found = [selector(frame) for selector in selectors]
        boxes = [box for box in found if box is not None]
        return boxes if len(boxes) == len(found) else []

    return select


def first_selected(selector: TargetsSelector) -> Selector:
    """Select the first target, as soon as all are found; meanwhile, too few are no error."""

    def select(frame: Frame) -> Box | None:
        try:
            return next(iter(selector(frame)), None)
        except ChoiceError:
            return None

    return select


class ChoiceError(SourceError):
    """What was asked for cannot be identified among what is seen; the user is to choose again.

    Attributes:
        image: of the frame looked at, (H, W, 3) uint8 BGR.
        candidates: what is seen in it.
    """

    def __init__(self, message: str, image: Image, candidates: Sequence[NumberedObject]) -> None:
        super().__init__(message)
        self.image = image
        self.candidates = candidates


@dataclass(frozen=True, slots=True)
class Wanted:
    """One object that a user asks for.

    Attributes:
        text: as written.
        class_name: None is any.
        number: within the class, or among all without one; None is the nearest to the centre.
    """

    text: str
    class_name: str | None
    number: int | None

    @classmethod
    def parse(cls, text: str, class_names: Sequence[str] | None) -> Wanted:
        """Read "person", "person:2" or "2".

        Args:
            text: as written.
            class_names: the detector's; None, where they are not known yet, takes any class.

        Raises:
            SettingsError: it is none of these, or the detector does not know the class.
        """
        name, separator, number = text.strip().lower().rpartition(":")
        if not separator:
            name, number = ("", number) if number.isdecimal() else (number, "")
        empty = not name and not number
        if empty or ((separator or number) and not (number.isdecimal() and int(number) > 0)):
            raise SettingsError(f"--select {text}: write a class, person:2, or 2; the first is 1")
        names = [name] if class_names is None else class_names
        known = {one.lower(): one for one in names}
        if name and name not in known:
            raise SettingsError(f"--select {text}: {_advice(name, names)}")
        return cls(text, known[name] if name else None, int(number) if number else None)

    def matches(self, candidates: Sequence[NumberedObject]) -> list[NumberedObject]:
        """Return the candidates of the class, in their order."""
        return [one for one in candidates if self.class_name in (None, one.class_name)]


class ObjectSelector:
    """Finds all objects wanted in the first frame in which each class wanted is seen.

    Numbers are those of that frame, counted from its centre. In a large image its enlarged parts
    are searched as well.

    Attributes:
        candidates: everything that is seen in the frame looked at last.
        chosen: what was chosen, in the order asked for; empty while something is missing.
    """

    def __init__(self, wanted: Sequence[Wanted], detector: Detector) -> None:
        self._wanted = tuple(wanted)
        self._detector = detector
        self.candidates: list[NumberedObject] = []
        self.chosen: list[NumberedObject] = []

    def __call__(self, frame: Frame) -> list[Box]:
        """Return the boxes wanted, or none while a class is not seen.

        Raises:
            ChoiceError: a number is too large, or two selections mean the same object.
        """
        self.candidates = numbered(scan(self._detector, frame.image), frame)
        if not all(wanted.matches(self.candidates) for wanted in self._wanted):
            return []
        chosen = [self._pick(wanted, frame) for wanted in self._wanted]
        for index, one in enumerate(chosen):
            if one in chosen[:index]:
                first = self._wanted[chosen.index(one)].text
                raise self._error(
                    frame, f"--select {first} and {self._wanted[index].text} are the same object"
                )
        self.chosen = chosen
        return [one.box for one in chosen]

    def _pick(self, wanted: Wanted, frame: Frame) -> NumberedObject:
        matches = wanted.matches(self.candidates)
        number = wanted.number or 1
        if number > len(matches):
            raise self._error(
                frame, f"--select {wanted.text}: only {summary(matches)} in frame {frame.sequence}"
            )
        return matches[number - 1]

    def _error(self, frame: Frame, message: str) -> ChoiceError:
        return ChoiceError(message, frame.image, self.candidates)


def _advice(name: str, class_names: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, [one.lower() for one in class_names], 1)
    if near:
        return f"the detector does not know {name!r}; did you mean {near[0]!r}?"
    return f"the detector does not know {name!r}; it knows {', '.join(class_names)}"
