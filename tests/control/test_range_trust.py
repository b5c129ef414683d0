"""How wrong a range may be, and that the keep-out is kept all the same."""

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_control.envelope.envelope import Envelope
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.pursuit_state import SIZE_ERROR, ServoErrors
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState

DT, HEIGHT, RANGE = 0.02, 6.0, 12.0
KEEP_OUT = EnvelopeSettings().min_distance_m or 0.0


def errors(range_from: RangeFrom, unseen_s: float = 0.0, placed: bool = True) -> ServoErrors:
    """Look at a standing target for three seconds, then not at it for some; the last errors."""
    servo = VisualServo(ServoSettings(target_size_m=1.0, range_from=range_from))
    servo.start()
    for i in range(round((3.0 + unseen_s) / DT)):
        now_s = i * DT
        seen = TargetEstimate(
            now_s, 0.0, -math.asin(HEIGHT / RANGE), -math.log(RANGE), 0, 0, 0,
            np.eye(6) * 1e-4, min(now_s, 3.0), BearingFrame.WORLD,
        )  # fmt: skip
        vehicle = VehicleState(
            attitude=Attitude(0, 0, 0, 0, 0, 0, now_s),
            position=LocalPosition(0, 0, -HEIGHT, 0, 0, 0, now_s) if placed else None,
        )
        servo.update(seen, vehicle, HOLD)
    assert servo.errors is not None
    return servo.errors


@pytest.mark.parametrize("placed", [True, False])
def test_a_range_by_size_is_never_surer_than_sizes_are(placed: bool) -> None:
    found = errors(RangeFrom.SIZE, placed=placed)
    assert found.range_m == pytest.approx(RANGE, rel=1e-3)
    assert found.range_deviation_m >= SIZE_ERROR * found.range_m * (1 - 1e-9)
    assert found.least_range_m == pytest.approx(found.range_m - found.range_deviation_m)


def test_a_range_by_the_ground_is_surer() -> None:
    found = errors(RangeFrom.GROUND)
    assert found.range_m == pytest.approx(RANGE, rel=1e-3)
    assert found.range_deviation_m < 0.5 * SIZE_ERROR * RANGE


@pytest.mark.parametrize("range_from", list(RangeFrom))
def test_a_target_that_is_not_seen_is_ever_less_to_be_counted_on(range_from: RangeFrom) -> None:
    least = [errors(range_from, unseen_s).least_range_m for unseen_s in (0.0, 0.6, 1.5)]
    assert least == sorted(least, reverse=True)
    assert least[-1] < least[0] - 1


def test_the_least_range_is_not_negative() -> None:
    found = errors(RangeFrom.SIZE)
    assert replace(found, range_deviation_m=99.0).least_range_m == 0


@pytest.mark.slow
@settings(max_examples=25)
@given(
    speed=st.floats(0.0, 8.0),
    seems=st.floats(1 - SIZE_ERROR, 1 + SIZE_ERROR),
    delay_s=st.floats(0.0, 0.5),
    braking=st.floats(0.5, 2.0),
)
def test_a_target_that_brakes_is_not_run_into_by_one_that_wants_to(
    speed: float, seems: float, delay_s: float, braking: float
) -> None:
    """It looks as much too far away as sizes are usually wrong; we answer late, and want 10 m/s."""
    dt, envelope = 0.05, Envelope()
    envelope.start(HOLD, 0.0)
    late = deque([0.0] * round(delay_s / dt))
    gap_m, nearest_m, target_m_s = 35.0, math.inf, speed
    for i in range(round(30 / dt)):
        known_m = seems * gap_m * (1 - SIZE_ERROR)
        context = FlightContext(
            yaw_rad=0.0, north_m=0.0, east_m=0.0, height_m=10.0, target_range_m=known_m,
            target_bearing_rad=0.0, target_speed_m_s=target_m_s,
        )  # fmt: skip
        asked = VelocitySetpoint(forward_m_s=10.0)
        late.append(envelope.limit(asked, i * dt, context).allowed.forward_m_s)
        if i * dt > 18:
            target_m_s = max(target_m_s - braking * dt, 0.0)
        gap_m += (target_m_s - late.popleft()) * dt
        nearest_m = min(nearest_m, gap_m)
    assert nearest_m > KEEP_OUT


def test_where_the_ground_says_nothing_the_size_that_fitted_before_counts() -> None:
    """The line of sight becomes too flat; nobody told the size, and no stand-in takes its place."""
    servo = VisualServo(ServoSettings(range_from=RangeFrom.GROUND, distance_m=12.0))
    servo.start()
    for i in range(200):
        now_s, elevation = i * DT, -30.0 if i < 100 else -4.0
        seen = TargetEstimate(
            now_s, 0.0, math.radians(elevation), math.log(0.9 / 6.0), 0, 0, 0,
            np.eye(6) * 1e-4, now_s, BearingFrame.WORLD,
        )  # fmt: skip
        vehicle = VehicleState(
            attitude=Attitude(0, 0, 0, 0, 0, 0, now_s),
            position=LocalPosition(0, 0, -3.0, 0, 0, 0, now_s),
        )
        servo.update(seen, vehicle, HOLD)
        assert servo.errors.range_m == pytest.approx(6.0, rel=0.1)


def test_by_the_ground_it_sinks_with_the_speed_that_was_sent_until_that_is_in_vain() -> None:
    def sinking(sent_m_s: float, seconds: float) -> float:
        wanted = ServoSettings(target_size_m=1.0, range_from=RangeFrom.GROUND, elevation_deg=-30.0)
        servo = VisualServo(wanted)
        servo.start()
        for i in range(round(seconds / DT)):
            now_s = i * DT
            seen = TargetEstimate(
                now_s, 0.0, -math.asin(HEIGHT / RANGE), -math.log(RANGE), 0, 0, 0,
                np.eye(6) * 1e-4, now_s, BearingFrame.WORLD,
            )  # fmt: skip
            vehicle = VehicleState(
                attitude=Attitude(0, 0, 0, 0, 0, 0, now_s),
                position=LocalPosition(0, 0, -HEIGHT, 0, 0, 0, now_s),
            )
            asked = servo.update(seen, vehicle, VelocitySetpoint(forward_m_s=sent_m_s))
        return asked.down_m_s

    assert sinking(2.0, 0.3) - sinking(0.0, 0.3) > 0.25
    assert sinking(2.0, 20.0) - sinking(0.0, 20.0) == pytest.approx(0.0, abs=0.02)
