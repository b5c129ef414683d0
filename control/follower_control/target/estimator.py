"""A constant-velocity Kalman filter on the target's direction and log scale.

It is filterpy's, whose equations are written out here for three numbers that nothing couples:
filterpy multiplies by NumPy's `dot`, which is BLAS (see small_matrix.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
from filterpy.kalman import KalmanFilter

from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame, BearingObservation, GateVerdict
from follower_control.target.settings import EstimatorSettings, TrustSettings
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import wrap_angle


class TargetEstimator:
    """Fuses observations into an estimate of where the target is and how that changes.

    The state is (azimuth, elevation, log scale) and their rates; the process noise is white
    acceleration over the measured interval. A gated observation leaves the filter as it was. The
    filter restarts on an observation when `gated_in_a_row` were gated, when the last one that
    counted is `restart_after_s` old, and when the frame changes (telemetry came or went).
    """

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._direction_noise = math.radians(self._settings.direction_noise_deg)
        self._densities = np.square(
            [
                math.radians(self._settings.azimuth_acceleration_deg_s2),
                math.radians(self._settings.elevation_acceleration_deg_s2),
                self._settings.log_scale_acceleration_s2,
            ]
        ).tolist()
        start_rate = math.radians(self._settings.start_rate_deg_s)
        scale_rate = self._settings.start_log_scale_rate_s
        self._start_variances = np.square([start_rate, start_rate, scale_rate]).tolist()
        self._filter: _WhiteAccelerationFilter | None = None
        self._frame = BearingFrame.WORLD
        self._filter_s = -math.inf
        self._newest_s = -math.inf
        self._gated_in_a_row = 0

    def reset(self) -> None:
        """Forget the target."""
        self._filter = None
        self._filter_s = self._newest_s = -math.inf
        self._gated_in_a_row = 0

    def observe(self, observation: BearingObservation) -> GateVerdict:
        """Fuse one observation; return what became of it."""
        if not observation.is_finite:
            return GateVerdict.NOT_FINITE
        if observation.time_s <= self._newest_s:
            return GateVerdict.OUT_OF_ORDER
        self._newest_s = observation.time_s
        if self._filter is None:
            return self._start(observation, GateVerdict.STARTED)
        gap_s = observation.time_s - self._filter_s
        if observation.frame is not self._frame or gap_s > self._settings.restart_after_s:
            return self._start(observation, GateVerdict.RESTARTED)
        return self._fuse(self._filter, observation, gap_s)

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Predict to `now_s` without altering the filter.

        None before the first observation, more than `restart_after_s` after the last one, and if
        `now_s` is not finite. The filter is never run backwards: before the time of the last
        observation, the estimate is for that time.
        """
        if self._filter is None or not math.isfinite(now_s):
            return None
        ahead_s = max(0.0, now_s - self._filter_s)
        if ahead_s > self._settings.restart_after_s:
            return None
        state, covariance = self._filter.get_prediction(ahead_s)
        azimuth, elevation, log_scale, *rates = state.tolist()
        return TargetEstimate(
            time_s=self._filter_s + ahead_s,
            azimuth_rad=wrap_angle(azimuth),
            elevation_rad=elevation,
            log_scale=log_scale,
            azimuth_rate_rad_s=rates[0],
            elevation_rate_rad_s=rates[1],
            log_scale_rate_s=rates[2],
            covariance=covariance,
            last_seen_s=self._filter_s,
            frame=self._frame,
        )

    def _start(self, observation: BearingObservation, verdict: GateVerdict) -> GateVerdict:
        self._filter = _WhiteAccelerationFilter(self._densities)
        self._filter.x = np.array([*observation.values, 0.0, 0.0, 0.0])
        self._filter.P = np.diag([*self._noise(observation), *self._start_variances])
        self._frame = observation.frame
        self._filter_s = observation.time_s
        self._gated_in_a_row = 0
        return verdict

    def _fuse(
        self, kalman: _WhiteAccelerationFilter, observation: BearingObservation, gap_s: float
    ) -> GateVerdict:
        before = kalman.x, kalman.P
        kalman.predict(gap_s)
        noise = self._noise(observation)
        expected, variances = kalman.x[:3].tolist(), kalman.P.diagonal()[:3].tolist()
        innovation = [seen - x for seen, x in zip(observation.values, expected, strict=True)]
        innovation[0] = wrap_angle(innovation[0])
        # Nothing couples the three, so that what is measured of their covariance is diagonal.
        parts = zip(innovation, variances, noise, strict=True)
        if sum(off * off / (variance + r) for off, variance, r in parts) > self._settings.gate:
            kalman.x, kalman.P = before
            return self._gate_out(observation)
        kalman.update(innovation, noise)
        self._filter_s = observation.time_s
        self._gated_in_a_row = 0
        return GateVerdict.FUSED

    def _gate_out(self, observation: BearingObservation) -> GateVerdict:
        self._gated_in_a_row += 1
        if self._gated_in_a_row >= self._settings.gated_in_a_row:
            return self._start(observation, GateVerdict.RESTARTED)
        return GateVerdict.GATED

    def _noise(self, observation: BearingObservation) -> tuple[float, float, float]:
        """Variances of an observation; near the zenith and nadir the azimuth says little."""
        share = self._settings.direction_noise_share * math.exp(min(observation.log_scale, 2.0))
        direction = math.hypot(self._direction_noise, share)
        level = max(math.cos(observation.line_of_sight.elevation_rad), 0.01)
        factor = self._settings.cut_noise_factor if observation.is_cut else 1.0
        across, worse = direction / level, factor**2
        scale = self._settings.log_scale_noise
        return across * across * worse, direction * direction * worse, scale * scale * worse


