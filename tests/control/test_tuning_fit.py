"""Identification recovers what made the data, says how sure it is, refuses what tells nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest

from follower_control.tuning.fit import fit_response
from follower_control.tuning.response_model import ResponseData, ResponseModel, TooLittleError

CHANGES_S = np.array([0.0, 2.0, 6.0, 10.0, 14.0, 18.0, 22.0])
LEVELS = np.array([0.0, 1.0, -1.0, 0.0, 2.0, -2.0, 0.0])
SAMPLES_S = np.arange(0.0, 26.0, 0.02)


def flown(model: ResponseModel, noise: float = 0.0, seed: int = 0, offset: float = 0.0):
    empty = ResponseData("flown", CHANGES_S, LEVELS, SAMPLES_S, np.zeros(len(SAMPLES_S)))
    shaken = np.random.default_rng(seed).normal(0.0, 1.0, len(SAMPLES_S)) * noise
    outputs = empty.predicted(model) + offset + shaken
    return ResponseData("flown", CHANGES_S, LEVELS, SAMPLES_S, outputs)


def test_the_prediction_of_a_first_order_step_is_the_closed_form() -> None:
    model = ResponseModel(0.9, 0.13, 0.4)
    data = flown(model)
    inside = (SAMPLES_S > 2.2) & (SAMPLES_S < 6.0)
    expected = 0.9 * (1 - np.exp(-(SAMPLES_S[inside] - 2.13) / 0.4))
    assert data.outputs[inside] == pytest.approx(expected, abs=2e-3)
    assert data.outputs[SAMPLES_S < 2.12] == pytest.approx(0.0, abs=1e-12)


def test_the_prediction_of_an_underdamped_step_overshoots_as_it_must() -> None:
    damping = 0.4
    data = flown(ResponseModel(1.0, 0.1, 0.25, damping))
    peak = data.outputs[(SAMPLES_S > 2.0) & (SAMPLES_S < 6.0)].max()
    overshoot = math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
    assert peak == pytest.approx(1 + overshoot, abs=5e-3)


def test_a_rate_limit_bounds_every_slope() -> None:
    data = flown(ResponseModel(1.0, 0.1, 0.2, 0.8, rate_limit=0.7))
    slopes = np.diff(data.outputs) / np.diff(SAMPLES_S)
    assert np.abs(slopes).max() == pytest.approx(0.7, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        ResponseModel(0.95, 0.12, 0.35),
        ResponseModel(1.05, 0.20, 0.30, 0.6),
        ResponseModel(1.0, 0.15, 0.8, 1.6, lead_s=1.1),
        ResponseModel(1.0, 0.1, 0.15, rate_limit=1.2),
    ],
)
def test_without_noise_the_parameters_come_back(truth: ResponseModel) -> None:
    found = fit_response([flown(truth, offset=0.3)])
    assert found.held_out_fit > 0.98
    assert found.offsets[0] == pytest.approx(0.3, abs=0.02)
    assert found.model.gain == pytest.approx(truth.gain, rel=0.03)
    assert found.model.order == truth.order
    assert found.model.dead_time_s == pytest.approx(truth.dead_time_s, abs=0.03)
    if truth.lead_s == 0:
        assert found.model.time_constant_s == pytest.approx(truth.time_constant_s, rel=0.12)
    if truth.rate_limit is not None:
        assert found.model.rate_limit == pytest.approx(truth.rate_limit, rel=0.05)


@pytest.mark.slow
def test_the_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    truth = ResponseModel(0.95, 0.12, 0.35)
    inside = []
    for seed in range(25):
        found = fit_response([flown(truth, 0.1, seed)])
        for name in ("gain", "dead_time_s", "time_constant_s"):
            known = found.intervals[name]
            inside.append(known.low <= getattr(truth, name) <= known.high)
    # 75 intervals of 95 %: fewer than 64 inside are 85 %, three standard deviations below.
    assert np.mean(inside) >= 0.85


def test_the_intervals_narrow_with_the_noise() -> None:
    truth = ResponseModel(0.95, 0.12, 0.35)
    widths = []
    for noise in (0.02, 0.2):
        known = fit_response([flown(truth, noise)]).intervals["gain"]
        widths.append(known.high - known.low)
    assert 5 < widths[1] / widths[0] < 20


def test_a_model_is_judged_by_what_it_never_saw() -> None:
    truth = ResponseModel(1.0, 0.1, 0.3)
    data = flown(truth, 0.02)
    spoilt = data.outputs.copy()
    spoilt[SAMPLES_S > 19.0] = 0.0  # what comes after the split does something else
    found = fit_response([ResponseData("spoilt", data.input_s, data.inputs, data.output_s, spoilt)])
    assert found.fit > 0.9
    assert found.held_out_fit < 0.6


def test_the_noisier_the_worse_the_fit_but_not_the_model() -> None:
    quiet, loud = (fit_response([flown(ResponseModel(1.0, 0.1, 0.3), n)]) for n in (0.02, 0.4))
    assert quiet.held_out_fit > loud.held_out_fit
    assert loud.model.gain == pytest.approx(1.0, abs=0.1)


def test_what_tells_nothing_is_refused_in_plain_words() -> None:
    still = np.zeros(len(SAMPLES_S))
    with pytest.raises(TooLittleError, match="no excitation"):
        fit_response([ResponseData("still", CHANGES_S, 0 * LEVELS, SAMPLES_S, still)], 0.1)
    long = flown(ResponseModel(1.0, 0.1, 0.3))
    first = long.output_s < 1.0
    short = replace(long, output_s=long.output_s[first], outputs=long.outputs[first])
    with pytest.raises(TooLittleError, match="too short"):
        fit_response([short])
    with pytest.raises(TooLittleError, match="too short"):
        fit_response([])
    with pytest.raises(TooLittleError, match="not finite"):
        ResponseData("nan", CHANGES_S, LEVELS, SAMPLES_S, still + math.nan)
    with pytest.raises(TooLittleError, match="do not rise"):
        ResponseData("back", CHANGES_S[::-1], LEVELS, SAMPLES_S, still)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_vehicle_that_did_not_answer_has_no_model(noise: float) -> None:
    """As one on the ground, or that something else steered."""
    still = 0 * flown(ResponseModel(1.0, 0.1, 0.3)).outputs
    shaken = still + np.random.default_rng(1).normal(0.0, 1.0, len(still)) * noise
    with pytest.raises(TooLittleError, match=r"no answer: .* any gain"):
        fit_response([ResponseData("still", CHANGES_S, LEVELS, SAMPLES_S, shaken)])
