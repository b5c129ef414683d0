"""Finds the response model that explains recordings best, and says how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from follower_control.tuning.rational import Array
from follower_control.tuning.response_model import ResponseData, ResponseModel, TooLittleError

FIT_SHARE = 0.6
"""The part of the excitation, from the beginning, that the fit sees; it is judged by the rest."""
_LEAST_S = 3.0
_LEAST_SAMPLES = 60
_REST_S = 1.5
_BETTER = 0.93
"""A more complicated model has to bring the held-out error down to this share to be taken."""
_MEMORY_S = 1.0
_NOISE_S, _ALIKE = 0.1, 0.15
_SLOPE_S = 0.3
_NORMAL_95 = 1.96
_STARTS_S = ((0.05, 0.15), (0.15, 0.4), (0.1, 1.0))
"""Dead times and time constants to begin with."""
_BOUNDS = {
    "gain": (0.05, 20.0),
    "dead_time_s": (1e-4, 1.5),
    "time_constant_s": (0.005, 10.0),
    "damping": (0.15, 2.5),
    "lead_s": (1e-3, 20.0),
    "rate_limit": (0.02, 100.0),
}

_FAMILIES: tuple[tuple[str, ...], ...] = (
    ("gain", "dead_time_s", "time_constant_s"),
    ("gain", "dead_time_s", "time_constant_s", "damping"),
    ("gain", "dead_time_s", "time_constant_s", "damping", "lead_s"),
)
_LEAST_OBSERVATIONS = 12
_SPREAD = 1.3
"""The largest distance over the smallest from which on a slope can be fitted."""
_CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Interval:
    """A number between two others, with 95 % confidence."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ResponseFit:
    """A model, how sure its numbers are and how well it predicts what it was not fitted to.

    Attributes:
        model: the best one, fitted to everything.
        judged: the same kind of model, fitted to the first part of each recording alone.
        intervals: of each fitted number, by its name in the model.
        fit: of `judged`: 1 - |residual| / |signal about its mean|, over the part that it was fitted
            to: 1 is perfect, 0 is as good as a constant.
        held_out_fit: the same over the rest, which `judged` never saw.
        residual_rms: of `judged` over the rest, in the signal's unit.
        samples: how many were fitted.
        offsets: what each recording's signal stands off `judged` by, in the signal's unit.
        splits_s: the time at which each recording's rest begins.
    """

    model: ResponseModel
    judged: ResponseModel
    intervals: dict[str, Interval]
    fit: float
    held_out_fit: float
    residual_rms: float
    samples: int
    offsets: tuple[float, ...]
    splits_s: tuple[float, ...]


def fit_response(records: Sequence[ResponseData], least_excitation: float = 0.0) -> ResponseFit:
    """Fit models of order one and two, with and without a rate limit, and return the best one.

    Output-error fit: free-running prediction against the measurement, by least squares over the
    logarithms of the parameters, a constant offset for each recording. Which model is best the
    held-out part decides; a more complicated one has to earn it. The intervals are those of the
    sandwich estimator with the residuals' own correlation over a second (Newey and West, 1987), so
    that slow misfit counts for what it is.

    Args:
        records: stretches of the same vehicle's same axis.
        least_excitation: how much the input has to vary about its mean, RMS, in its own unit.

    Raises:
        TooLittleError: the recordings are too short, nothing was excited in them, or nothing
            answered.
    """
    _check(records, least_excitation)
    splits = tuple(_split_s(record) for record in records)
    problem = _Problem(records, splits)
    best: _Solution | None = None
    for names in _FAMILIES:
        found = problem.solve(names, best)
        if best is None or found.held_out_rms < _BETTER * best.held_out_rms:
            best = found
        if problem.is_explained(best):
            break
    if best is None:
        raise TooLittleError("no model fits at all")
    if not problem.is_explained(best):
        limited = problem.limited(best)
        best = limited if limited.held_out_rms < _BETTER * best.held_out_rms else best
    fit = problem.result(best, _Problem(records, tuple(math.inf for _ in records)))
    gain, (low, high) = fit.intervals["gain"], _BOUNDS["gain"]
    if gain.low < low or gain.high > high:
        raise TooLittleError(
            "no answer: what was measured fits to any gain, so it does not follow what was asked "
            "for; see that the vehicle flew by the setpoints, then fly `follower excite`"
        )
    return fit


