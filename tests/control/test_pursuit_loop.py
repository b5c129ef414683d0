"""The closed loop on paper: estimator, servo and envelope fly a vehicle like the real ones.

Sightings are the true direction and size with noise, 0.1 s late; the vehicle answers velocity
setpoints like the autopilots measured in data/autopilot_steps: ArduPilot with 0.2 s dead time and
an S-curve of 2.7 m/s2, PX4 quickly to three quarters and then with a slow tail.
"""

import cmath
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from follower_control.envelope.envelope import Envelope
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo import servo as servo_module
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import FollowMode, ServoSettings
from follower_control.target.estimator import TargetEstimator
from follower_control.target.observation import BearingFrame, BearingObservation, to_line_of_sight
from follower_control.target.settings import EstimatorSettings
from follower_control.tuning.axes import Axis, LoopSettings, axis_loop
from follower_control.tuning.axis_loop import Conditions, LoopDelays
from follower_control.tuning.response_model import ResponseModel, VehicleModel
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.geometry.line_of_sight import LineOfSight, wrap_angle

SIZE, DISTANCE, PITCH = 1.8, 15.0, math.radians(-20)
STEP, CONTROL_EVERY, SIGHT_EVERY, DELAY = 0.01, 2, 3, 0.1
Path = Callable[[float], tuple[float, float, float]]


@dataclass
class Vehicle:
    """Horizontal vectors are complex: north + 1j * east."""

    dead_s: float
    yaw_damping: float
    place: complex = 0.0
    height: float = 6.0
    yaw: float = 0.0
    velocity: complex = 0.0
    climb: float = 0.0
    yaw_rate: float = 0.0
    yaw_acceleration: float = 0.0
    sent: deque[tuple[float, VelocitySetpoint]] = field(default_factory=deque)

    def step(self, now_s: float) -> None:
        while len(self.sent) > 1 and self.sent[1][0] <= now_s - self.dead_s:
            self.sent.popleft()
        asked = self.sent[0][1] if self.sent and self.sent[0][0] <= now_s - self.dead_s else HOLD
        self.move(complex(asked.forward_m_s, asked.right_m_s) * cmath.rect(1, self.yaw))
        self.rise(-asked.down_m_s)
        pull = 36 * (asked.yaw_rate_rad_s - self.yaw_rate)
        self.yaw_acceleration += (pull - 12 * self.yaw_damping * self.yaw_acceleration) * STEP
        self.yaw_rate += self.yaw_acceleration * STEP
        self.yaw = wrap_angle(self.yaw + self.yaw_rate * STEP)
        self.place += self.velocity * STEP
        self.height += self.climb * STEP

    def state(self, now_s: float) -> VehicleState:
        return VehicleState(
            attitude=Attitude(0, 0, self.yaw, 0, 0, self.yaw_rate, now_s),
            position=LocalPosition(
                self.place.real,
                self.place.imag,
                -self.height,
                self.velocity.real,
                self.velocity.imag,
                -self.climb,
                now_s,
            ),
        )


@dataclass
class ArduPilot(Vehicle):
    dead_s: float = 0.2
    yaw_damping: float = 0.45
    acceleration: complex = 0.0

    def move(self, wanted: complex) -> None:
        pull = clip(2 * (wanted - self.velocity), 2.7)
        self.acceleration += clip(pull - self.acceleration, 8 * STEP)
        self.velocity += self.acceleration * STEP

    def rise(self, wanted: float) -> None:
        self.climb += (wanted - self.climb) * STEP / 0.35


@dataclass
class Px4(Vehicle):
    dead_s: float = 0.12
    yaw_damping: float = 0.6
    tail: complex = 0.0

    def move(self, wanted: complex) -> None:
        quick = self.velocity - self.tail
        self.tail += (0.25 * wanted - self.tail) * STEP / 6
        quick += clip((0.75 * wanted - quick) / 0.5, 6.0) * STEP
        self.velocity = quick + self.tail

    def rise(self, wanted: float) -> None:
        self.climb += (0.85 * wanted - self.climb) * STEP / 0.25


def clip(vector: complex, size: float) -> complex:
    return vector if abs(vector) <= size else vector * (size / abs(vector))


@dataclass
class Flight:
    """What happened, one entry a control step."""

    time: list[float] = field(default_factory=list)
    azimuth_deg: list[float] = field(default_factory=list)
    elevation_deg: list[float] = field(default_factory=list)
    range: list[float] = field(default_factory=list)
    height: list[float] = field(default_factory=list)
    bearing_deg: list[float] = field(default_factory=list)
    beside: list[float] = field(default_factory=list)
    asked: list[VelocitySetpoint] = field(default_factory=list)
    flown: list[VelocitySetpoint] = field(default_factory=list)

    def of(self, name: str, start_s: float = 0.0, end_s: float = math.inf) -> np.ndarray:
        time = np.array(self.time)
        return np.array(getattr(self, name))[(time >= start_s) & (time < end_s)]


