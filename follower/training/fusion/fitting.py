"""Fits the model of Fusion's candidates, and the noise of its filter, to what runs wrote down."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from follower.training.fusion.driving import Examples
from follower.training.fusion.settings import FitSettings
from follower_vision.fusion.box_filter import BoxFilter, FilterNoise, axes_of
from follower_vision.fusion.candidates import SOURCES
from follower_vision.fusion.features import FEATURES
from follower_vision.fusion.model import THRESHOLDS, CandidateModel
from follower_vision.geometry.box import Box

Floats = npt.NDArray[np.floating]


def fit_model(
    logs: Sequence[Examples], noise: FilterNoise, settings: FitSettings
) -> CandidateModel:
    """Fit P(overlap > 0.3, 0.5, 0.7); each sequence weighs as the root of its length.

    Args:
        logs: one for each sequence.
        noise: goes into the model.
        settings: see there.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    features = np.concatenate([one.features for one in logs])
    labels = np.concatenate(
        [(one.overlaps[:, None] > np.array(THRESHOLDS)).astype(np.float32) for one in logs]
    )
    weights = np.concatenate(
        [np.full(len(one.overlaps), len(one.overlaps) ** -0.5) for one in logs]
    )
    offset, deviation = features.mean(axis=0), features.std(axis=0)
    # What was the same all the time, as a forecast on video, taught nothing: it gets no say.
    varied = np.ptp(features, axis=0) > 0
    factor = np.where(varied, 1.0 / np.maximum(deviation, 1e-3), 0.0)
    scaled = torch.from_numpy(np.clip((features - offset) * factor, -6.0, 6.0).astype(np.float32))
    targets = torch.from_numpy(labels)
    cumulative = np.cumsum(weights) / weights.sum()
    network = _network(features.shape[1], settings.hidden)
    optimiser = torch.optim.AdamW(
        network.parameters(), settings.rate, weight_decay=settings.weight_decay
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    loss_of = nn.BCEWithLogitsLoss()
    for _ in range(settings.steps):
        drawn = np.searchsorted(cumulative, rng.random(settings.batch))
        rows = torch.from_numpy(np.minimum(drawn, len(weights) - 1))
        optimiser.zero_grad()
        loss = loss_of(network(scaled[rows]), targets[rows])
        loss.backward()
        optimiser.step()
        schedule.step()
    first, last = network[0], network[-1]
    return CandidateModel(offset, factor, _matrix(first), _matrix(last), noise)


def _network(inputs: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, len(THRESHOLDS)))


def _matrix(layer: nn.Module) -> Floats:
    """Weights of a linear layer, its biases last."""
    weight, bias = (one.detach().numpy().astype(float) for one in layer.parameters())
    return np.vstack([weight.T, bias])


def fit_noise(logs: Sequence[Examples], truths: Sequence[Sequence[Box | None]]) -> FilterNoise:
    """Estimate the filter's noise.

    Observations: the robust deviation (1.48 times the median absolute one) of candidates that
    overlap the truth by more than half. Motion: the densities with the largest likelihood of the
    true boxes, in steps of a factor of four.

    Args:
        logs: one for each sequence.
        truths: the true boxes of the same sequences, at 30 a second.
    """
    residuals = np.concatenate([one.residuals for one in logs])
    sources = np.concatenate([one.sources for one in logs])
    place, size = {}, {}
    for number, source in enumerate(SOURCES):
        rows = residuals[(sources == number) & np.isfinite(residuals[:, 0])]
        place[source] = _deviation(rows[:, :2], 0.05)
        size[source] = _deviation(rows[:, 2:], 0.08)
    grid = [4.0**k for k in range(-1, 4)]
    manoeuvre = max(grid, key=lambda m: _likelihood(truths, FilterNoise(m, 0.2, place, size), 0))
    growth = max(
        grid, key=lambda g: _likelihood(truths, FilterNoise(manoeuvre, g / 8, place, size), 2)
    )
    return FilterNoise(manoeuvre, growth / 8, place, size)


def _deviation(rows: Floats, otherwise: float) -> float:
    if len(rows) < 100:
        return otherwise
    return round(1.48 * float(np.median(np.abs(rows))), 4)


def _likelihood(truths: Sequence[Sequence[Box | None]], noise: FilterNoise, axis: int) -> float:
    """Mean log likelihood of true boxes, a frame ahead, of two axes from `axis` on."""
    sums = []
    for truth in truths:
        known = [box for box in truth[:120] if box is not None]
        filter_ = BoxFilter(noise, known[0])
        values = []
        for box in known[1:]:
            filter_.predict(1 / 30)
            error = axes_of(box) - axes_of(filter_.box)
            unit = np.array([box.scale, box.scale, 1.0, 1.0])
            spread = np.array([noise.place["peak"]] * 2 + [noise.size["peak"]] * 2) * unit
            variance = filter_.deviations**2 + spread**2
            logs = -0.5 * (error**2 / variance + np.log(variance))
            values.append(np.maximum(logs, -20)[axis : axis + 2].sum())
            filter_.observe(box, "peak", 1.0)
        sums.append(np.mean(values) if values else 0.0)
    return float(np.mean(sums))


class FirstPeak:
    """Stands for a model before there is one: believes the last motion tracker's best place."""

    noise = FilterNoise(6.0, 0.2, dict.fromkeys(SOURCES, 0.05), dict.fromkeys(SOURCES, 0.08))

    def probabilities(self, features: Floats) -> Floats:
        """See `CandidateModel.probabilities`."""
        followed = features[:, FEATURES.index("is_second")]
        if not followed.any():
            followed = features[:, FEATURES.index("is_first_peak")]
        believed = np.where(followed > 0, 0.9, 0.05)
        return np.repeat(believed[:, None], len(THRESHOLDS), axis=1)