def _check(records: Sequence[ResponseData], least: float) -> None:
    samples = sum(len(record.outputs) for record in records)
    length_s = sum(record.length_s for record in records)
    if samples < _LEAST_SAMPLES or length_s < _LEAST_S:
        raise TooLittleError(
            f"too short: {length_s:.1f} s with {samples} samples; at least {_LEAST_S:g} s and "
            f"{_LEAST_SAMPLES} samples are needed (`follower excite` flies 70 s)"
        )
    varied = math.sqrt(sum(_moved(record) for record in records) / max(length_s, 1e-9))
    if varied <= max(least, 1e-9):
        raise TooLittleError(
            f"no excitation: what was asked for varied by {varied:.3g} RMS, at least "
            f"{least:.3g} is needed; fly `follower excite`"
        )


def _moved(record: ResponseData) -> float:
    """Return the squared deviation of the input from its mean, times time."""
    times = np.append(record.input_s, record.output_s[-1] if len(record.output_s) else 0.0)
    spans = np.clip(np.diff(times), 0.0, None)
    total = float(spans.sum())
    mean = float(np.sum(spans * record.inputs)) / max(total, 1e-9)
    return float(np.sum(spans * (record.inputs - mean) ** 2))


def _split_s(record: ResponseData) -> float:
    """Return when the fitted share of the input's changes is over.

    A single change leaves nothing to hold out: then it is the time that is shared.
    """
    changes = np.abs(np.diff(record.inputs))
    total = float(changes.sum())
    start, end = float(record.output_s[0]), float(record.output_s[-1])
    middle = start + FIT_SHARE * (end - start)
    if total <= 0:
        return middle
    passed = np.cumsum(changes) / total
    at = float(record.input_s[1:][int(np.argmax(passed >= FIT_SHARE))])
    early = float(record.input_s[1:][int(np.argmax(changes > 0))])
    return at if early < at < end - min(_REST_S, 0.1 * (end - start)) else middle


@dataclass(frozen=True, slots=True)
class _Solution:
    names: tuple[str, ...]
    logs: Array
    held_out_rms: float

    @property
    def model(self) -> ResponseModel:
        return _model(self.names, self.logs)


def _model(names: tuple[str, ...], logs: Array) -> ResponseModel:
    return ResponseModel(**dict(zip(names, np.exp(logs).tolist(), strict=True)))


