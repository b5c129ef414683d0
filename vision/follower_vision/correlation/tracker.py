"""The correlation tracker: translation and scale filters around one box."""

from __future__ import annotations

import math

import numpy as np

from follower_vision.box import Box
from follower_vision.correlation.clarity import Clarity
from follower_vision.correlation.drift import Drift
from follower_vision.correlation.features import Features
from follower_vision.correlation.filter import BackgroundAwareFilter, Spectrum, spectrum
from follower_vision.correlation.patch import cut
from follower_vision.correlation.peak import Peak, find_peak
from follower_vision.correlation.scale import ScaleFilter
from follower_vision.correlation.settings import CorrelationSettings
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate

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
        self._first = self._box = box
        self._drift = Drift(s.drift_rate)
        self._clarity = Clarity(s.doubtful_share, s.full_share)
        self._scale = ScaleFilter(box, s.scale_count, s.scale_step, s.scale_regularisation)
        self._scale.start(image, box)
        self._filter = self._new_filter(box)
        self._features.start(self._patch(image, box))
        self._filter.learn(self._sample(image, box), 1.0)

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR of any size.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        region = _inside(self._drift.moved(self._box, self._settings.drift_share), image)
        sample = self._sample(image, region)
        peak = find_peak(self._filter.response(sample), self._lobe, self._lobe)
        box = self._located(self._box, region, peak, image)
        self._box = self._learnt(image, box, sample, peak)
        return MotionEstimate(self._box, self._clarity.confidence(peak.sidelobe_ratio))

    def _new_filter(self, box: Box) -> BackgroundAwareFilter:
        s = self._settings
        per_px = self._cells / (s.search_factor * box.scale)
        self._lobe = max(2, round(0.5 * min(box.width, box.height) * per_px))
        return BackgroundAwareFilter(
            self._cells,
            box.width * per_px,
            box.height * per_px,
            box.scale * per_px * s.label_sigma,
            s.regularisation,
            s.iterations,
        )

    def _patch(self, image: Image, box: Box) -> Image:
        side = self._settings.search_factor * box.scale
        region = Box(box.cx, box.cy, side, side)
        return cut(image, region, self._settings.patch_px, self._settings.patch_px)

    def _sample(self, image: Image, box: Box) -> Spectrum:
        return spectrum(self._features(self._patch(image, box)))

    def _located(self, last: Box, region: Box, peak: Peak, image: Image) -> Box:
        """The box at the peak in the search region; the last one where the peak is noise."""
        if peak.sidelobe_ratio < self._settings.noise_ratio:
            self._drift.stop()
            return _inside(last, image)
        cell = self._settings.search_factor * region.scale / self._cells
        at_peak = region.moved_to(region.cx + peak.across * cell, region.cy + peak.down * cell)
        box = _inside(at_peak, image)
        self._drift.follow(last, box)
        return box

    def _learnt(self, image: Image, box: Box, sample: Spectrum, peak: Peak) -> Box:
        """Learn the target, as far as its peak is clear, and return the box at its new size."""
        s = self._settings
        trust = self._clarity.trust(peak.sidelobe_ratio)
        self._clarity.remember(peak.sidelobe_ratio, trust)
        if trust <= 0:
            return box
        self._filter.learn(self._centred(sample, peak), s.learning_rate * trust)
        return self._resized(box, self._scale.update(image, box, s.scale_learning_rate * trust))

    def _centred(self, sample: Spectrum, peak: Peak) -> Spectrum:
        """The sample with the peak shifted to the middle, which saves a second patch."""
        down = np.fft.fftfreq(self._cells)[:, None] * peak.down
        across = np.fft.rfftfreq(self._cells)[None] * peak.across
        turn = np.exp(2j * math.pi * (down + across))
        return np.asarray(sample * turn.astype(np.complex64), np.complex64)

    def _resized(self, box: Box, factor: float) -> Box:
        """The box scaled, within bounds about the first one."""
        smallest = self._settings.minimum_side_px / min(box.width, box.height)
        smallest = max(min(1.0, smallest), self._first.scale / (_SIZE_RANGE * box.scale))
        largest = self._first.scale * _SIZE_RANGE / box.scale
        return box.scaled(min(max(factor, smallest), largest))


def _inside(box: Box, image: Image) -> Box:
    """The box with its centre moved into the image."""
    height, width = image.shape[:2]
    return box.moved_to(min(max(box.cx, 0.0), float(width)), min(max(box.cy, 0.0), float(height)))
