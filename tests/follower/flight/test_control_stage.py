"""From a box in the image to a setpoint: signs, and what happens when something is missing."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from follower.flight.control.guidance import Guidance
from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.vehicle_health import GpsHealth, VehicleHealth
from follower.settings.live import SettingChange
from follower.settings.settings import Settings, load_settings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import (
    Attitude,
    GimbalState,
    LocalPosition,
    VehicleState,
    heading_velocity,
)
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState

WIDTH, HEIGHT, STEP_S = 640, 480, 0.02
DISTANCE_M, SIZE_M = 15.0, 2.0


def settings(*overrides: str) -> Settings:
    wanted = {"distance_m": DISTANCE_M, "target_size_m": SIZE_M}
    return load_settings(base={"camera": {"pitch_deg": -20}, "servo": wanted}, overrides=overrides)


class Bench:
    """A control stage with a vehicle that hovers, and a target that stands in the image."""

    def __init__(self, yaw_rad: float = 0.0, telemetry: bool = True, *overrides: str) -> None:
        self.log = FlightLog()
        resolved = settings(*overrides)
        self.wishes, self.replaced = 0, None
        self.camera = resolved.camera.model(WIDTH, HEIGHT)
        self.stage = ControlStage(resolved, self.camera, self.log, telemetry)
        self.yaw_rad = yaw_rad
        self.telemetry = telemetry
        self.now_s = 0.0
        self.vehicle = VehicleState(
            mode="GUIDED", obeys_setpoints=True, armed=True, landed=False, heartbeat_s=0.0
        )
        self.stale = self.hung = self.placed = False

    def box(self, right_px: float = 0.0, up_px: float = 0.0, nearness: float = 1.0) -> Box:
        side = nearness * self.camera.fx * SIZE_M / DISTANCE_M
        return Box(WIDTH / 2 + right_px, HEIGHT / 2 - up_px, side, side)

    def fly(
        self, box: Box | None, seconds: float, state: TrackState = TrackState.TRACKING
    ) -> ControlRecord:
        record = None
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            record = self.step(box, state)
        assert record is not None
        return record

    def step(self, box: Box | None, state: TrackState) -> ControlRecord:
        now = self.now_s
        noise = 0.0 if self.hung else 1e-6 * math.sin(now)
        attitude = Attitude(noise, 0.0, self.yaw_rad, 0.0, 0.0, 0.0, now - 0.01)
        north_m = 3.0 if self.placed else 3.0 + 1e-6 * math.sin(now)
        position = LocalPosition(north_m, 4.0, -10.0, 0.0, 0.0, 0.0, now - 0.01)
        if self.telemetry and not self.stale:
            self.vehicle = replace(
                self.vehicle, attitude=attitude, position=position, heartbeat_s=now
            )
        newest = None
        if box is not None:
            track = Track(box, state, 0.9, "test", now - 0.04, round(now / STEP_S))
            seen = track.sequence, now - 0.04, now, now, 0.001
            newest = TrackRecord(track, *seen, self.wishes, None, self.replaced)
        return self.stage.step(now, newest, self.vehicle, [attitude] if self.telemetry else [])


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("yaw_deg", [0.0, 60.0, 179.9, -120.0])
@pytest.mark.parametrize(
    ("seen", "name", "least"),
    [
        ({"right_px": 80}, "yaw_rate_rad_s", 0.05),
        ({"right_px": -80}, "yaw_rate_rad_s", -0.05),
        ({"up_px": 60}, "down_m_s", -0.1),
        ({"up_px": -60}, "down_m_s", 0.1),
        ({"nearness": 0.6}, "forward_m_s", 0.3),
        ({"nearness": 1.6}, "forward_m_s", -0.2),
    ],
)
def test_it_turns_climbs_and_flies_towards_where_the_target_is_wanted(
    yaw_deg: float, seen: dict[str, float], name: str, least: float
) -> None:
    bench = Bench(math.radians(yaw_deg))
    value = getattr(bench.fly(bench.box(**seen), 1.0).allowed, name)
    assert value / least > 1.0


def test_a_target_where_it_is_wanted_is_left_alone(bench: Bench) -> None:
    allowed = bench.fly(bench.box(), 3.0).allowed
    assert allowed.forward_m_s == pytest.approx(0.0, abs=0.05)
    assert allowed.down_m_s == pytest.approx(0.0, abs=0.05)
    assert allowed.yaw_rate_rad_s == pytest.approx(0.0, abs=0.01)


def test_the_same_signs_hold_without_telemetry() -> None:
    bench = Bench(telemetry=False)
    bench.vehicle = replace(bench.vehicle, heartbeat_s=1.0)
    assert bench.fly(bench.box(right_px=80), 1.0).allowed.yaw_rate_rad_s > 0.05


def test_an_unseen_target_is_coasted_held_and_let_go(bench: Bench) -> None:
    bench.fly(bench.box(right_px=80), 1.0)
    states = []
    for _ in range(20):
        record = bench.fly(bench.box(), 1.0, TrackState.LOST)
        if not states or states[-1] is not record.state:
            states.append(record.state)
        if record.state in (SupervisorState.HOLDING, SupervisorState.RELEASED):
            assert record.asked == HOLD
    assert states == [SupervisorState.SEARCHING, SupervisorState.HOLDING, SupervisorState.RELEASED]
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)


def test_stale_telemetry_holds_and_good_telemetry_goes_on(bench: Bench) -> None:
    bench.fly(bench.box(right_px=80), 1.0)
    bench.stale = True
    bench.vehicle = replace(bench.vehicle, heartbeat_s=100.0)
    assert bench.fly(bench.box(right_px=80), 0.7).reason is SupervisorReason.TELEMETRY_STALE
    bench.stale = False
    assert bench.fly(bench.box(right_px=80), 0.2).state is SupervisorState.FOLLOWING


def test_an_attitude_that_repeats_itself_is_stale_though_its_time_goes_on(bench: Bench) -> None:
    bench.fly(bench.box(right_px=80), 1.0)
    bench.hung = True
    record = bench.fly(bench.box(right_px=80), 0.7)
    assert (record.state, record.reason) == (
        SupervisorState.HOLDING,
        SupervisorReason.TELEMETRY_STALE,
    )
    assert record.asked is HOLD
    bench.hung = False
    assert bench.fly(bench.box(right_px=80), 0.2).state is SupervisorState.FOLLOWING


def test_a_target_chosen_anew_renews_consent_but_not_by_a_frame_from_before(bench: Bench) -> None:
    bench.fly(bench.box(), 1.0)
    bench.vehicle = replace(bench.vehicle, obeys_setpoints=False, mode="LOITER")
    assert bench.fly(bench.box(), STEP_S).state is SupervisorState.RELEASED
    bench.vehicle = replace(bench.vehicle, obeys_setpoints=True, mode="GUIDED")
    bench.wishes += 1  # the frame is 0.04 s old: it showed what was seen before the release
    assert bench.fly(bench.box(), 0.5).state is SupervisorState.RELEASED
    bench.wishes += 1
    assert bench.fly(bench.box(), 0.5).state is SupervisorState.FOLLOWING


def test_another_target_that_a_program_chose_is_kept_at_its_own_size_and_renews_no_consent() -> (
    None
):
    bench = Bench(0.0, True, "servo.target_size_m=null")
    bench.fly(bench.box(), 3.0)
    bench.replaced = 1
    smaller = bench.box(right_px=40, nearness=0.4)
    after = bench.fly(smaller, 2.0)
    assert after.state is SupervisorState.FOLLOWING
    assert after.allowed.forward_m_s == pytest.approx(0.0, abs=0.05)
    bench.vehicle = replace(bench.vehicle, obeys_setpoints=False, mode="LOITER")
    assert bench.fly(smaller, STEP_S).state is SupervisorState.RELEASED
    bench.vehicle = replace(bench.vehicle, obeys_setpoints=True, mode="GUIDED")
    bench.replaced = 2
    assert bench.fly(bench.box(), 2.0).state is SupervisorState.RELEASED


def test_a_vehicle_that_brakes_goes_on_braking_when_it_gets_ready_meanwhile() -> None:
    bench = Bench(0.0, True, "consent.kind=command")
    bench.stage.order(ConsentRequest.GIVE)
    fast = bench.fly(bench.box(nearness=0.4), 1.5)
    assert fast.allowed.forward_m_s > 1.0
    bench.stage.request_stop()
    assert bench.fly(bench.box(), 0.1).state is SupervisorState.RELEASED
    bench.stage.order(ConsentRequest.RENEW)
    speeds = [bench.log.controls[-1].allowed.forward_m_s]
    for _ in range(100):
        record = bench.fly(bench.box(), STEP_S)
        assert (record.state, record.reason) == (
            SupervisorState.READY,
            SupervisorReason.WAITING_FOR_CONSENT,
        )
        speeds.append(record.allowed.forward_m_s)
    changes = [abs(after - before) for before, after in itertools.pairwise(speeds)]
    assert max(changes) <= bench.stage.settings.envelope.max_acceleration_m_s2 * STEP_S + 1e-9
    assert speeds[-1] == pytest.approx(0.0, abs=1e-9)


def test_following_that_begins_anew_while_it_brakes_keeps_the_jerk_and_the_lowered_speed(
    bench: Bench,
) -> None:
    bench.fly(bench.box(nearness=0.2), 3.0)
    bench.stage.request_stop()
    bench.fly(bench.box(nearness=0.2), 0.4)
    bench.stage.repeat_changes([SettingChange.of("envelope.max_speed_m_s", 5.0)])
    bench.fly(bench.box(nearness=0.2), STEP_S)
    bench.stage.order(ConsentRequest.GIVE)
    assert bench.fly(bench.box(nearness=0.2), 0.1).state is SupervisorState.FOLLOWING
    speeds = [record.allowed.forward_m_s for record in bench.log.controls[-30:]]
    assert min(speeds) > 5.0
    accelerations = np.diff(speeds) / STEP_S
    envelope = bench.stage.settings.envelope
    assert np.abs(accelerations).max() <= envelope.max_acceleration_m_s2 + 1e-6
    assert np.abs(np.diff(accelerations)).max() <= envelope.max_jerk_m_s3 * STEP_S + 1e-6


def test_a_place_that_stays_the_same_though_the_vehicle_is_sent_away_is_stale(bench: Bench) -> None:
    bench.placed = True
    record = bench.fly(bench.box(nearness=0.4), 1.0)
    assert (record.state, record.allowed.forward_m_s > 0.5) == (SupervisorState.FOLLOWING, True)
    record = bench.fly(bench.box(nearness=0.4), 2.0)
    assert (record.state, record.reason) == (
        SupervisorState.HOLDING,
        SupervisorReason.TELEMETRY_STALE,
    )
    assert bench.fly(bench.box(nearness=0.4), 9.0).state is SupervisorState.RELEASED


@pytest.mark.parametrize("order", [ConsentRequest.GIVE, ConsentRequest.RENEW])
def test_a_stop_outdoes_the_consent_that_came_in_the_same_moment(
    bench: Bench, order: ConsentRequest
) -> None:
    """As Ctrl-C does that of a page."""
    bench.fly(bench.box(), 1.0)
    bench.stage.order(order)
    bench.stage.request_stop()
    bench.stage.order(order)
    record = bench.fly(bench.box(), 0.5)
    assert (record.state, record.reason) == (
        SupervisorState.RELEASED,
        SupervisorReason.STOP_REQUESTED,
    )
    bench.stage.order(order)
    assert bench.fly(bench.box(), 0.1).state is SupervisorState.FOLLOWING


def test_a_single_absurd_velocity_of_telemetry_does_not_lead_away(bench: Bench) -> None:
    """The way that the vehicle went is added up from its velocities."""
    bench.fly(bench.box(), 1.0)
    absurd = LocalPosition(3.0, 4.0, -10.0, 1e30, 0.0, 0.0, bench.now_s)
    bench.stale, bench.vehicle = True, replace(bench.vehicle, position=absurd)
    bench.fly(bench.box(), STEP_S)
    bench.stale = False
    record = bench.fly(bench.box(), 3.0)
    assert record.state is SupervisorState.FOLLOWING
    assert record.allowed.values == pytest.approx(HOLD.values, abs=0.05)


def test_a_stalled_control_loop_holds_once_and_goes_on(bench: Bench) -> None:
    bench.fly(bench.box(), 1.0)
    bench.now_s += 0.5
    assert bench.fly(bench.box(), STEP_S).reason is SupervisorReason.CONTROL_LATE
    assert bench.fly(bench.box(), 0.1).state is SupervisorState.FOLLOWING


def test_without_telemetry_a_stall_does_not_end_the_stream_for_good() -> None:
    """No attitude tells then that what waited for us has been heard: after seconds it has been.

    A stall lets go, and zeros go on, for silence would send PX4 home.
    """
    bench = Bench(telemetry=False)

    def flown(seconds: float) -> ControlRecord:
        for _ in range(round(seconds / STEP_S)):
            bench.vehicle = replace(bench.vehicle, mode="OFFBOARD", heartbeat_s=bench.now_s)
            record = bench.fly(bench.box(), STEP_S)
        return record

    assert flown(1.0).sent
    bench.now_s += 2.0
    assert not flown(STEP_S).sent
    later = flown(2.5)
    assert later.sent
    assert later.allowed == HOLD


def test_following_begins_at_the_vehicles_own_speed() -> None:
    bench = Bench(yaw_rad=math.pi / 2)
    bench.stage.step(0.0, None, bench.vehicle)
    moving = LocalPosition(0.0, 0.0, -10.0, 0.0, 4.0, 0.0, 0.0)
    attitude = Attitude(0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0, 0.0)
    present = heading_velocity(replace(bench.vehicle, attitude=attitude, position=moving))
    assert present.forward_m_s == pytest.approx(4.0)
    assert present.right_m_s == pytest.approx(0.0, abs=1e-12)
    assert heading_velocity(VehicleState()) == VelocitySetpoint()


def test_a_vehicle_that_is_not_well_is_not_followed_with_and_its_health_is_recorded(
    bench: Bench,
) -> None:
    health = VehicleHealth(gps=GpsHealth(1, 3, 5.0, 1.0))
    assert bench.fly(bench.box(), 1.0).state is SupervisorState.FOLLOWING
    record = bench.stage.step(bench.now_s, None, bench.vehicle, (), 0.0, health)
    assert (record.state, record.reason) == (
        SupervisorState.HOLDING,
        SupervisorReason.NAVIGATION_POOR,
    )
    assert record.health == health
    again = bench.stage.step(bench.now_s + STEP_S, None, bench.vehicle, (), 0.0, health)
    assert again.health is None  # nothing new, nothing to record


def test_a_change_of_mode_is_in_the_record_and_begins_where_it_flew(bench: Bench) -> None:
    before = bench.fly(bench.box(nearness=0.7), 2.0)
    watch = SettingChange.of("servo.mode", "watch")
    bench.stage.repeat_changes([watch])
    record = bench.fly(bench.box(nearness=0.7), STEP_S)
    assert record.changes == (watch,)
    assert record.allowed.forward_m_s == pytest.approx(before.allowed.forward_m_s, abs=0.1)
    later = bench.fly(bench.box(nearness=0.7), 3.0)
    assert later.changes == ()
    assert later.allowed.forward_m_s == pytest.approx(0.0, abs=0.05)


def test_following_goes_on_from_what_is_sent_and_only_from_a_hold_from_the_own_velocity() -> None:
    """A hold beside a target backs off; whatever was sent, the next setpoint is no step from it."""
    drifting = VehicleState(
        attitude=Attitude(0, 0, 0, 0, 0, 0, 0),
        position=LocalPosition(0, 0, -10, 1.5, 0.5, 0.2, 0),
    )
    guidance = Guidance(settings())
    guidance.begin(drifting, 0.0)
    first = guidance.step(SupervisorState.HOLDING, 0.0, None, drifting, 0.0).allowed
    assert first.forward_m_s == pytest.approx(1.5)
    sent = guidance.step(SupervisorState.HOLDING, 0.1, None, drifting, 0.0).allowed
    stopped = replace(drifting, position=LocalPosition(0, 0, -10, 0, 0, 0, 0.1))
    guidance.begin(stopped, 0.1)
    assert guidance.step(SupervisorState.HOLDING, 0.1, None, stopped, 0.0).allowed == sent


def test_in_a_search_the_gimbal_turns_with_the_vehicle() -> None:
    """It is told rates against the world: without one the vehicle would turn under its camera."""
    bench = Bench(0.0, True, "gimbal.enabled=true", "servo.elevation_deg=-20")
    turned = 0.0
    for state in (TrackState.TRACKING,) * 50 + (TrackState.LOST,) * 400:
        bench.now_s += STEP_S
        held = Attitude(0.0, math.radians(-20), 0.0, 0.0, 0.0, 0.0, bench.now_s)
        bench.vehicle = replace(bench.vehicle, gimbal=GimbalState(held))
        record = bench.step(bench.box(), state)
        if record.state is SupervisorState.SEARCHING and record.estimate is None:
            assert record.gimbal.yaw_rad_s == record.allowed.yaw_rate_rad_s
            turned = max(turned, abs(record.gimbal.yaw_rad_s))
    assert turned > math.radians(5)
