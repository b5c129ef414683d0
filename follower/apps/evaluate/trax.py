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
from follower_vision.evaluation.one_pass import DatasetError, read_image, start_box
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.target_tracker import TargetTracker

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
        f'hello trax.version=3 "trax.name={contender.name}" "trax.description=drone target follower"'
        " trax.image=path trax.region=rectangle trax.channels=color",
    )
    tracker: TargetTracker | None = None
    number = 0
    try:
        for kind, arguments in _messages(requests):
            if kind == "quit":
                return
            image = _image(arguments[0])
            if kind == "initialize":
                tracker, number = contender.make(), 0
                track = tracker.start(Frame(image, 0.0, 0), start_box(_box(arguments[1]), image))
            elif tracker is None:
                raise SettingsError("a frame before any target was chosen")
            else:
                number += 1
                track = tracker.step(Frame(image, number / rate_hz, number))
            region = ",".join(repr(float(value)) for value in track.box.xywh)
            _send(answers, f'state "{region}" confidence={track.confidence:.6f}')
    except (SettingsError, DatasetError, OSError) as error:
        reason = str(error).replace("\\", "/").replace('"', "'")
        _send(answers, f'quit "trax.reason={reason}"')
        raise SettingsError(f"TraX: {error}") from None


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
        yield kind, arguments


def _image(address: str) -> Image:
    return read_image(Path(address.removeprefix("file://")))


def _box(region: str) -> Box:
    try:
        return Box.from_xywh(*map(float, region.split(",")))
    except (TypeError, ValueError):
        raise SettingsError(f"no box in {region[:60]!r}: give x,y,w,h") from None


def _send(answers: TextIO, message: str) -> None:
    answers.write(f"{_PREFIX}{message}\n")
    answers.flush()
