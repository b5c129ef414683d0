"""A tracker as a TraX server on standard input and output, so that vot-toolkit runs it.

Version 3 of the protocol (trax.readthedocs.io, "TraX protocol specification"): one target, images
by their path, boxes. Written here because its reference library has no build for ARM boards.
"""

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from follower.apps.evaluate.contender import Contender
from follower_control.common.strict_config import SettingsError
from follower_vision.evaluation.one_pass import DatasetError, read_image
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import Track

_PREFIX = "@@TRAX:"
_ARGUMENTS = {"initialize": 2, "frame": 1, "quit": 0}


def serve(contender: Contender, rate_hz: float, requests: TextIO, answers: TextIO) -> None:
    """Answer a client's requests until it quits or its stream ends.

    Args:
        contender: what to run; a fresh tracker for each target.
        rate_hz: the frames a second that the tracker is given.
        requests: the client's messages.
        answers: takes ours.

    Raises:
        SettingsError: a request cannot be carried out; the client was told.
        ModelError: a network is missing.
    """
    contender.make()  # what is missing is said before the client waits for a tracker
    _send(
        answers,
        f'hello trax.version=3 "trax.name={contender.name}" trax.image=path trax.region=rectangle'
        " trax.channels=color",  # without it the reference client asks for depth too
    )
    session = _Session(contender, rate_hz)
    try:
        for kind, arguments in _messages(requests):
            if kind == "quit":
                return
            track = session.answer(arguments)
            region = ",".join(repr(float(value)) for value in track.box.xywh)
            _send(answers, f'state "{region}" confidence={track.confidence:.6f}')
    except (SettingsError, DatasetError, OSError) as error:
        reason = str(error).replace("\\", "/").replace('"', "'")
        _send(answers, f'quit "trax.reason={reason}"')
        raise SettingsError(f"TraX: {error}") from None


class _Session:
    """The target that is followed, and the frames since it was chosen."""

    def __init__(self, contender: Contender, rate_hz: float) -> None:
        self._contender, self._rate_hz = contender, rate_hz
        self._tracker: TargetTracker | None = None
        self._number = 0

    def answer(self, arguments: list[str]) -> Track:
        """Start with an image and a region, or go on with an image."""
        image = read_image(Path(arguments[0].removeprefix("file://")))
        if len(arguments) > 1:
            self._number, box = 0, _box(arguments[1])
            self._tracker, track = self._contender.start(Frame(image, 0.0, 0), box)
            return track
        if self._tracker is None:
            raise SettingsError("a frame before any target was chosen")
        self._number += 1
        return self._tracker.step(Frame(image, self._number / self._rate_hz, self._number))


def _messages(requests: TextIO) -> Iterator[tuple[str, list[str]]]:
    """Yield the kind and the arguments of each message; other lines are none of ours."""
    for line in requests:
        if not line.startswith(_PREFIX):
            continue
        try:
            kind, *arguments = shlex.split(line.removeprefix(_PREFIX))
        except ValueError:
            raise SettingsError(f"no message in {line.strip()[:80]!r}") from None
        if kind not in _ARGUMENTS or len(arguments) < _ARGUMENTS[kind]:
            raise SettingsError(f"no request in {line.strip()[:80]!r}")
        yield kind, arguments[: _ARGUMENTS[kind]]


def _box(region: str) -> Box:
    try:
        return Box.from_xywh(*map(float, region.split(",")))
    except (TypeError, ValueError):
        raise SettingsError(f"no box in {region[:60]!r}: give x,y,w,h") from None


def _send(answers: TextIO, message: str) -> None:
    answers.write(f"{_PREFIX}{message}\n")
    answers.flush()
