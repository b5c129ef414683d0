"""The simulated vehicle beside the recordings of real autopilots."""

import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from real_data import DATA, needs_data

from follower_sim.scoring.recorded_step import RecordedStep, SentSetpoint

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "autopilot_steps"
_metrics = runpy.run_path(str(BENCHMARK / "step_metrics.py"))
crossing, fall, rise = (_metrics[name] for name in ("crossing", "fall", "rise"))
stepped_signals, max_tilt_deg = _metrics["stepped_signals"], _metrics["max_tilt_deg"]
fly_again = runpy.run_path(str(BENCHMARK / "step_replay.py"))["fly_again"]

STEPS = {
    "ardupilot": (
        "ap_vx1_f9",
        "ap_vx3_f1_north",
        "ap_vx3_f7_localoffset",
        "ap_vx3_f8",
        "ap_vx3_f9",
        "ap_vx3_yaw30_f9",
        "ap_vx8_f9",
        "ap_vy3_f9_right",
        "ap_vz_down1_f9",
        "ap_vz_up1_f9",
        "ap_yawrate30_f9",
        "ap_yawrate30neg_f1",
    ),
    "px4": (
        "px_vx1_f8",
        "px_vx3_f1_north",
        "px_vx3_f8",
        "px_vx3_yaw30_f8",
        "px_vx8_f8",
        "px_vxm3_f8",
        "px_vy3_f8_right",
        "px_vz_down1_f8",
        "px_vz_up1_f8",
        "px_yawrate30_f8",
        "px_yawrate30neg_f1",
    ),
}


@needs_data("autopilot_steps")
@pytest.mark.parametrize(
    ("flavour", "name"), [(flavour, name) for flavour, names in STEPS.items() for name in names]
)
def test_every_recorded_step_is_met_within_15_percent_or_the_readings_noise(
    flavour: str, name: str
) -> None:
    real = RecordedStep.load(DATA / "autopilot_steps" / f"{name}.csv")
    flown = fly_again(flavour, real)
    for true, ours in zip(stepped_signals(real), stepped_signals(flown), strict=True):
        assert rise(real, true).disagreements(rise(flown, ours)) == []
        assert fall(real, true).disagreements(fall(flown, ours)) == []
    if max_tilt_deg(real) > 5.0:
        assert max_tilt_deg(flown) == pytest.approx(max_tilt_deg(real), rel=0.15)


