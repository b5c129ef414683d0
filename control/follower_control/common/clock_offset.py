"""By how much two clocks differ, found by matching the turns of a camera with those of a gyro."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from follower_vision.geometry.camera_model import Vector

_GRID_S = 0.02
_FINE_S = 0.002
_FINE_REACH_S = 0.12
_HALF_WINDOW_S = 2.0
"""What changes more slowly than this is no turn that could be matched: a flow's bias, a gyro's."""
_LEAST_OVERLAP_S = 4.0
_LEAST_SHARE = 0.5
_LEAST_RATE_RAD_S = math.radians(1.5)
_LEAST_PEAK = 0.5
_LEAST_SCALE = 0.5
_CLEARLY_WORSE = 1.25
"""At any other place so much more has to be left unexplained than at the best one."""
_MOST_UNSURE_S = 0.05


class NoOverlapError(ValueError):
    """The two recordings are too short to be compared."""


@dataclass(frozen=True, slots=True, eq=False)
class AngularRates:
    """Angular velocities of one body, each the mean over an interval; N of them.

    Attributes:
        start_s: (N,) the intervals' beginnings, in order.
        end_s: (N,) and ends.
        rates_rad_s: (N, 3) about the body's axes forward, right and down.
    """

    start_s: Vector
    end_s: Vector
    rates_rad_s: Vector

    @classmethod
    def of_samples(cls, time_s: Vector, rates_rad_s: Vector) -> AngularRates:
        """Make intervals of samples, (N,) and (N, 3): each the mean of two neighbours."""
        mean = (rates_rad_s[1:] + rates_rad_s[:-1]) / 2
        return cls(time_s[:-1], time_s[1:], mean)

    @property
    def middle_s(self) -> Vector:
        """(N,) the intervals' middles."""
        return np.asarray((self.start_s + self.end_s) / 2, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class TimeOffset:
    """Where two recordings fit together, and how well.

    Attributes:
        offset_s: the gyro's time minus the camera's.
        peak: normalised correlation there, at most 1.
        second: the highest correlation at any other place.
        unsure_s: two standard deviations of the offset, at most the range that was tried.
        scale: how much the camera seems to turn for each radian of the gyro; a field of view that
            is set too wide makes it larger than 1.
        rate_rad_s: root mean square of the gyro's quick turns meanwhile.
        lags_s: (L,) offsets that were tried.
        correlation: (L,) the correlation at each, NaN where the recordings overlap too little.
        time_s: (N,) camera's time.
        camera_rad_s: (N, 3) the camera's quick turns.
        gyro_rad_s: (N, 3) the gyro's, moved by the offset.
    """

    offset_s: float
    peak: float
    second: float
    unsure_s: float
    scale: float
    rate_rad_s: float
    lags_s: Vector
    correlation: Vector
    time_s: Vector
    camera_rad_s: Vector
    gyro_rad_s: Vector

    @property
    def problems(self) -> list[str]:
        """Why the offset should not be believed, in words; empty if it may be."""
        if self.rate_rad_s < _LEAST_RATE_RAD_S:
            return [f"the vehicle hardly turns ({math.degrees(self.rate_rad_s):.1f} °/s)"]
        found = []
        if self.peak < _LEAST_PEAK:
            found.append(f"image and gyro hardly agree (correlation {self.peak:.2f} of 1)")
        if not _LEAST_SCALE < self.scale < 1 / _LEAST_SCALE:
            found.append(f"the image turns {self.scale:.2f} times as much as the gyro")
        if 1 - self.second**2 < _CLEARLY_WORSE * (1 - self.peak**2):
            found.append(f"another offset fits nearly as well ({self.second:.2f})")
        if self.unsure_s > _MOST_UNSURE_S:
            found.append(f"the place is vague (± {1e3 * self.unsure_s:.0f} ms)")
        return found


def find_offset(camera: AngularRates, gyro: AngularRates, reach_s: float = math.inf) -> TimeOffset:
    """Find the offset at which the camera's turns fit the gyro's best.

    All three axes count together. The slow part of both is taken out. The whole range in which the
    recordings overlap is tried on a grid by Fourier transform; around the best place the camera's
    intervals are compared with the gyro's mean over just the same intervals.

    Args:
        camera: turns as the images show them, on the camera's clock.
        gyro: turns of the same body, on the gyro's clock.
        reach_s: no offset larger than this, s, is tried; for clocks that are known to be close.

    Raises:
        NoOverlapError: one of them is shorter than 4 s.
    """
    needed_s = _least_overlap_s(camera, gyro)
    lags, correlation = _coarse(camera, gyro, needed_s)
    correlation[np.abs(lags) > reach_s] = np.nan
    if not np.isfinite(correlation).any():
        raise NoOverlapError(_too_short(camera, gyro))
    tried_s = float(np.ptp(lags[np.isfinite(correlation)]))
    top = int(np.nanargmax(correlation))
    match = _Match(camera, gyro)
    offset_s, peak, sharpness = match.refine(float(lags[top]))
    turned = match.gyro_at(offset_s)
    return TimeOffset(
        offset_s=offset_s,
        peak=peak,
        second=_second(correlation, top),
        unsure_s=min(2 * _deviation(match, turned, peak, sharpness), tried_s),
        scale=float(np.sum(match.quick * turned) / max(np.sum(turned**2), 1e-12)),
        rate_rad_s=math.sqrt(float(np.mean(np.sum(turned**2, axis=1)))),
        lags_s=lags,
        correlation=correlation,
        time_s=camera.middle_s,
        camera_rad_s=match.quick,
        gyro_rad_s=turned,
    )


class _Angle:
    """The integral of angular rates, from which means over any interval follow."""

    def __init__(self, rates: AngularRates) -> None:
        self.start_s, self.end_s = float(rates.start_s[0]), float(rates.end_s[-1])
        gaps = np.append(rates.start_s[1:], rates.end_s[-1]) - rates.start_s
        steps = rates.rates_rad_s * gaps[:, None]
        self._times = np.append(rates.start_s, rates.end_s[-1])
        self._angles = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])

    def mean(self, start_s: Vector, end_s: Vector) -> Vector:
        """Return the mean rates over intervals, (N, 3)."""
        width = np.maximum(end_s - start_s, 1e-6)[:, None]
        return (self._at(end_s) - self._at(start_s)) / width

    def _at(self, time_s: Vector) -> Vector:
        columns = [np.interp(time_s, self._times, self._angles[:, axis]) for axis in range(3)]
        return np.column_stack(columns)