class _Problem:
    """The recordings, each parted into what is fitted and what is held out."""

    def __init__(self, records: Sequence[ResponseData], splits: tuple[float, ...]) -> None:
        self._records = records
        self._splits = splits
        self._fitted = [r.output_s < at for r, at in zip(records, splits, strict=True)]
        whole = [mask.all() for mask, at in zip(self._fitted, splits, strict=True) if at < math.inf]
        if any(whole) or not all(mask.any() for mask in self._fitted):
            raise TooLittleError("too short: nothing is left to hold out")

    def solve(self, names: tuple[str, ...], simpler: _Solution | None = None) -> _Solution:
        """Return the best fit of one family, begun from a simpler one's or from several places."""
        starts = [_start(names, *one) for one in _STARTS_S]
        if simpler is not None:
            starts = [_grown(names, simpler, factor) for factor in (1.0, 0.4)]
        return self._best(names, starts)

    def _best(self, names: tuple[str, ...], starts: Sequence[Array]) -> _Solution:
        low, high = (np.log([_BOUNDS[name][i] for name in names]) for i in (0, 1))
        runs = [
            least_squares(
                lambda logs: self._residuals(_model(names, logs), fitted=True),
                np.clip(first, low + 1e-6, high - 1e-6),
                bounds=(low, high),
                diff_step=1e-4,
                max_nfev=40,
            )
            for first in starts
        ]
        logs = min(runs, key=lambda run: float(run.cost)).x
        held = self._residuals(_model(names, logs), fitted=False)
        rms = float(np.sqrt(np.mean(held**2))) if len(held) else 0.0
        return _Solution(names, np.asarray(logs, np.float64), rms)

    def limited(self, free: _Solution) -> _Solution:
        """Return the best fit with a rate limit, of the simplest family and of the given one."""
        limit = math.log(max(self._steepest(), 0.03))
        found = []
        for names in dict.fromkeys((_FAMILIES[0], free.names)):
            shared = free if names == free.names else self._best(names, [_start(names, 0.15, 0.4)])
            is_time = np.isin(names, ("time_constant_s", "lead_s"))
            starts = [np.append(shared.logs + is_time * by, limit) for by in (-0.4, -1.6)]
            found.append(self._best((*names, "rate_limit"), starts))
        return min(found, key=lambda one: one.held_out_rms)

    def _steepest(self) -> float:
        """Return how fast the outputs changed when they changed fast."""
        slopes = []
        for record in self._records:
            lag = max(1, round(_lag(record) * _SLOPE_S / _MEMORY_S))
            if len(record.outputs) > lag:
                rise = record.outputs[lag:] - record.outputs[:-lag]
                slopes.append(np.abs(rise) / (record.output_s[lag:] - record.output_s[:-lag]))
        return float(np.percentile(np.concatenate(slopes), 97)) if slopes else 0.0

    def is_explained(self, solution: _Solution) -> bool:
        """Whether what is left over is noise: a tenth of a second later it is another."""
        left = self._each(solution.model, fitted=True)
        lags = [max(1, round(_lag(record) * _NOISE_S / _MEMORY_S)) for record in self._records]
        pairs = [(r[:-lag], r[lag:]) for r, lag in zip(left, lags, strict=True)]
        alike = sum(float(np.dot(a, b)) for a, b in pairs)
        return alike < _ALIKE * sum(float(np.dot(a, a)) for a, _ in pairs)

    def result(self, solution: _Solution, whole: _Problem) -> ResponseFit:
        """Fit the same kind of model to everything and put all together."""
        judged = solution.model
        final = whole._best(solution.names, [solution.logs])
        return ResponseFit(
            final.model,
            judged,
            whole._intervals(final),
            self._quality(judged, fitted=True),
            self._quality(judged, fitted=False),
            solution.held_out_rms,
            sum(len(record.outputs) for record in self._records),
            tuple(self._offsets(judged)),
            self._splits,
        )

    def _offsets(self, model: ResponseModel) -> list[float]:
        pairs = zip(self._records, self._fitted, strict=True)
        return [float(np.mean((r.outputs - r.predicted(model))[mask])) for r, mask in pairs]

    def _each(self, model: ResponseModel, fitted: bool) -> list[Array]:
        """Return each recording's residuals, its offset taken out."""
        parts = []
        for record, mask in zip(self._records, self._fitted, strict=True):
            difference = record.outputs - record.predicted(model)
            difference = difference - difference[mask].mean()
            parts.append(difference[mask if fitted else ~mask])
        return parts

    def _residuals(self, model: ResponseModel, fitted: bool) -> Array:
        return np.concatenate(self._each(model, fitted))

    def _quality(self, model: ResponseModel, fitted: bool) -> float:
        masks = self._fitted if fitted else [~mask for mask in self._fitted]
        signals = [r.outputs[m] for r, m in zip(self._records, masks, strict=True)]
        spread = np.concatenate([signal - signal.mean() for signal in signals])
        size = float(np.linalg.norm(spread))
        return 1.0 - float(np.linalg.norm(self._residuals(model, fitted))) / max(size, 1e-12)

    def _intervals(self, solution: _Solution) -> dict[str, Interval]:
        slopes = self._slopes(solution)
        stacked = np.concatenate(slopes)
        bread = np.linalg.pinv(stacked.T @ stacked)
        residuals = self._each(solution.model, fitted=True)
        meat = sum(
            _correlated(slope * residual[:, None], _lag(record))
            for slope, residual, record in zip(slopes, residuals, self._records, strict=True)
        )
        samples, count = stacked.shape
        free = max(samples - count - len(self._records), 1)
        robust = np.diag(bread @ meat @ bread) * samples / free
        # Short recordings hide how long the residuals last: no narrower than for white noise.
        white = np.diag(bread) * sum(float(np.dot(r, r)) for r in residuals) / free
        spread = _NORMAL_95 * np.sqrt(np.clip(np.maximum(robust, white), 0.0, None))
        return {
            name: Interval(math.exp(log), math.exp(log - width), math.exp(min(log + width, 700.0)))
            for name, log, width in zip(
                solution.names, solution.logs.tolist(), spread.tolist(), strict=True
            )
        }

    def _slopes(self, solution: _Solution) -> list[Array]:
        """Return each recording's derivative of the residuals by the parameters' logarithms."""
        step, columns = 1e-4, []
        for i in range(len(solution.names)):
            moved = np.zeros(len(solution.names))
            moved[i] = step
            up = self._each(_model(solution.names, solution.logs + moved), fitted=True)
            down = self._each(_model(solution.names, solution.logs - moved), fitted=True)
            columns.append([(a - b) / (2 * step) for a, b in zip(up, down, strict=True)])
        return [np.stack(parts, axis=1) for parts in zip(*columns, strict=True)]