def step_of(
    velocity: tuple[float, float, float], yaw_rate_deg_s: float = 0.0, seconds: float = 8.0
) -> RecordedStep:
    """Return the setpoints of a step as they were recorded, without a recording."""
    zero = SentSetpoint(0.0, 8, 0x5C7, (0.0, 0.0, 0.0), 0.0)
    step = SentSetpoint(1.5, 8, 0x5C7, velocity, math.radians(yaw_rate_deg_s))
    end = SentSetpoint(1.5 + seconds, 8, 0x5C7, (0.0, 0.0, 0.0), 0.0)
    times = np.array([0.0, end.time_s + 6.0])
    nothing = np.zeros((3, 2))
    return RecordedStep(
        "step", times, nothing, nothing, np.zeros(2), np.zeros(2), (zero, step, end)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "velocity", "yaw_rate", "t63", "t90", "overshoot", "steady"),
    [
        ("ardupilot", (3.0, 0.0, 0.0), 0.0, 1.08, 1.67, 0.01, 1.00),
        ("ardupilot", (1.0, 0.0, 0.0), 0.0, 0.74, 1.28, 0.00, 0.98),
        ("ardupilot", (8.0, 0.0, 0.0), 0.0, 2.41, 3.37, 0.026, 1.005),
        ("ardupilot", (0.0, 0.0, 1.0), 0.0, 0.80, 1.05, 0.08, 0.99),
        ("ardupilot", (0.0, 0.0, -1.0), 0.0, 0.80, 1.05, 0.07, 0.99),
        ("ardupilot", (0.0, 0.0, 0.0), 30.0, 0.34, 0.43, 0.23, 1.007),
        ("px4", (3.0, 0.0, 0.0), 0.0, 0.94, 6.0, -0.09, 0.90),
        ("px4", (8.0, 0.0, 0.0), 0.0, 1.17, None, -0.09, 0.887),
        ("px4", (0.0, 0.0, 1.0), 0.0, 0.34, None, -0.11, 0.81),
        ("px4", (0.0, 0.0, -1.0), 0.0, 0.31, 0.47, None, 1.14),
        ("px4", (0.0, 0.0, 0.0), 30.0, 0.40, 0.58, None, 0.997),
    ],
)
def test_the_table_of_facts(
    flavour: str,
    velocity: tuple[float, float, float],
    yaw_rate: float,
    t63: float,
    t90: float | None,
    overshoot: float | None,
    steady: float,
) -> None:
    flown = fly_again(flavour, step_of(velocity, yaw_rate))
    (signal,) = stepped_signals(flown)
    metrics = rise(flown, signal)
    assert metrics.t63_s == pytest.approx(t63, rel=0.15)
    if t90 is not None:
        assert metrics.t90_s == pytest.approx(t90, rel=0.15)
    if overshoot is not None:  # PX4's readings are too noisy for a peak
        assert metrics.overshoot == pytest.approx(overshoot, abs=0.035)
    assert metrics.steady == pytest.approx(steady, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "lag_deg", "allowed_deg"),
    # 15 %; PX4's recording errs by 0.09 m/s of 2 m/s before the step, which is 2.5 deg more.
    [("ardupilot", 18.5, 2.8), ("px4", 21.1, math.hypot(3.2, 2.5))],
)
def test_the_velocity_lags_behind_a_turning_nose(
    flavour: str, lag_deg: float, allowed_deg: float
) -> None:
    flown = fly_again(flavour, step_of((3.0, 0.0, 0.0), 30.0, seconds=12.0))
    steady = (flown.time_s > 5.0) & (flown.time_s < 13.0)
    forward, right, _ = flown.heading_velocity_m_s[:, steady].mean(axis=1)
    assert math.degrees(math.atan2(-right, forward)) == pytest.approx(lag_deg, abs=allowed_deg)


@pytest.mark.slow
@pytest.mark.parametrize(("flavour", "distance_m"), [("ardupilot", 2.95), ("px4", 3.6)])
def test_the_stop_from_3_m_s_takes_its_distance(flavour: str, distance_m: float) -> None:
    flown = fly_again(flavour, step_of((3.0, 0.0, 0.0)))
    stopping = flown.time_s > flown.sent[2].time_s
    forward = flown.heading_velocity_m_s[0, stopping]
    assert np.trapezoid(forward, flown.time_s[stopping]) == pytest.approx(distance_m, rel=0.15)


def test_crossings_lie_between_samples_and_may_never_come() -> None:
    time_s, level = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0])
    assert crossing(time_s, level, 0.63) == pytest.approx(1.26)
    assert crossing(time_s, level, 1.5) == math.inf


def test_metrics_of_a_known_curve() -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    since = np.clip(time_s - 1.5, 0.0, None)
    signal = 2.0 * (1.0 - np.exp(-since))
    signal[time_s > 11.5] = 0.0
    step = step_of((2.0, 0.0, 0.0), seconds=10.0)
    north = np.stack([signal, np.zeros_like(signal), np.zeros_like(signal)])
    still = np.zeros_like(north)
    curve = RecordedStep("curve", time_s, north, still, still[0], still[0], step.sent)
    (stepped,) = stepped_signals(curve)
    metrics = rise(curve, stepped)
    assert metrics.t63_s == pytest.approx(-math.log(0.37), abs=0.01)
    assert metrics.t90_s == pytest.approx(math.log(10.0), abs=0.01)
    assert metrics.overshoot == pytest.approx(0.0, abs=0.01)
    assert metrics.disagreements(metrics) == []
    assert len(metrics.disagreements(fall(curve, stepped))) > 0
