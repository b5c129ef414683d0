"""The correlation tracker: translation and scale filters around one box."""

from __future__ import annotations

import math

import numpy as np

from follower_vision.box import Box
from follower_vision.correlation.clarity import Clarity
from follower_vision.correlation.drift import Drift
from follower_vision.correlation.features import Features
from follower_vision.correlation.filter import BackgroundAwareFilter, Spectrum, spectrum
from follower_vision.correlation.likelihood import ColourLikelihood, Colours
from follower_vision.correlation.patch import cut
from follower_vision.correlation.peak import Peak, Response, find_peak, sidelobe_ratio
from follower_vision.correlation.scale import ScaleFilter
from follower_vision.correlation.settings import CorrelationSettings
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate

_SIZE_RANGE = 5.0
_HEIGHT_MEMORY = 20


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
        self._start_filters(box)
        patch = self._patch(image, box)
        self._features.start(patch)
        self._filter.learn(spectrum(self._features(patch)), 1.0)
        self._colours.learn(self._colours.look(patch), 0.0, 0.0, 1.0)

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR of any size.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        region = _inside(self._drift.moved(self._box, self._settings.drift_share), image)
        patch = self._patch(image, region)
        sample = spectrum(self._features(patch))
        response = self._filter.response(sample)
        ratio = sidelobe_ratio(response, self._lobe)
        trust = self._clarity.trust(ratio)
        colours = self._colours.look(patch)
        peak = find_peak(self._with_colours(response, colours, trust))
        box = self._located(self._box, region, peak, ratio, image)
        self._clarity.remember(ratio, trust)
        if trust > 0:
            self._learn(sample, colours, peak, trust)
            box = self._resized(
                box, self._scale.update(image, box, trust * self._settings.scale_learning_rate)
            )
        self._box = box
        return MotionEstimate(box, self._clarity.confidence(ratio))

    def _start_filters(self, box: Box) -> None:
        s = self._settings
        per_px = self._cells / (s.search_factor * box.scale)
        columns, rows = box.width * per_px, box.height * per_px
        self._lobe = max(2, round(0.5 * min(columns, rows)))
        self._filter = BackgroundAwareFilter(
            self._cells,
            columns,
            rows,
            box.scale * per_px * s.label_sigma,
            s.regularisation,
            s.iterations,
        )
        self._colours = ColourLikelihood(self._cells, columns, rows)
        self._usual_height: float | None = None

    def _patch(self, image: Image, box: Box) -> Image:
        side = self._settings.search_factor * box.scale
        region = Box(box.cx, box.cy, side, side)
        return cut(image, region, self._settings.patch_px, self._settings.patch_px)

    def _with_colours(self, response: Response, colours: Colours, trust: float) -> Response:
        """The filter's response blended with the colours', the more the clearer it is.

        Colours alone would lead an occluded target's box to whatever looks alike nearby: they count
        only where the filter sees the target too, and as far as they tell target from surroundings.
        """
        height = float(response.max())
        if self._usual_height is None:
            self._usual_height = height
        share = self._settings.colour_share * trust * self._colours.usefulness()
        scaled = response * np.float32((1 - share) / max(self._usual_height, 1e-6))
        self._usual_height += (height - self._usual_height) / _HEIGHT_MEMORY
        return scaled + np.float32(share) * self._colours.response(colours) if share else scaled

    def _located(self, last: Box, region: Box, peak: Peak, ratio: float, image: Image) -> Box:
        """The box at the peak in the search region; the last one where the peak is noise."""
        if ratio < self._settings.noise_ratio:
            self._drift.stop()
            return _inside(last, image)
        cell = self._settings.search_factor * region.scale / self._cells
        at_peak = region.moved_to(region.cx + peak.across * cell, region.cy + peak.down * cell)
        box = _inside(at_peak, image)
        self._drift.follow(last, box)
        return box

    def _learn(self, sample: Spectrum, colours: Colours, peak: Peak, trust: float) -> None:
        s = self._settings
        self._filter.learn(self._centred(sample, peak), s.learning_rate * trust)
        self._colours.learn(colours, peak.across, peak.down, s.colour_learning_rate * trust)

    def _centred(self, sample: Spectrum, peak: Peak) -> Spectrum:
        """The sample with the peak shifted to the middle, which saves a second patch."""
        down = np.exp(2j * math.pi * peak.down * np.fft.fftfreq(self._cells))
        across = np.exp(2j * math.pi * peak.across * np.fft.rfftfreq(self._cells))
        return np.asarray(sample * np.outer(down, across).astype(np.complex64), np.complex64)

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
