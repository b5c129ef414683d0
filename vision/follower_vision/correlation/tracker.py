"""The correlation tracker: translation and scale filters around one box."""

from __future__ import annotations

import math

import numpy as np

from follower_vision.box import Box
from follower_vision.correlation.features import Features
from follower_vision.correlation.filter import BackgroundAwareFilter, Spectrum, spectrum
from follower_vision.correlation.patch import cut
from follower_vision.correlation.peak import Peak, find_peak
from follower_vision.correlation.scale import ScaleFilter
from follower_vision.correlation.settings import CorrelationSettings
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate

_RATIO_OF_NOISE = 3.0
_RATIO_OF_CERTAINTY = 20.0
_SIZE_RANGE = 5.0


class CorrelationTracker:
    """A motion tracker without weights; implements `MotionTracker`.

    Deterministic: the same images give the same boxes, bit for bit.

    Args:
        settings: see there.
    """

    name = "correlation"

    def __init__(self, settings: CorrelationSettings | None = None) -> None:
        self._settings = settings or CorrelationSettings()
        s = self._settings
        self._cells = s.patch_px // s.cell_px
        self._features = Features(s.patch_px, s.cell_px, s.gradient_channels, s.colour_channels)
        self._box: Box | None = None

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`; everything earlier is forgotten."""
        s = self._settings
        per_px = self._cells / (s.search_factor * box.scale)
        self._filter = BackgroundAwareFilter(
            self._cells,
            box.width * per_px,
            box.height * per_px,
            box.scale * per_px * s.label_sigma,
            s.regularisation,
            s.iterations,
        )
        lobe = max(2, round(0.5 * min(box.width, box.height) * per_px))
        self._lobe = lobe
        self._scale = ScaleFilter(box, s.scale_count, s.scale_step, s.scale_regularisation)
        self._first = box
        self._box = box
        self._features.start(self._patch(image, box))
        self._filter.learn(self._sample(image, box), 1.0)
        self._scale.learn(image, box, 1.0)

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR of any size.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        sample = self._sample(image, self._box)
        peak = find_peak(self._filter.response(sample), self._lobe, self._lobe)
        confidence = _confidence(peak)
        box = self._moved(self._box, peak, image)
        if confidence > self._settings.learning_confidence:
            box = self._resized(box, self._scale.factor(image, box))
            self._filter.learn(self._centred(sample, peak), self._settings.learning_rate)
            self._scale.learn(image, box, self._settings.scale_learning_rate)
        self._box = box
        return MotionEstimate(box, confidence)

    def _patch(self, image: Image, box: Box) -> Image:
        side = self._settings.search_factor * box.scale
        region = Box(box.cx, box.cy, side, side)
        return cut(image, region, self._settings.patch_px, self._settings.patch_px)

    def _sample(self, image: Image, box: Box) -> Spectrum:
        return spectrum(self._features(self._patch(image, box)))

    def _centred(self, sample: Spectrum, peak: Peak) -> Spectrum:
        """The sample with the peak shifted to the middle, which saves a second patch."""
        down = np.fft.fftfreq(self._cells)[:, None] * peak.down
        across = np.fft.rfftfreq(self._cells)[None] * peak.across
        turn = np.exp(2j * math.pi * (down + across))
        return np.asarray(sample * turn.astype(np.complex64), np.complex64)

    def _moved(self, box: Box, peak: Peak, image: Image) -> Box:
        """The box at the peak, its centre kept in the image."""
        cell = self._settings.search_factor * box.scale / self._cells
        height, width = image.shape[:2]
        cx = min(max(box.cx + peak.across * cell, 0.0), float(width))
        cy = min(max(box.cy + peak.down * cell, 0.0), float(height))
        return box.moved_to(cx, cy)

    def _resized(self, box: Box, factor: float) -> Box:
        """The box scaled, within bounds about the first one."""
        smallest = self._settings.minimum_side_px / min(box.width, box.height)
        smallest = max(min(1.0, smallest), self._first.scale / (_SIZE_RANGE * box.scale))
        largest = self._first.scale * _SIZE_RANGE / box.scale
        return box.scaled(min(max(factor, smallest), largest))


def _confidence(peak: Peak) -> float:
    """Map the peak to sidelobe ratio to 0 (noise) to 1 (certain)."""
    share = (peak.sidelobe_ratio - _RATIO_OF_NOISE) / (_RATIO_OF_CERTAINTY - _RATIO_OF_NOISE)
    return min(1.0, max(0.0, share))
