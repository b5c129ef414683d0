"""The correlation tracker: translation and scale filters around one box."""

import math
from dataclasses import dataclass

import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.correlation.features import ColourLikelihood, Colours, Features
from follower_vision.trackers.correlation.filter import (
    BackgroundAwareFilter,
    Peak,
    Response,
    ScaleFilter,
    Spectrum,
    cut,
    find_peak,
    sidelobe_ratio,
    spectrum,
)
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap

_NOISE = 4.0
_LEAST_USUAL = 8.0
_MEMORY = 20
_SIZE_RANGE = 5.0
_HEIGHT_MEMORY = 20
_SCAN_STEP = 2


class Drift:
    """Averages the steps between boxes, in pixels a frame.

    A motion tracker knows no time; where frames drop, the step grows for one frame, and only the
    middle of the search region is a little off.

    Args:
        rate: share of the newest step in the average.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._right = 0.0
        self._down = 0.0

    def stop(self) -> None:
        """Forget the motion."""
        self._right = self._down = 0.0

    def follow(self, before: Box, after: Box) -> None:
        """Take one step into the average."""
        self._right += self._rate * (after.cx - before.cx - self._right)
        self._down += self._rate * (after.cy - before.cy - self._down)

    def moved(self, box: Box, share: float) -> Box:
        """Return the box moved by a share of the mean step."""
        return box.moved_to(box.cx + share * self._right, box.cy + share * self._down)


class PeakRatio:
    """Judges peak to sidelobe ratios by the average of those that were trusted.

    How high the ratio of a well-followed target is depends on the target: 7 for one that changes
    its shape, 17 for a rigid one. A sudden drop means occlusion or loss in both.

    Args:
        doubtful_share: at this share of the usual ratio and below, nothing is to be learnt.
        full_share: at this share and above, everything is.
    """

    def __init__(self, doubtful_share: float, full_share: float) -> None:
        self._doubtful = doubtful_share
        self._full = full_share
        self._usual = _LEAST_USUAL
        self._count = 0

    def trust(self, ratio: float) -> float:
        """Return how much of the present image to learn, 0 to 1."""
        if not self._count:
            return 1.0
        return _ramp(ratio / self._usual, self._doubtful, self._full)

    def confidence(self, ratio: float) -> float:
        """Return 0 where the ratio is that of noise, 1 where it is the usual one or more."""
        return _ramp(ratio, _NOISE, max(self._usual, _LEAST_USUAL))

    def remember(self, ratio: float, trust: float) -> None:
        """Take a ratio into the average; the first ones count as much as all before them."""
        if trust <= 0:
            return
        self._count += 1
        self._usual += trust * (ratio - self._usual) / min(self._count, _MEMORY)


def _ramp(value: float, low: float, high: float) -> float:
    return min(1.0, max(0.0, (value - low) / (high - low)))


@dataclass(frozen=True)
class CorrelationSettings:
    """Settings of the correlation tracker; the defaults serve all kinds of targets.

    Attributes:
        patch_px: side of the square into which the search region is scaled, in pixels.
        cell_px: side of a feature cell in the patch, in pixels.
        search_factor: side of the search region over the target's side (square of equal area).
        gradient_channels: principal components kept of the 31 gradient channels.
        colour_channels: principal components kept of the 12 colour channels.
        label_sigma: width of the wanted response over the target's side.
        learning_rate: share of the newest sample in the model.
        colour_share: greatest share of the colour likelihood in the response.
        colour_learning_rate: share of the newest sample in the colour histograms.
        regularisation: weight of the filter's norm.
        iterations: ADMM iterations per training.
        scale_count: sizes compared per frame, odd.
        scale_step: ratio of neighbouring sizes.
        scale_learning_rate: share of the newest sample in the scale model.
        scale_regularisation: weight of the scale filter's norm.
        minimum_side_px: the box's shorter side does not shrink below this.
        noise_ratio: a peak to sidelobe ratio below this is noise, and the box stays where it was.
        doubtful_share: at this share of the usual ratio and below, nothing is learnt.
        full_share: at this share of the usual ratio and above, learning is at its full rate.
        drift_share: share of the target's mean step by which the search region moves ahead.
        drift_rate: share of the newest step in the mean step.
    """

    patch_px: int = 200
    cell_px: int = 4
    search_factor: float = 5.0
    gradient_channels: int = 12
    colour_channels: int = 4
    label_sigma: float = 1 / 16
    learning_rate: float = 0.02
    colour_share: float = 0.5
    colour_learning_rate: float = 0.02
    regularisation: float = 1e-4
    iterations: int = 2
    scale_count: int = 17
    scale_step: float = 1.035
    scale_learning_rate: float = 0.025
    scale_regularisation: float = 0.01
    minimum_side_px: float = 3.0
    noise_ratio: float = 4.5
    doubtful_share: float = 0.45
    full_share: float = 0.8
    drift_share: float = 0.5
    drift_rate: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """What was seen in a search region."""

    image: Image
    region: Box
    sample: Spectrum
    colours: Colours
    ratio: float
    trust: float


class CorrelationTracker:
    """A motion tracker without weights; implements `MotionTracker`.

    Deterministic: the same images give the same boxes, bit for bit.
    """

    name = "correlation"
    """What tracks say produced them."""

    def __init__(self) -> None:
        self._settings = s = CorrelationSettings()
        self._cells = s.patch_px // s.cell_px
        self._features = Features(s.patch_px, s.cell_px, s.gradient_channels, s.colour_channels)
        self._box: Box | None = None

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`; everything earlier is forgotten."""
        s = self._settings
        self._first = self._box = box
        self._scan: _Scan | None = None
        self._drift = Drift(s.drift_rate)
        self._clarity = PeakRatio(s.doubtful_share, s.full_share)
        self._scale = ScaleFilter(box, s.scale_count, s.scale_step, s.scale_regularisation)
        self._scale.start(image, box)
        self._start_filters(box)
        patch = self._patch(image, box)
        self._features.start(patch)
        self._filter.learn(spectrum(self._features(patch)), 1.0)
        self._colours.learn(self._colours.colours_of(patch), 0.0, 0.0, 1.0)

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR of any size.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        region = _inside(self._drift.moved(self._box, self._settings.drift_share), image)
        scan, blended = self._scanned(image, region)
        peak, trust = find_peak(blended), scan.trust
        box = self._located(self._box, region, peak, scan.ratio, image)
        self._clarity.remember(scan.ratio, trust)
        if trust > 0:
            self._learn(scan.sample, scan.colours, peak, trust)
            factor = self._scale.factor(image, box)
            self._scale.learn(image, box.scaled(factor), trust * self._settings.scale_learning_rate)
            box = self._resized(box, factor)
        self._box = box
        return MotionEstimate(box, self._clarity.confidence(scan.ratio))

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`: all shifts of the search region, at the size found at the best.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        region = _inside(box, image)
        self._scan, blended = self._scanned(image, region)
        peak = find_peak(blended)
        cell = self._settings.search_factor * region.scale / self._cells
        best = region.moved_to(region.cx + peak.across * cell, region.cy + peak.down * cell)
        size = self._resized(best, self._scale.factor(image, best))
        shifts = (np.fft.fftfreq(self._cells) * self._cells * cell)[::_SCAN_STEP]
        across, down = np.meshgrid(region.cx + shifts, region.cy + shifts)
        centres = np.vstack([[best.cx, best.cy], np.stack([across.ravel(), down.ravel()], axis=1)])
        half = np.array([size.width, size.height]) / 2
        scores = np.append(blended.max(), blended[::_SCAN_STEP, ::_SCAN_STEP].ravel()).clip(
            0.0, 1.0
        )
        side = self._settings.search_factor * region.scale
        return ResponseMap(
            np.hstack([centres - half, centres + half]),
            scores,
            np.ones(len(scores)),
            Box(region.cx, region.cy, side, side),
        )

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """See `ResponseTracker`."""
        scan = self._scan
        if scan is None or scan.image is not image or scan.trust <= 0:
            return
        cell = self._settings.search_factor * scan.region.scale / self._cells
        at = Peak((box.cx - scan.region.cx) / cell, (box.cy - scan.region.cy) / cell)
        if max(abs(at.across), abs(at.down)) > self._cells / 4:
            return  # the target's surroundings are not in the searched region
        share = scan.trust * probability
        self._clarity.remember(scan.ratio, share)
        self._learn(scan.sample, scan.colours, at, share)
        self._scale.learn(image, box, share * self._settings.scale_learning_rate)

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

    def _scanned(self, image: Image, region: Box) -> tuple[_Scan, Response]:
        """Return what is in a search region, and how like the target each shift of it is."""
        patch = self._patch(image, region)
        sample = spectrum(self._features(patch))
        response = self._filter.response(sample)
        ratio = sidelobe_ratio(response, self._lobe)
        trust = self._clarity.trust(ratio)
        colours = self._colours.colours_of(patch)
        scan = _Scan(image, region, sample, colours, ratio, trust)
        return scan, self._with_colours(response, colours, trust)

    def _with_colours(self, response: Response, colours: Colours, trust: float) -> Response:
        """The filter's response blended with the colours', the more the clearer it is.

        Colours alone would lead an occluded target's box to similar things nearby: they count
        only where the filter sees the target too, and as far as they separate it from the rest.
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
