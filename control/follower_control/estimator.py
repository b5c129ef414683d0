"""A constant-velocity Kalman filter on the target's direction and log scale."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar

import numpy as np
from filterpy.kalman import KalmanFilter

from follower_control.estimate import TargetEstimate
from follower_control.sighting import SightFrame, Sighting
from follower_vision.camera import Vector
from follower_vision.lineofsight import wrap_angle

_IDENTITY = np.eye(6)


class Verdict(StrEnum):
    """What became of a sighting."""

    STARTED = "started the filter"
    FUSED = "fused"
    GATED = "too far from the prediction"
    RESTARTED = "restarted the filter"
    OUT_OF_ORDER = "not newer than the last sighting"
    NOT_FINITE = "not finite"


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """How much to trust the sightings, and how much the target is expected to manoeuvre.

    Attributes:
        direction_noise_deg: standard deviation of the direction of a tiny target.
        direction_noise_share: what is added to it, as a share of the target's angular size.
        log_scale_noise: standard deviation of the log scale (0.05 is 5 % in size).
        cut_noise_factor: how much worse all three are when the image's border cuts the box.
        azimuth_acceleration_deg_s2: spectral density of the acceleration, its root per sqrt(Hz).
        elevation_acceleration_deg_s2: the same for elevation.
        log_scale_acceleration_s2: the same for log scale.
        start_rate_deg_s: standard deviation of the unknown angular rates at the start.
        start_log_scale_rate_s: the same for log scale.
        gate: largest accepted squared Mahalanobis distance; 16.27 passes 99.9 % of good sightings
            (chi-squared with 3 degrees of freedom).
        gated_in_a_row: so many gated sightings in a row restart the filter on the last of them.
        restart_after_s: after so long without a sighting there is no estimate, and the next
            sighting restarts the filter.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    direction_noise_deg: float = 0.1
    direction_noise_share: float = 0.03
    log_scale_noise: float = 0.03
    cut_noise_factor: float = 5.0
    azimuth_acceleration_deg_s2: float = 20.0
    elevation_acceleration_deg_s2: float = 15.0
    log_scale_acceleration_s2: float = 0.15
    start_rate_deg_s: float = 30.0
    start_log_scale_rate_s: float = 0.5
    gate: float = 16.27
    gated_in_a_row: int = 5
    restart_after_s: float = 2.0

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0 < getattr(self, field.name) < math.inf:
                raise ValueError(f"{field.name} is finite and positive, not {self}")