class _WhiteAccelerationFilter(KalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter for three numbers and their rates, its products written out.

    F adds to each number its rate times the interval, Q is continuous white acceleration integrated
    over it (Bar-Shalom, ch. 6.2), H takes the three numbers, R is diagonal: so x and P are those of
    three filters of two states, which is how they are computed.

    Args:
        densities: of the three accelerations' spectra.
    """

    def __init__(self, densities: Sequence[float]) -> None:
        super().__init__(dim_x=6, dim_z=3)
        self._densities = tuple(densities)

    def get_prediction(self, interval_s: float) -> tuple[Vector, Vector]:
        """Return the state, (6,), and its covariance, 6x6, an interval later."""
        t = interval_s
        numbers, rates = self.x[:3].tolist(), self.x[3:].tolist()
        ahead = [number + t * rate for number, rate in zip(numbers, rates, strict=True)]
        blocks = [
            (
                (p + t * c) + (c + t * r) * t + density * t**3 / 3,
                c + t * r + density * t**2 / 2,
                r + density * t,
            )
            for (p, c, r), density in zip(_blocks(self.P), self._densities, strict=True)
        ]
        return np.array([*ahead, *rates]), _covariance(blocks)

    def predict(self, interval_s: float) -> None:
        """Go on by an interval: x = F x, P = F P F' + Q."""
        self.x, self.P = self.get_prediction(interval_s)

    def update(self, innovation: Sequence[float], variances: Sequence[float]) -> None:
        """Take in what was measured: x = x + K y, P = (I - K H) P (I - K H)' + K R K'.

        Args:
            innovation: y, the measured numbers minus the predicted ones.
            variances: R's diagonal.
        """
        numbers, rates, blocks = self.x[:3].tolist(), self.x[3:].tolist(), []
        for i, (p, c, r) in enumerate(_blocks(self.P)):
            gain, rate_gain = p / (p + variances[i]), c / (p + variances[i])
            numbers[i] += gain * innovation[i]
            rates[i] += rate_gain * innovation[i]
            left = 1.0 - gain
            blocks.append(
                (
                    left * p * left + gain * variances[i] * gain,
                    (c - rate_gain * p) * left + rate_gain * variances[i] * gain,
                    r
                    - rate_gain * c
                    - (c - rate_gain * p) * rate_gain
                    + rate_gain * variances[i] * rate_gain,
                )
            )
        self.x, self.P = np.array([*numbers, *rates]), _covariance(blocks)


_Block: TypeAlias = tuple[float, float, float]
"""Variance of a number, covariance with its rate, variance of the rate."""


def _blocks(covariance: Vector) -> Iterable[_Block]:
    variances = covariance.diagonal().tolist()
    return zip(variances[:3], covariance.diagonal(3).tolist(), variances[3:], strict=True)


def _covariance(blocks: Sequence[_Block]) -> Vector:
    flat = np.zeros(36)
    p, c, r = zip(*blocks, strict=True)
    flat[::7] = p + r
    flat[3:18:7] = flat[18:33:7] = c
    return flat.reshape(6, 6)


def trust_in(estimate: TargetEstimate, settings: TrustSettings) -> float:
    """Return what share of the largest speed may be flown on an estimate, 0 to 1."""
    variance = max(float(estimate.covariance[0, 0]), float(estimate.covariance[1, 1]))
    doubt_deg = math.degrees(math.sqrt(max(variance, 0.0))) if math.isfinite(variance) else math.inf
    by_direction = _falling(doubt_deg, settings.sure_deg, settings.unsure_deg)
    return min(by_direction, _falling(estimate.age_s, settings.fresh_s, settings.old_s))


def _falling(value: float, full: float, none: float) -> float:
    return min(max((none - value) / (none - full), 0.0), 1.0)
