"""Points out targets by what a detector sees: "person", "person:2", "2"."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass

from follower.candidates import Candidate, numbered, summary
from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.detection import Detector
from follower_vision.detection.scan import scan
from follower_vision.frame import Frame, Image
from follower_vision.framesource import SourceError


class ChoiceError(SourceError):
    """What was asked for cannot be told among what is seen; the user is to choose again.

    Attributes:
        image: of the frame looked at, (H, W, 3) uint8 BGR.
        candidates: what is seen in it.
    """

    def __init__(self, message: str, image: Image, candidates: Sequence[Candidate]) -> None:
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
    def parse(cls, text: str, class_names: Sequence[str]) -> Wanted:
        """Read "person", "person:2" or "2".

        Raises:
            SettingsError: it is none of these, or the detector does not know the class.
        """
        name, separator, number = text.strip().lower().rpartition(":")
        if not separator:
            name, number = ("", number) if number.isdecimal() else (number, "")
        empty = not name and not number
        if empty or ((separator or number) and not (number.isdecimal() and int(number) > 0)):
            raise SettingsError(f"--select {text}: write a class, person:2, or 2; the first is 1")
        known = {one.lower(): one for one in class_names}
        if name and name not in known:
            raise SettingsError(f"--select {text}: {_advice(name, class_names)}")
        return cls(text, known.get(name), int(number) if number else None)

    def matches(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Return the candidates of the class, in their order."""
        return [one for one in candidates if self.class_name in (None, one.class_name)]


class ObjectSelector:
    """Finds all objects wanted in the first frame in which each class wanted is seen.

    Numbers are those of that frame, counted from its centre. In a large image its enlarged parts
    are searched as well.
    """

    def __init__(self, wanted: Sequence[Wanted], detector: Detector) -> None:
        self._wanted = tuple(wanted)
        self._detector = detector
        self._candidates: list[Candidate] = []
        self._chosen: list[Candidate] = []

    @property
    def candidates(self) -> list[Candidate]:
        """Everything that is seen in the frame looked at last."""
        return self._candidates

    @property
    def chosen(self) -> list[Candidate]:
        """What was chosen, in the order asked for; empty while something is missing."""
        return self._chosen

    def __call__(self, frame: Frame) -> list[Box]:
        """Return the boxes wanted, or none while a class is not seen.

        Raises:
            ChoiceError: a number is too large, or two wishes mean the same object.
        """
        self._candidates = numbered(scan(self._detector, frame.image), frame)
        if not all(wanted.matches(self._candidates) for wanted in self._wanted):
            return []
        chosen = [self._pick(wanted, frame) for wanted in self._wanted]
        for index, one in enumerate(chosen):
            if one in chosen[:index]:
                first = self._wanted[chosen.index(one)].text
                raise self._error(
                    frame, f"--select {first} and {self._wanted[index].text} are the same object"
                )
        self._chosen = chosen
        return [one.box for one in chosen]

    def _pick(self, wanted: Wanted, frame: Frame) -> Candidate:
        matches = wanted.matches(self._candidates)
        number = wanted.number or 1
        if number > len(matches):
            raise self._error(
                frame, f"--select {wanted.text}: only {summary(matches)} in frame {frame.sequence}"
            )
        return matches[number - 1]

    def _error(self, frame: Frame, message: str) -> ChoiceError:
        return ChoiceError(message, frame.image, self._candidates)


def _advice(name: str, class_names: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, [one.lower() for one in class_names], 1)
    if near:
        return f"the detector does not know {name!r}; did you mean {near[0]!r}?"
    return f"the detector does not know {name!r}; it knows {', '.join(class_names)}"