def fly(
    vehicle: Vehicle,
    path: Path,
    seconds: float,
    servo_settings: ServoSettings | None = None,
    telemetry: bool = True,
    changes: dict[float, FollowMode] | None = None,
    noise: float = 1.0,
) -> Flight:
    """Fly and measure; `changes` says at which times the mode changes, and to which one.

    `noise` is a factor on that of the sightings.
    """
    rng = np.random.default_rng(0)
    servo = VisualServo(servo_settings or ServoSettings(target_size_m=SIZE), PITCH)
    waiting = dict(changes or {})
    envelope, estimator, flight = Envelope(EnvelopeSettings()), TargetEstimator(), Flight()
    envelope.start(HOLD, 0.0)
    allowed, seen = HOLD, deque()
    for tick in range(round(seconds / STEP)):
        now_s = tick * STEP
        vehicle.step(now_s)
        north, east, up = path(now_s)
        relative = np.array([north - vehicle.place.real, east - vehicle.place.imag])
        distance = math.hypot(*relative, up - vehicle.height)
        away = np.array([*relative, vehicle.height - up])
        sight = LineOfSight.from_vector(away)
        down = BearingFrame.DOWN if servo.mode is FollowMode.OVERHEAD else BearingFrame.WORLD
        if tick % SIGHT_EVERY == 0:
            error = noise * rng.normal(0, (0.005, 0.005, 0.03))
            true = to_line_of_sight(away, down)
            noisy = LineOfSight(
                wrap_angle(true.azimuth_rad + error[0]), true.elevation_rad + error[1]
            )
            seen.append(
                BearingObservation(noisy, math.log(SIZE / distance) + error[2], now_s, down)
            )
        if tick % CONTROL_EVERY:
            continue
        while seen and seen[0].time_s <= now_s - DELAY:
            estimator.observe(seen.popleft())
        estimate = estimator.estimate(now_s)
        if estimate is None:
            continue
        state = vehicle.state(now_s)
        told = state if telemetry else VehicleState(attitude=state.attitude)
        if waiting and now_s >= min(waiting):
            servo.change_mode(waiting.pop(min(waiting)), allowed)
        asked = servo.update(estimate, told, allowed)
        errors = servo.errors
        context = replace(
            FlightContext.of(state, now_s),
            target_range_m=errors.range_m,
            target_bearing_rad=errors.azimuth_rad,
            target_speed_m_s=errors.target_speed_m_s,
        )
        if servo.mode is FollowMode.OVERHEAD:
            context = replace(context, target_range_m=100.0)
        allowed = envelope.limit(asked, now_s, context).allowed
        vehicle.sent.append((now_s, allowed))
        flight.time.append(now_s)
        flight.azimuth_deg.append(math.degrees(wrap_angle(sight.azimuth_rad - vehicle.yaw)))
        flight.elevation_deg.append(math.degrees(sight.elevation_rad - PITCH))
        flight.range.append(distance)
        flight.height.append(vehicle.height)
        flight.bearing_deg.append(math.degrees(cmath.phase(complex(*-relative))))
        flight.beside.append(math.hypot(*relative))
        flight.asked.append(asked)
        flight.flown.append(allowed)
    return flight


def standing(range_m: float, bearing_deg: float = 0.0) -> Path:
    place = cmath.rect(range_m, math.radians(bearing_deg))
    return lambda _: (place.real, place.imag, 0.0)


def drive(speed: float, go_s: float = 5.0, stop_s: float = 25.0) -> Path:
    """Straight north from 14 m: speeds up with 1.5 m/s2 and stops with 2 m/s2."""

    def path(now_s: float) -> tuple[float, float, float]:
        on = min(max(now_s - go_s, 0.0), speed / 1.5)
        rolling = min(max(now_s - go_s - speed / 1.5, 0.0), stop_s - go_s - speed / 1.5)
        off = min(max(now_s - stop_s, 0.0), speed / 2)
        return 14 + 0.75 * on**2 + speed * rolling + speed * off - off**2, 0.0, 0.0

    return path


vehicles = pytest.mark.parametrize("vehicle", [ArduPilot, Px4])


@vehicles
@pytest.mark.parametrize("start_m", [40.0, 7.0])
def test_it_takes_up_its_distance_without_much_overshoot(vehicle, start_m):
    flight = fly(vehicle(), standing(start_m), 25)
    ranges = flight.of("range")
    overshoot = (DISTANCE - ranges.min()) if start_m > DISTANCE else (ranges.max() - DISTANCE)
    assert overshoot < 0.2 * abs(start_m - DISTANCE)
    assert np.abs(flight.of("range", 15) / DISTANCE - 1).max() < 0.1
    assert np.abs(flight.of("elevation_deg", 18)).max() < 2


