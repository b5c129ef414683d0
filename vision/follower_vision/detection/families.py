"""The families of detection networks, and which one a network is of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from follower_vision.detection.candidates import Candidates
from follower_vision.detection.fastestdet import FastestDetDecoder
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.nanodet import NanoDetDecoder
from follower_vision.detection.pixels import InputFormat
from follower_vision.detection.yolov2 import YoloV2Decoder
from follower_vision.detection.yolov8 import YoloV8Decoder
from follower_vision.detection.yolox import YoloxDecoder
from follower_vision.network import Tensor


class Decoder(Protocol):
    """Knows what a family's networks are shown, and what their answers mean."""

    @property
    def input_format(self) -> InputFormat:
        """What the networks are shown."""
        ...

    @property
    def classes(self) -> int:
        """How many classes the network tells apart."""
        ...

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        ...


class DecoderClass(Protocol):
    """Makes a decoder for the networks that fit."""

    def __call__(self, layout: NetworkLayout) -> Decoder:
        """Make the decoder for one network."""
        ...

    def fits(self, layout: NetworkLayout) -> bool:
        """Tell whether a network's outputs look like this family's."""
        ...


FAMILIES: Mapping[str, DecoderClass] = {
    "yolox": YoloxDecoder,
    "yolov8": YoloV8Decoder,
    "nanodet": NanoDetDecoder,
    "fastestdet": FastestDetDecoder,
    "yolov2": YoloV2Decoder,
}


def make_decoder(layout: NetworkLayout, family: str | None = None) -> Decoder:
    """Return the decoder for a network, of the family named or of the one that it looks like.

    Raises:
        ValueError: there is no such family, or the network is of none or of another.
    """
    if family is not None and family not in FAMILIES:
        raise ValueError(f"no family {family!r}; there are {', '.join(FAMILIES)}")
    wanted = list(FAMILIES) if family is None else [family]
    for name in wanted:
        if FAMILIES[name].fits(layout):
            return FAMILIES[name](layout)
    raise ValueError(f"not a detector of the family {' or '.join(wanted)}: {layout}")