def _start(names: tuple[str, ...], dead_s: float, constant_s: float) -> Array:
    values = {
        "gain": 1.0,
        "dead_time_s": dead_s,
        "time_constant_s": constant_s,
        "damping": 1.0,
        "lead_s": 0.5 * constant_s,
    }
    return np.log([values[name] for name in names])


def _grown(names: tuple[str, ...], simpler: _Solution, factor: float) -> Array:
    """Return where to begin with more parameters: near what fewer said."""
    known = dict(zip(simpler.names, simpler.logs.tolist(), strict=True))
    constant = known["time_constant_s"] + math.log(factor)
    known.update(time_constant_s=constant)
    known.setdefault("damping", 0.0)
    known.setdefault("lead_s", constant + math.log(0.5))
    return np.array([known[name] for name in names])


def _lag(record: ResponseData) -> int:
    interval_s = record.length_s / max(len(record.output_s) - 1, 1)
    return max(1, round(_MEMORY_S / max(interval_s, 1e-6)))


def _correlated(scores: Array, lag: int) -> Array:
    """Return the sum of the scores' products with those up to `lag` samples away, Bartlett."""
    total = scores.T @ scores
    for k in range(1, min(lag, len(scores) - 1) + 1):
        both = scores[k:].T @ scores[:-k]
        total = total + (1 - k / (lag + 1)) * (both + both.T)
    return np.asarray(total, np.float64)


@dataclass(frozen=True, slots=True)
class SizeFit:
    """What the target measures.

    Attributes:
        size_m: the root of its width times its height, as seen, with slope 1.
        slope: how the angle falls with the distance; None where the distance hardly varied. Far
            from 1, the box does not keep to the target, or the distance is wrong.
        spread: of single observations about the relation, as a share; in the held-out last third.
        samples: how many observations were fitted.
    """

    size_m: Interval
    slope: Interval | None
    spread: float
    samples: int


def fit_size(angles_rad: Sequence[float], ranges_m: Sequence[float]) -> SizeFit:
    """Fit the relation to observations in the order of time.

    Observations far enough from each other are wanted: what neighbours share counts as news here.

    Raises:
        TooLittleError: there are too few, or some are not finite and above 0.
    """
    angles = np.asarray(angles_rad, np.float64)
    ranges = np.asarray(ranges_m, np.float64)
    if len(angles) < _LEAST_OBSERVATIONS:
        raise TooLittleError(
            f"only {len(angles)} observations of a target on the ground, "
            f"{_LEAST_OBSERVATIONS} are needed"
        )
    if not (np.all(np.isfinite(angles * ranges)) and min(angles.min(), ranges.min()) > 0):
        raise TooLittleError("sizes and distances are finite and above 0")
    logs = np.asarray(np.log(angles * ranges), np.float64)
    first = 2 * len(logs) // 3
    held_out = logs[first:] - logs[:first].mean()
    return SizeFit(
        _mean(logs),
        _slope(np.log(angles), np.log(ranges)),
        float(np.sqrt(np.mean(held_out**2))),
        len(logs),
    )


def _mean(logs: Array) -> Interval:
    width = float(stats.t.ppf(0.5 + _CONFIDENCE / 2, len(logs) - 1) * stats.sem(logs))
    middle = float(logs.mean())
    return Interval(math.exp(middle), math.exp(middle - width), math.exp(middle + width))


def _slope(angles: Array, ranges: Array) -> Interval | None:
    if float(np.ptp(ranges)) < math.log(_SPREAD):
        return None
    line = stats.linregress(ranges, angles)
    width = float(stats.t.ppf(0.5 + _CONFIDENCE / 2, len(ranges) - 2) * line.stderr)
    slope = -float(line.slope)
    return Interval(slope, slope - width, slope + width)