@vehicles
@pytest.mark.parametrize("bearing_deg", [-170, 60])
def test_it_turns_to_the_target_before_it_closes_in(vehicle, bearing_deg):
    flight = fly(vehicle(), standing(30, bearing_deg), 15)
    turning = np.abs(flight.of("azimuth_deg")) > 40
    assert np.ptp(flight.of("range")[turning]) < 1.5 if turning.any() else True
    azimuth = flight.of("azimuth_deg") * math.copysign(1, bearing_deg)
    assert azimuth.min() > -0.2 * abs(bearing_deg)
    assert np.abs(flight.of("azimuth_deg", 6)).max() < 2
    assert np.abs(flight.of("range", 14) / DISTANCE - 1).max() < 0.15


@pytest.mark.slow
@vehicles
@pytest.mark.parametrize(("speed", "median"), [(5.0, 0.12), (8.0, 0.3)])
def test_a_car_is_followed_at_its_distance_and_through_its_stop(vehicle, speed, median):
    """At 8 m/s there is little left of our own 10 m/s, three quarters of it at once on PX4."""
    flight = fly(vehicle(), drive(speed), 38)
    assert np.abs(flight.of("azimuth_deg", 3)).max() < 3
    assert np.sqrt(np.mean(flight.of("elevation_deg", 3) ** 2)) < 7.5
    assert np.median(np.abs(flight.of("range", 3) / DISTANCE - 1)) < median
    assert np.abs(flight.of("range", 22, 25) / DISTANCE - 1).mean() < 0.1
    assert flight.of("range").min() > EnvelopeSettings().min_distance_m
    assert np.abs(flight.of("range", 36) / DISTANCE - 1).max() < 0.17


@pytest.mark.slow
def test_asking_for_more_while_it_stays_behind_swings_as_far_as_tuning_says(monkeypatch):
    """After a target that speeds up; PX4 stays behind for long enough to be linear there."""
    after_s, speeds, rig = np.linspace(0, 10, 501), (0.0, 0.5), []
    for most in (0.0, servo_module._MOST_SHORT):
        monkeypatch.setattr(servo_module, "_MOST_SHORT", most)
        steady, faster = (
            fly(Px4(), lambda t, v=v: (14 + 4 * t + v * max(t - 16, 0), 0, 0), 26, noise=0)
            for v in speeds
        )
        change = np.log(np.divide(faster.range, steady.range))
        rig.append(np.interp(after_s, np.array(steady.time) - 16, change))
    settings, px4 = ServoSettings(), ResponseModel(1, 0.12, 3**0.5, 6.5 / 12**0.5, 4.625)
    loop = axis_loop(
        Axis.RANGE,
        settings.range,
        VehicleModel(px4, px4, px4, px4),
        LoopSettings(settings, EstimatorSettings(), EnvelopeSettings()),
        Conditions(LoopDelays(DELAY, SIGHT_EVERY * STEP), DISTANCE, PITCH),
    )
    told = [
        speeds[1] / DISTANCE * np.interp(after_s, *one.disturbance_response(10))
        for one in (replace(loop, shortfall=None), loop)
    ]
    flown, modelled = rig[1] - rig[0], told[1] - told[0]
    assert flown.min() < -0.01
    assert np.linalg.norm(modelled - flown) < 0.3 * np.linalg.norm(flown)


@vehicles
def test_a_target_passing_sideways_stays_in_the_middle(vehicle):
    flight = fly(vehicle(), lambda t: (14.0, 5.0 * t - 5.0, 0.0), 20)
    assert np.abs(flight.of("azimuth_deg", 2)).max() < 4
    assert np.sqrt(np.mean(flight.of("azimuth_deg", 2) ** 2)) < 1
    assert np.abs(flight.of("range", 15) / DISTANCE - 1).max() < 0.1


@vehicles
def test_a_climbing_target_is_climbed_after(vehicle):
    flight = fly(vehicle(), lambda t: (14.0, 0.0, max(0.0, 1.0 * (t - 5))), 25)
    assert np.abs(flight.of("elevation_deg", 10)).max() < 6.5
    assert flight.height[-1] - flight.height[0] > 17


@vehicles
def test_without_the_vehicle_s_velocity_it_follows_with_a_larger_lag(vehicle):
    flight = fly(vehicle(), drive(4.0), 38, telemetry=False)
    assert np.abs(flight.of("range", 22, 25) / DISTANCE - 1).max() < 0.4
    assert np.abs(flight.of("range", 36) / DISTANCE - 1).max() < 0.15


@vehicles
def test_an_unknown_target_is_kept_at_the_size_it_had(vehicle):
    flight = fly(vehicle(), drive(5.0), 38, servo_settings=ServoSettings())
    held = math.hypot(14.0, 6.0)
    assert np.abs(flight.of("range", 20, 25) / held - 1).max() < 0.15
    assert np.abs(flight.of("range", 36) / held - 1).max() < 0.15