class TargetEstimator:
    """Folds sightings into an estimate of where the target is and how that changes.

    The state is (azimuth, elevation, log scale) and their rates; the process noise is white
    acceleration over the measured interval. A sighting that is gated leaves the filter as it was.
    The filter restarts on a sighting when `gated_in_a_row` were gated, when the last one that
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
        self._filter: KalmanFilter | None = None
        self._frame = SightFrame.WORLD
        self._filter_s = -math.inf
        self._newest_s = -math.inf
        self._gated_in_a_row = 0
        self._gated = 0

    @property
    def gated(self) -> int:
        """How many sightings were gated since the last reset."""
        return self._gated

    def reset(self) -> None:
        """Forget the target."""
        self._filter = None
        self._filter_s = self._newest_s = -math.inf
        self._gated_in_a_row = self._gated = 0

    def observe(self, sighting: Sighting) -> Verdict:
        """Fold in one sighting, and say what became of it."""
        if not sighting.is_finite:
            return Verdict.NOT_FINITE
        if sighting.time_s <= self._newest_s:
            return Verdict.OUT_OF_ORDER
        self._newest_s = sighting.time_s
        if self._filter is None:
            return self._start(sighting, Verdict.STARTED)
        gap_s = sighting.time_s - self._filter_s
        if sighting.frame is not self._frame or gap_s > self._settings.restart_after_s:
            return self._start(sighting, Verdict.RESTARTED)
        return self._fuse(self._filter, sighting, gap_s)

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Predict to `now_s` without altering the filter.

        None before the first sighting, more than `restart_after_s` after the last one, and if
        `now_s` is not finite. The filter is never run backwards: before the last sighting's time,
        the estimate is for that time.
        """
        if self._filter is None or not math.isfinite(now_s):
            return None
        ahead_s = max(0.0, now_s - self._filter_s)
        if ahead_s > self._settings.restart_after_s:
            return None
        state, covariance = self._predicted(self._filter, ahead_s)
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

    def _start(self, sighting: Sighting, verdict: Verdict) -> Verdict:
        self._filter = KalmanFilter(dim_x=6, dim_z=3)
        self._filter.H = np.eye(3, 6)
        self._filter.inv = _inverse_of_diagonal
        self._filter.x = np.array([*sighting.values, 0.0, 0.0, 0.0])
        self._filter.P = np.diag([*self._noise(sighting), *self._start_variances])
        self._frame = sighting.frame
        self._filter_s = sighting.time_s
        self._gated_in_a_row = 0
        return verdict

    def _fuse(self, kalman: KalmanFilter, sighting: Sighting, gap_s: float) -> Verdict:
        before = kalman.x, kalman.P
        kalman.predict(F=_transition(gap_s), Q=self._process_noise(gap_s))
        noise = self._noise(sighting)
        expected, variances = kalman.x[:3].tolist(), kalman.P.diagonal()[:3].tolist()
        innovation = [seen - x for seen, x in zip(sighting.values, expected, strict=True)]
        innovation[0] = wrap_angle(innovation[0])
        # Nothing couples the three, so that what is measured of their covariance is diagonal.
        parts = zip(innovation, variances, noise, strict=True)
        if sum(off * off / (variance + r) for off, variance, r in parts) > self._settings.gate:
            kalman.x, kalman.P = before
            return self._gate_out(sighting)
        kalman.update(kalman.x[:3] + innovation, R=np.diag(noise))
        self._filter_s = sighting.time_s
        self._gated_in_a_row = 0
        return Verdict.FUSED

    def _gate_out(self, sighting: Sighting) -> Verdict:
        self._gated += 1
        self._gated_in_a_row += 1
        if self._gated_in_a_row >= self._settings.gated_in_a_row:
            return self._start(sighting, Verdict.RESTARTED)
        return Verdict.GATED

    def _predicted(self, kalman: KalmanFilter, interval_s: float) -> tuple[Vector, Vector]:
        transition = _transition(interval_s)
        covariance = transition @ kalman.P @ transition.T + self._process_noise(interval_s)
        return transition @ kalman.x, covariance

    def _process_noise(self, interval_s: float) -> Vector:
        """Continuous white acceleration, integrated over the interval (Bar-Shalom, ch. 6.2)."""
        noise = np.zeros((6, 6))
        for i, density in enumerate(self._densities):
            noise[i, i] = density * interval_s**3 / 3
            noise[i, i + 3] = noise[i + 3, i] = density * interval_s**2 / 2
            noise[i + 3, i + 3] = density * interval_s
        return noise

    def _noise(self, sighting: Sighting) -> tuple[float, float, float]:
        """Variances of a sighting; near the zenith and nadir the azimuth says little."""
        share = self._settings.direction_noise_share * math.exp(min(sighting.log_scale, 2.0))
        direction = math.hypot(self._direction_noise, share)
        level = max(math.cos(sighting.line_of_sight.elevation_rad), 0.01)
        factor = self._settings.cut_noise_factor if sighting.is_cut else 1.0
        across, worse = direction / level, factor**2
        scale = self._settings.log_scale_noise
        return across * across * worse, direction * direction * worse, scale * scale * worse


def _transition(interval_s: float) -> Vector:
    matrix = _IDENTITY.copy()
    matrix[0, 3] = matrix[1, 4] = matrix[2, 5] = interval_s
    return matrix


def _inverse_of_diagonal(matrix: Vector) -> Vector:
    return np.diag(1.0 / matrix.diagonal())
