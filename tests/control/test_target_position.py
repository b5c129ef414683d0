"""Where the target is in the world: closed forms, and a covariance that drawn errors agree with."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.servo.position_fix import PositionNoise, target_fix
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.state import Clearance, LocalPosition, VehicleState
from follower_vision.geometry.camera_model import Vector

SIZE = 1.8
BY_SIZE = ServoSettings(target_size_m=SIZE)
BY_GROUND = ServoSettings(range_from=RangeFrom.GROUND, target_middle_m=0.5)
EXACT = PositionNoise(0.0, 0.0, 0.0, 0.0, 0.0)
OWN = np.array((10.0, -5.0, -12.0)), np.array((3.0, 1.0, -0.5))


def seen(place: Vector, velocity: Vector, covariance: Vector | None = None) -> TargetEstimate:
    """Return what is seen of a target at a place, from our own."""
    offset, moving = place - OWN[0], velocity - OWN[1]
    level2, range_m = float(offset[0] ** 2 + offset[1] ** 2), float(np.linalg.norm(offset))
    range_rate = float(offset @ moving) / range_m
    sine = -offset[2] / range_m
    return TargetEstimate(
        time_s=5.0,
        azimuth_rad=math.atan2(offset[1], offset[0]),
        elevation_rad=math.asin(sine),
        log_scale=math.log(SIZE / range_m),
        azimuth_rate_rad_s=float(offset[0] * moving[1] - offset[1] * moving[0]) / level2,
        elevation_rate_rad_s=(-moving[2] - sine * range_rate) / math.sqrt(level2),
        log_scale_rate_s=-range_rate / range_m,
        covariance=np.zeros((6, 6)) if covariance is None else covariance,
        last_seen_s=5.0,
        frame=BearingFrame.WORLD,
    )


def vehicle(time_s: float = 5.0) -> VehicleState:
    return VehicleState(position=LocalPosition(*OWN[0], *OWN[1], time_s))


away = st.floats(3.0, 60.0) | st.floats(-60.0, -3.0)
speed = st.floats(-8.0, 8.0)


@given(away, away, speed, speed)
def test_by_the_ground_a_target_on_it_is_where_it_is(
    north: float, east: float, v_north: float, v_east: float
) -> None:
    place = np.array((OWN[0][0] + north, OWN[0][1] + east, -0.5))
    velocity = np.array((v_north, v_east, 0.0))
    fix = target_fix(seen(place, velocity), vehicle(), BY_GROUND, EXACT)
    assert fix.position_m == pytest.approx(place, abs=1e-3)
    assert fix.velocity_m_s == pytest.approx(velocity, abs=1e-2)


@given(away, away, st.floats(-20, 11.0), speed, speed, speed)
def test_by_its_size_a_target_in_the_air_is_where_it_is(
    north: float, east: float, sunk: float, v_north: float, v_east: float, v_down: float
) -> None:
    place = OWN[0] + np.array((north, east, sunk))
    velocity = np.array((v_north, v_east, v_down))
    fix = target_fix(seen(place, velocity), vehicle(), BY_SIZE, EXACT)
    assert fix.position_m == pytest.approx(place, abs=1e-3)
    assert fix.velocity_m_s == pytest.approx(velocity, abs=1e-2)
    assert fix.range_m == pytest.approx(float(np.linalg.norm(place - OWN[0])), abs=1e-3)


def test_a_box_that_has_shrunk_puts_nothing_below_the_ground() -> None:
    place = np.array((30.0, 0.0, 0.0))
    shrunk = replace(seen(place, np.zeros(3)), log_scale=math.log(SIZE / 60.0))
    fix = target_fix(shrunk, vehicle(), BY_SIZE, EXACT)
    assert fix.position_m == pytest.approx(place, abs=1e-3)


@pytest.mark.parametrize("servo", [BY_SIZE, BY_GROUND], ids=["size", "ground"])
def test_drawn_errors_spread_as_the_covariance_says(servo: ServoSettings) -> None:
    lots = np.random.default_rng(7)
    place, velocity = np.array((28.0, 6.0, -0.5)), np.array((4.0, -1.0, 0.0))
    spreads = np.array((0.01, 0.008, 0.03, 0.03, 0.02, 0.05))
    true = seen(place, velocity, np.diag(spreads**2))
    fix = target_fix(true, vehicle(), servo, EXACT)
    found = []
    for draw in lots.normal(0, spreads, (400, 6)):
        numbers = (
            true.azimuth_rad + draw[0],
            true.elevation_rad + draw[1],
            true.log_scale + draw[2],
            true.azimuth_rate_rad_s + draw[3],
            true.elevation_rate_rad_s + draw[4],
            true.log_scale_rate_s + draw[5],
        )
        other = target_fix(
            TargetEstimate(5.0, *numbers, np.zeros((6, 6)), 5.0, BearingFrame.WORLD),
            vehicle(),
            servo,
            EXACT,
        )
        found.append((*other.position_m, *other.velocity_m_s))
    drawn = np.sqrt(np.diag(np.cov(np.array(found).T)))
    said = np.sqrt(np.diag(fix.covariance))
    assert said == pytest.approx(drawn, rel=0.15, abs=1e-6)


def test_what_else_is_uncertain_adds_to_it() -> None:
    true = seen(np.array((28.0, 6.0, -0.5)), np.zeros(3))
    fix = target_fix(true, vehicle(), BY_GROUND, EXACT._replace(position_m=2.0, velocity_m_s=0.7))
    assert (fix.horizontal_m, fix.vertical_m) == pytest.approx((2.0, 2.0), abs=1e-6)
    # Climbing faster than thought would look like a target that moves away.
    assert 0.7 <= fix.speed_m_s <= 2.0


@pytest.mark.parametrize(
    ("estimate", "state", "servo"),
    [
        (seen(np.array((28.0, 6.0, -0.5)), np.zeros(3)), VehicleState(), BY_GROUND),
        (seen(np.array((28.0, 6.0, -0.5)), np.zeros(3)), vehicle(4.0), BY_GROUND),
        (seen(np.array((28.0, 6.0, -30.0)), np.zeros(3)), vehicle(), BY_GROUND),
        (
            replace(seen(np.array((28.0, 6.0, -0.5)), np.zeros(3)), frame=BearingFrame.BODY),
            vehicle(),
            BY_SIZE,
        ),
    ],
    ids=["no position", "an old one", "above the horizon", "no heading"],
)
def test_what_is_not_known_is_not_told(
    estimate: TargetEstimate, state: VehicleState, servo: ServoSettings
) -> None:
    assert target_fix(estimate, state, servo) is None


@given(st.floats(3.0, 20.0), st.floats(-20.0, -3.0), st.floats(-6.0, 6.0))
def test_by_a_rangefinder_the_ground_is_where_it_was_measured(
    north: float, east: float, ground_m: float
) -> None:
    """The ground lies higher or lower than home, and the target stands on it."""
    place = np.array((OWN[0][0] + north, OWN[0][1] + east, -ground_m - 0.5))
    measured = replace(vehicle(), clearance=Clearance(12.0 - ground_m, 4.9))
    fix = target_fix(seen(place, np.zeros(3)), measured, BY_GROUND, EXACT)
    assert fix.position_m == pytest.approx(place.tolist(), abs=1e-6)