def modal(mode: FollowMode, **others: object) -> ServoSettings:
    return ServoSettings(mode=mode, target_size_m=SIZE, distance_m=DISTANCE, **others)


@pytest.mark.slow
@vehicles
@pytest.mark.parametrize("side_deg", [90, -120])
def test_beside_a_car_it_takes_its_side_and_stays_there(vehicle, side_deg):
    """The car drives north, so that the bearing from it is the side itself."""
    settings = modal(FollowMode.SIDE, side_deg=side_deg)
    flight = fly(vehicle(), drive(4.0, 3.0, 60.0), 30, servo_settings=settings)
    off = (flight.of("bearing_deg", 20) - side_deg + 180) % 360 - 180
    assert np.abs(off).max() < 8
    assert np.abs(flight.of("range", 20) / DISTANCE - 1).max() < 0.15
    assert np.abs(flight.of("azimuth_deg", 3)).max() < 8


@pytest.mark.slow
@vehicles
@pytest.mark.parametrize("speed", [3.0, -3.0])
def test_it_circles_a_standing_target_at_its_speed_and_distance(vehicle, speed):
    settings = modal(FollowMode.ORBIT, orbit_m_s=speed, hold_height=True)
    flight = fly(vehicle(), standing(15.0), 40, servo_settings=settings)
    rate = np.degrees(np.gradient(np.unwrap(np.radians(flight.bearing_deg)), flight.time))
    wanted = math.degrees(speed / math.sqrt(DISTANCE**2 - 36))
    assert np.median(rate[len(rate) // 2 :]) == pytest.approx(wanted, rel=0.2)
    assert np.abs(flight.of("range", 20) / DISTANCE - 1).max() < 0.12
    assert np.abs(flight.of("azimuth_deg", 5)).max() < 5


@pytest.mark.slow
def test_a_vehicle_that_flies_too_slowly_is_asked_for_more_until_it_circles_at_its_speed():
    settings = modal(FollowMode.ORBIT, orbit_m_s=4.0, hold_height=True)
    flight = fly(Px4(), standing(15.0), 60, servo_settings=settings)
    turned = np.unwrap(np.radians(flight.of("bearing_deg", 30)))
    speed = (turned[-1] - turned[0]) / 30 * math.sqrt(DISTANCE**2 - 36)
    assert speed == pytest.approx(4.0, rel=0.06)


@vehicles
def test_above_a_car_it_stays_above(vehicle):
    start = vehicle(height=12.0)
    flight = fly(start, drive(4.0, 8.0, 60.0), 30, servo_settings=modal(FollowMode.OVERHEAD))
    assert flight.of("beside", 18).max() < 1.5
    assert np.abs(flight.of("height", 18) / DISTANCE - 1).max() < 0.15


@vehicles
def test_far_below_the_wanted_height_it_stays_above_a_target_as_steadily(vehicle):
    held = modal(FollowMode.OVERHEAD, hold_height=True)
    flight = fly(vehicle(height=4.0), standing(3.0), 20, servo_settings=held)
    assert flight.of("beside", 12).max() < 0.5


@vehicles
def test_above_a_car_it_holds_its_height_if_that_is_wanted(vehicle):
    held = modal(FollowMode.OVERHEAD, hold_height=True)
    flight = fly(vehicle(height=12.0), drive(4.0, 8.0, 60.0), 15, servo_settings=held)
    assert all(setpoint.down_m_s == 0 for setpoint in flight.asked)
    assert flight.of("beside", 12).max() < 2.5


@vehicles
def test_a_change_of_mode_in_flight_begins_with_the_setpoint_that_was_flown(vehicle):
    """The law's answer may go anywhere from there, but not at once."""
    modes = (
        FollowMode.ORBIT,
        FollowMode.WATCH,
        FollowMode.SIDE,
        FollowMode.OVERHEAD,
        FollowMode.CHASE,
    )
    changes = {9.0 + 1.5 * i: mode for i, mode in enumerate(modes)}
    flight = fly(vehicle(), drive(5.0), 17, servo_settings=modal(FollowMode.CHASE), changes=changes)
    for time_s in changes:
        now = next(i for i, time in enumerate(flight.time) if time >= time_s)
        a, b = flight.flown[now - 1], flight.asked[now]
        assert a.forward_m_s > 1.0 or time_s > 10.0
        assert math.hypot(b.forward_m_s - a.forward_m_s, b.right_m_s - a.right_m_s) < 0.5
        assert abs(b.down_m_s - a.down_m_s) < 0.4
        assert abs(b.yaw_rate_rad_s - a.yaw_rate_rad_s) < 0.1
