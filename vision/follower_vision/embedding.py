"""Appearance networks: a box's content becomes a vector, alike for the same individual."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from follower_vision.box import Box
from follower_vision.crop import crop
from follower_vision.frame import Image
from follower_vision.models.model import Purpose
from follower_vision.models.store import ModelStore
from follower_vision.network import ModelError, Network, Tensor

_MEAN_RGB = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION_RGB = np.array([0.229, 0.224, 0.225], np.float32)
_FILL_BGR = (104.0, 116.0, 124.0)


class Embedder(Protocol):
    """Whatever tells one individual from another by a vector."""

    def embed(self, image: Image, box: Box) -> Tensor:
        """Return a vector of length 1 for what `box` shows in an (H, W, 3) uint8 BGR image."""
        ...


class OnnxEmbedder:
    """An appearance network from an ONNX file, such as OSNet for persons.

    OSNet: Zhou et al., "Omni-Scale Feature Learning for Person Re-Identification" (ICCV 2019). It
    takes RGB crops with ImageNet's mean and deviation; the crop's size is the network's own.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        """Load the network.

        Raises:
            ModelError: the file is missing, broken or no network from one picture to one vector.
        """
        self._network = Network(path, threads)
        shapes = list(self._network.inputs.values())
        if len(shapes) != 1 or len(shapes[0]) != 4 or shapes[0][1] != 3 or min(shapes[0][2:]) <= 0:
            raise ModelError(f"{path}: not an appearance network: its inputs are {shapes}")
        if len(self._network.outputs) != 1:
            raise ModelError(f"{path}: not an appearance network: it has several outputs")
        self._height, self._width = shapes[0][2:]

    def embed(self, image: Image, box: Box) -> Tensor:
        """Return a vector of length 1 for what `box` shows in an (H, W, 3) uint8 BGR image."""
        cut = crop(image, box, self._width, self._height, _FILL_BGR)
        normal = (cut[..., ::-1].astype(np.float32) / 255 - _MEAN_RGB) / _DEVIATION_RGB
        tensor = np.ascontiguousarray(normal.transpose(2, 0, 1)[None], dtype=np.float32)
        vector = self._network.run(tensor)[0].ravel()
        return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12), np.float32)


def make_embedder(name: str, store: ModelStore) -> OnnxEmbedder:
    """Return an appearance network from the table, or from the user's own ONNX file.

    Args:
        name: of a model in the table, or a path that ends in .onnx.
        store: where the networks lie.

    Raises:
        ModelError: there is no such network, or its file is missing or broken.
    """
    path = Path(name).expanduser()
    if path.suffix == ".onnx":
        return OnnxEmbedder(path)
    model = store.model(name)
    if model.purpose is not Purpose.APPEARANCE:
        names = [one.name for one in store.models if one.purpose is Purpose.APPEARANCE]
        raise ModelError(f"{name} is no appearance network; there are {', '.join(names)}")
    return OnnxEmbedder(store.paths(model)[0])


class Gallery:
    """The vectors of one individual: the first view, and the latest ones."""

    def __init__(self, embedder: Embedder, most: int = 6) -> None:
        """Make an empty one that keeps `most` views."""
        self._embedder = embedder
        self._most = most
        self._views: list[Tensor] = []

    def start(self, image: Image, box: Box) -> None:
        """Forget everything and take the first view."""
        self._views = [self._embedder.embed(image, box)]

    def learn(self, image: Image, box: Box) -> None:
        """Take another view, in place of the oldest but the first."""
        self._views.append(self._embedder.embed(image, box))
        if len(self._views) > self._most:
            self._views.pop(1)

    def likeness(self, image: Image, box: Box) -> float:
        """Return the largest cosine between a box and the views, -1 to 1.

        Raises:
            RuntimeError: `start` was not called.
        """
        if not self._views:
            raise RuntimeError("nothing was learnt yet")
        return float(max(np.stack(self._views) @ self._embedder.embed(image, box)))
