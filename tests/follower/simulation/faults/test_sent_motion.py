"""The random flights' rules, seen from the packets alone, and their cheap vehicle."""

import math

import numpy as np
import pytest

from follower.settings.settings import Settings, load_settings
from follower.simulation.fault_tests.invariants import (
    InputAges,
    InvariantError,
    Invariants,
    SetpointDerivatives,
)
from follower.simulation.fault_tests.simple_vehicle import SimpleVehicle
from follower.simulation.faults.setpoint_rules import (
    BODY_FRAME,
    VELOCITY_AND_YAW_RATE,
    jump_failure,
)
from follower.simulation.faults.wire_tap import WireSetpoint
from follower_control.common.transport import MemoryTransport
from follower_control.envelope.settings import EnvelopeSettings

LIMITS = EnvelopeSettings(max_acceleration_m_s2=3.0, max_jerk_m_s3=10.0)
STEP_S = 0.02


def _sent(number: int, forward: float, turn_deg_s: float = 0.0) -> WireSetpoint:
    values = (forward, 0.0, 0.0, math.radians(turn_deg_s))
    return WireSetpoint(number * STEP_S, BODY_FRAME, VELOCITY_AND_YAW_RATE, values)


def _failures(speeds: list[float]) -> list[str]:
    motion = SetpointDerivatives(LIMITS)
    told = [motion.failure(_sent(number, speed)) for number, speed in enumerate(speeds)]
    return [failure for failure in told if failure]


def test_speeding_up_within_the_limits_is_no_failure() -> None:
    speeds, acceleration = [1.0], 0.0
    for _ in range(40):
        acceleration = min(acceleration + 10.0 * STEP_S, 3.0)
        speeds.append(speeds[-1] + acceleration * STEP_S)
    assert _failures(speeds) == []


def test_more_acceleration_than_allowed_is_told() -> None:
    assert _failures([1.0, 1.0 + 3.2 * STEP_S]) == ["an acceleration of 3.20 m/s2 is sent"]


def test_more_jerk_than_allowed_is_told() -> None:
    ahead, back = 1.0 + 1.0 * STEP_S, 1.0
    assert _failures([1.0, ahead, back]) == ["a jerk of 100.0 m/s3 is sent"]


@pytest.mark.parametrize(
    ("turns_deg_s", "told"),
    [
        ([0.0, 1.2, 2.4, 2.4], []),
        ([0.0, 2.6], ["a yaw acceleration of 130.0 deg/s2 is sent"]),
        ([0.0, 1.2, 0.0], ["a yaw jerk of 6000 deg/s3 is sent"]),
    ],
)
def test_the_yaw_rate_has_its_own_limits(turns_deg_s: list[float], told: list[str]) -> None:
    limits = EnvelopeSettings(max_yaw_acceleration_deg_s2=120.0, max_yaw_jerk_deg_s3=3100.0)
    motion = SetpointDerivatives(limits)
    sent = [_sent(number, 1.0, turn) for number, turn in enumerate(turns_deg_s)]
    assert [failure for one in sent if (failure := motion.failure(one))] == told


def test_the_jump_of_a_yaw_rate_is_told() -> None:
    limits = EnvelopeSettings(max_yaw_acceleration_deg_s2=100.0)
    assert jump_failure(_sent(0, 1.0), _sent(1, 1.0, 4.9), limits) == ""
    told = "the yaw rate changes by 5.1 deg/s within 0.040 s"
    assert jump_failure(_sent(0, 1.0), _sent(1, 1.0, 5.1), limits) == told


def test_a_zero_may_come_at_any_time_and_following_may_begin_after_it() -> None:
    assert _failures([5.0, 5.0, 0.0, 4.0, 4.0]) == []


def _look(setpoint: WireSetpoint, allowed: float, telemetry_age_s: float = 0.02) -> None:
    inputs = InputAges(
        0.05, 0.05, 0.5, STEP_S, telemetry_age_s, None, True, (allowed, 0.0, 0.0, 0.0)
    )
    invariants = Invariants(Settings(), own_mode=4, begun_anew_by_mode=False)
    invariants.heartbeat(4, setpoint.time_s)
    invariants.check([setpoint], setpoint.time_s, inputs, engages=True)


def test_a_velocity_that_its_step_did_not_allow_is_told() -> None:
    _look(_sent(5, 1.0), allowed=1.0)
    with pytest.raises(InvariantError, match="did not allow"):
        _look(_sent(5, 1.0), allowed=0.9)


def test_steering_by_old_telemetry_is_told() -> None:
    with pytest.raises(InvariantError, match="steering by telemetry"):
        _look(_sent(5, 1.0), allowed=1.0, telemetry_age_s=0.6)


def _blind(speeds: list[float], own_m_s: complex | None = None) -> None:
    """Send these speeds, a step each; after the first one the frames are too old."""
    envelope = {"max_acceleration_m_s2": 3.0, "max_jerk_m_s3": 3.0}
    settings = load_settings(base={"envelope": envelope})
    invariants = Invariants(settings, own_mode=4, begun_anew_by_mode=False)
    for number, speed in enumerate(speeds):
        setpoint = _sent(number, speed)
        age_s = 5.0 if number else 0.0
        inputs = InputAges(age_s, age_s, 0.1, STEP_S, 0.02, own_m_s, False, setpoint.values)
        invariants.heartbeat(4, setpoint.time_s)
        invariants.check([setpoint], setpoint.time_s, inputs, engages=False)


def _braked(acceleration: float, jerk: float) -> list[float]:
    speeds = [2.0, 2.0 + acceleration * STEP_S]
    while acceleration > 0:
        acceleration -= jerk * STEP_S
        speeds.append(speeds[-1] + acceleration * STEP_S)
    return speeds


def test_braking_within_the_jerk_may_add_speed_when_nothing_is_seen() -> None:
    speeds = _braked(3.0, 3.0)
    assert speeds[-2] - speeds[0] == pytest.approx(1.5, abs=0.1)
    _blind(speeds)


def test_speeding_up_when_nothing_is_seen_is_told() -> None:
    with pytest.raises(InvariantError, match="the speed grows"):
        _blind([2.0 + 3.0 * STEP_S * number for number in range(60)])


def test_it_may_grow_against_the_motion_that_fresh_telemetry_tells_of() -> None:
    speeds = [2.0 + 3.0 * STEP_S * number for number in range(60)]
    _blind(speeds, own_m_s=-1.0 + 0.5j)
    with pytest.raises(InvariantError, match="the speed grows"):
        _blind(speeds, own_m_s=1.0 + 0j)


def test_a_vehicle_can_be_handed_a_mode_before_its_first_step() -> None:
    _, theirs = MemoryTransport.pair()
    rng = np.random.default_rng(0)
    vehicle = SimpleVehicle("px4", theirs, rng, (0.0, 0.0, -10.0))
    vehicle.enter("RTL")
    assert vehicle.mode.name == "RTL"