class _Match:
    """Compares the camera's quick turns with the gyro's at any offset."""

    def __init__(self, camera: AngularRates, gyro: AngularRates) -> None:
        self._camera, self._gyro = camera, _Angle(gyro)
        own, middle = _Angle(camera), camera.middle_s
        self._slow_start = np.maximum(middle - _HALF_WINDOW_S, own.start_s)
        self._slow_end = np.minimum(middle + _HALF_WINDOW_S, own.end_s)
        self.quick = camera.rates_rad_s - own.mean(self._slow_start, self._slow_end)

    def gyro_at(self, offset_s: float) -> Vector:
        """Return the gyro's quick turns over the camera's intervals, zero where it has none."""
        start, end = self._camera.start_s + offset_s, self._camera.end_s + offset_s
        slow = self._gyro.mean(self._slow_start + offset_s, self._slow_end + offset_s)
        known = (start >= self._gyro.start_s) & (end <= self._gyro.end_s)
        return (self._gyro.mean(start, end) - slow) * known[:, None]

    def correlation(self, offset_s: float) -> float:
        turned = self.gyro_at(offset_s)
        known = turned.any(axis=1)
        energy = np.sum(self.quick[known] ** 2) * np.sum(turned**2)
        return float(np.sum(self.quick * turned) / math.sqrt(max(energy, 1e-24)))

    def refine(self, near_s: float) -> tuple[float, float, float]:
        """Return the best offset near a place, the correlation there, and minus its curvature."""
        lags = near_s + np.arange(-_FINE_REACH_S, _FINE_REACH_S + _FINE_S / 2, _FINE_S)
        values = np.array([self.correlation(float(lag)) for lag in lags])
        best = int(np.argmax(values))
        # A parabola over some hundredths of a second: a single step's bend is lost in rounding.
        part = slice(max(0, best - 10), best + 11)
        bend, slope, _ = np.polyfit(lags[part] - lags[best], values[part], 2)
        moved_s = -slope / (2 * bend) if bend < 0 else 0.0
        offset_s = float(lags[best] + min(max(moved_s, -_FINE_S * 10), _FINE_S * 10))
        return offset_s, self.correlation(offset_s), max(-2 * float(bend), 1e-9)


