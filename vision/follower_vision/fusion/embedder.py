"""Networks of other packages that describe what a box shows, in place of the motion tracker's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.plugins import Plugin, PluginError, PluginGroup, PluginGuard

Floats = npt.NDArray[np.floating]
EMBEDDER_PLUGINS = PluginGroup("follower.embedders", "embedder", ("embed",))
"""Each makes an `Embedder` when it is called."""


class Embedder(Protocol):
    """Turns what boxes show into vectors that are alike for one object, from view to view."""

    def embed(self, image: Image, boxes: Sequence[Box]) -> Floats:
        """Return (N, D) numbers, D always the same; their lengths do not count.

        Args:
            image: (H, W, 3) uint8 BGR.
            boxes: N of them in pixels, which may reach beyond the image.
        """
        ...


class GuardedEmbedder:
    """Asks a plug-in's embedder; where that raises or errs, nothing is alike."""

    def __init__(self, embedder: Embedder, plugin: Plugin) -> None:
        self._embedder = embedder
        self._plugin = plugin
        self._guard = PluginGuard(plugin, "is off for the rest of the run")
        self._width: int | None = None

    def embed(self, image: Image, boxes: Sequence[Box]) -> Floats:
        """Return (N, D) rows of length 1, or of 0.

        The first answer says D; if that one fails, it is not asked again, and nothing is alike.
        """
        nothing: Floats = np.zeros((len(boxes), self._width or 0))
        if self._width == 0:
            return nothing

        def ask() -> Floats:
            return np.asarray(self._embedder.embed(image, boxes), np.float64)

        def is_sound(rows: Floats) -> bool:
            fits = rows.ndim == 2 and len(rows) == len(boxes)
            known = self._width is None or rows.shape[1:] == (self._width,)
            return fits and known and bool(np.isfinite(rows).all())

        rows = self._guard.run(ask, nothing, is_sound)
        if self._width is None and rows.shape[1]:
            self._guard = PluginGuard(self._plugin, "counts as knowing nothing")
        self._width = rows.shape[1]
        lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
        return np.asarray(rows / np.maximum(lengths, 1e-9)[:, None])


def make_embedder(name: str | None) -> GuardedEmbedder | None:
    """Return the embedder that a package adds under a name; None for None.

    Raises:
        PluginError: there is none, or it cannot be used.
    """
    if name is None:
        return None
    plugin = EMBEDDER_PLUGINS.find(name)
    if plugin is None:
        there = ", ".join(EMBEDDER_PLUGINS.names()) or "none"
        raise PluginError(f"there is no embedder {name!r}; there are {there}")
    return GuardedEmbedder(plugin.make(), plugin)