def _coarse(camera: AngularRates, gyro: AngularRates, needed_s: float) -> tuple[Vector, Vector]:
    """Return the correlation at all offsets, by Fourier transform on a grid."""
    width_s = float(np.median(camera.end_s - camera.start_s))
    (video, covered), (log, logged) = _gridded(camera, width_s), _gridded(gyro, width_s)
    size = len(video) + len(log) - 1

    def crossed(a: Vector, b: Vector) -> Vector:
        product = np.conj(np.fft.rfft(a, size, axis=0)) * np.fft.rfft(b, size, axis=0)
        return np.roll(np.fft.irfft(product, size, axis=0), len(video) - 1, axis=0)

    both = crossed(video, log).sum(axis=1)
    energy = crossed(np.sum(video**2, axis=1), logged) * crossed(covered, np.sum(log**2, axis=1))
    overlap = crossed(covered, logged)
    values = np.full(size, np.nan)
    enough = overlap * _GRID_S >= needed_s
    floor = 1e-12 * max(float(energy.max()), 1e-12)
    values[enough] = both[enough] / np.sqrt(np.maximum(energy[enough], floor))
    first_s = float(gyro.start_s[0] - camera.start_s[0])
    lags = np.arange(size, dtype=np.float64) - (len(video) - 1)
    return np.asarray(first_s + _GRID_S * lags, np.float64), values


def _gridded(rates: AngularRates, width_s: float) -> tuple[Vector, Vector]:
    """Return the quick turns on a regular grid, (M, 3), and ones, (M,)."""
    angle = _Angle(rates)
    time = np.arange(angle.start_s, angle.end_s, _GRID_S)

    def mean(half_s: float) -> Vector:
        start, end = time - half_s, time + half_s
        return angle.mean(np.maximum(start, angle.start_s), np.minimum(end, angle.end_s))

    quick = np.asarray(mean(width_s / 2) - mean(_HALF_WINDOW_S), np.float64)
    return quick, np.ones(len(time))


def _least_overlap_s(camera: AngularRates, gyro: AngularRates) -> float:
    if min(len(camera.start_s), len(gyro.start_s)) < 2:
        raise NoOverlapError("there are fewer than two angular rates to compare")
    lengths = [float(one.end_s[-1] - one.start_s[0]) for one in (camera, gyro)]
    if min(lengths) < _LEAST_OVERLAP_S:
        raise NoOverlapError(_too_short(camera, gyro))
    return max(_LEAST_OVERLAP_S, _LEAST_SHARE * min(lengths))


def _too_short(camera: AngularRates, gyro: AngularRates) -> str:
    video_s, log_s = (one.end_s[-1] - one.start_s[0] for one in (camera, gyro))
    return (
        f"the video turns for {video_s:.1f} s and the log for {log_s:.1f} s: at least "
        f"{_LEAST_OVERLAP_S:.0f} s of both are needed"
    )


def _second(correlation: Vector, top: int) -> float:
    """Return the highest value outside the peak."""
    values = np.nan_to_num(correlation, nan=0.0)
    before, after = values[top::-1], values[top:]
    return float(max(one[_foot(one) :].max(initial=0.0) for one in (before, after)))


def _foot(falling: Vector) -> int:
    """Return where a peak that begins with its top ends: it rises again from below half of it."""
    rises = np.diff(falling, append=np.inf) > 0
    return int(np.argmax(rises & (falling < falling[0] / 2))) or len(falling)


def _deviation(match: _Match, turned: Vector, peak: float, sharpness: float) -> float:
    """Return the offset's standard deviation by the Cramér-Rao bound of a delay.

    That is (1 - r²) / r² over the number of independent samples and the peak's relative curvature;
    neighbouring residuals are alike, which makes fewer samples of them.
    """
    if peak <= 0:
        return math.inf
    scale = np.sum(match.quick * turned) / max(float(np.sum(turned**2)), 1e-12)
    left = match.quick - scale * turned
    alike = float(np.sum(left[1:] * left[:-1]) / max(float(np.sum(left**2)), 1e-12))
    alike = min(max(alike, 0.0), 0.98)
    samples = max(1.0, left.size * (1 - alike) / (1 + alike))
    return math.sqrt((1 - peak**2) / peak**2 / (samples * sharpness / peak))
