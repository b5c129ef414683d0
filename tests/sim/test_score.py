"""The pursuit score against flights whose figures follow from a closed form."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest

from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_sim.kinematics import BodyState, TruthSample
from follower_sim.scenario.scenario import Criteria
from follower_sim.scoring.criteria import checks, verdict
from follower_sim.scoring.score import (
    PursuitGoal,
    PursuitScore,
    PursuitStep,
    commanded_peaks,
    line_of_sight_errors,
    pursuit_score,
)
from follower_vision.geometry.line_of_sight import LineOfSight

GOAL = PursuitGoal(distance_m=15.0, elevation_rad=math.radians(-20))
RATE_HZ = 50


def times(duration_s: float) -> list[float]:
    return [n / RATE_HZ for n in range(round(duration_s * RATE_HZ) + 1)]


def sample(
    time_s: float,
    *,
    azimuth_deg: float = 0.0,
    elevation_deg: float = -20.0,
    range_m: float = 15.0,
    in_frame_share: float = 1.0,
    visible_share: float = 1.0,
) -> TruthSample:
    return TruthSample(
        time_s=time_s,
        vehicle=BodyState(time_s, (0.0, 0.0, -8.0)),
        target_position_m=(range_m, 0.0, 0.0),
        target_velocity_m_s=(0.0, 0.0, 0.0),
        in_frame_share=in_frame_share,
        visible_share=visible_share,
        range_m=range_m,
        azimuth_rad=math.radians(azimuth_deg),
        elevation_rad=math.radians(elevation_deg),
    )


def following(
    duration_s: float, setpoint: VelocitySetpoint | None = HOLD, state: str = "following"
) -> list[PursuitStep]:
    return [PursuitStep(t, state, setpoint) for t in times(duration_s)]


def states(*names: str) -> list[PursuitStep]:
    return [PursuitStep(0.02 * n, name, HOLD) for n, name in enumerate(names)]


def perfect() -> PursuitScore:
    return pursuit_score([sample(t) for t in times(10)], following(10), GOAL)


def test_a_perfect_pursuit_has_no_error_and_passes() -> None:
    score = perfect()
    assert score.in_frame_share == 1
    assert score.line_of_sight_rms_deg == pytest.approx(0, abs=1e-9)
    assert score.range_error_median == pytest.approx(0, abs=1e-12)
    assert (score.time_to_acquire_s, score.approach_s) == (0, 0)
    assert score.scored_s == pytest.approx(10)
    assert score.following_share == 1
    assert verdict(score, Criteria()) == []


@pytest.mark.parametrize("offset_deg", [-4.0, 0.5, 2.0])
def test_a_constant_elevation_offset_is_its_own_rms_and_p95(offset_deg: float) -> None:
    truth = [sample(t, elevation_deg=-20 + offset_deg) for t in times(5)]
    score = pursuit_score(truth, following(5), GOAL)
    assert score.line_of_sight_rms_deg == pytest.approx(abs(offset_deg))
    assert score.line_of_sight_p95_deg == pytest.approx(abs(offset_deg))


def test_the_boxes_middle_is_scored_beside_the_bodys_and_only_while_it_can_be_seen() -> None:
    truth = [sample(t, visible_share=1.0 if t < 6 else 0.4) for t in times(10)]

    def box_sight(one: TruthSample) -> LineOfSight:
        return LineOfSight(0.0, math.radians(-18.0 if one.visible_share == 1 else 20.0))

    score = pursuit_score(truth, following(10), GOAL, box_sight=box_sight)
    assert score.line_of_sight_rms_deg == pytest.approx(0, abs=1e-9)
    assert score.line_of_sight_box_rms_seen_deg == pytest.approx(2.0)
    assert perfect().line_of_sight_box_rms_seen_deg is None


def test_a_moment_beside_an_occlusion_does_not_stand_for_the_time_hidden() -> None:
    truth = [sample(t, visible_share=0.0 if 8 <= t < 12 else 1.0) for t in times(20)]

    def box_sight(one: TruthSample) -> LineOfSight:
        return LineOfSight(math.radians(5 if 12 <= one.time_s < 13 else 0), GOAL.elevation_rad)

    score = pursuit_score(truth, following(20), GOAL, box_sight=box_sight)
    expected_deg = 5 * math.cos(GOAL.elevation_rad) * math.sqrt(1 / 16)
    assert score.line_of_sight_box_rms_seen_deg == pytest.approx(expected_deg, rel=0.05)


def test_an_azimuth_offset_counts_less_the_higher_the_target_stands() -> None:
    goal = PursuitGoal(distance_m=15.0, elevation_rad=math.radians(-60))
    angle = line_of_sight_errors([sample(0, azimuth_deg=1, elevation_deg=-60)], goal)[0]
    assert math.degrees(angle) == pytest.approx(0.5, rel=1e-3)


def test_a_swinging_target_has_the_rms_of_a_sine() -> None:
    goal = PursuitGoal(distance_m=15.0)
    truth = [
        sample(t, azimuth_deg=3 * math.sin(2 * math.pi * t), elevation_deg=0)
        for t in times(20)[:-1]
    ]
    score = pursuit_score(truth, following(20), goal)
    assert score.line_of_sight_rms_deg == pytest.approx(3 / math.sqrt(2), rel=1e-3)
    # |sin| stays below sin(0.95 · 90 deg) for 95 % of the time.
    assert score.line_of_sight_p95_deg == pytest.approx(3 * math.sin(0.95 * math.pi / 2), rel=2e-2)


def test_range_error_is_relative_to_the_wanted_distance_either_way() -> None:
    truth = [sample(t, range_m=15 * (1.1 if t < 7 else 0.95)) for t in times(10)]
    score = pursuit_score(truth, following(10), GOAL)
    assert score.range_error_median == pytest.approx(0.1)
    assert score.range_error_p95 == pytest.approx(0.1)


def test_shares_are_weighted_with_time_not_with_samples() -> None:
    often = [n / 100 for n in range(600)]
    seldom = [6 + n / 10 for n in range(61)]
    truth = [sample(t, in_frame_share=1.0 if t < 6 else 0.2) for t in often + seldom]
    score = pursuit_score(truth, following(12), GOAL)
    assert score.in_frame_share == pytest.approx(0.5, abs=0.01)


def test_half_of_the_box_inside_is_in_frame() -> None:
    for share, in_frame in ((0.5, 1.0), (0.49, 0.0)):
        truth = [sample(t, in_frame_share=share) for t in times(3)]
        assert pursuit_score(truth, following(3), GOAL).in_frame_share == in_frame


def test_the_approach_is_over_when_range_and_direction_have_been_good_for_a_second() -> None:
    def range_m(t: float) -> float:
        # Good for half a second at 3 s, for good from 5 s on.
        return 15.0 if 3 <= t < 3.5 or t >= 5 else 40.0

    truth = [sample(t, range_m=range_m(t)) for t in times(10)]
    score = pursuit_score(truth, following(10), GOAL)
    assert score.approach_s == pytest.approx(5)
    assert score.scored_s == pytest.approx(5)
    assert score.range_error_p95 == pytest.approx(0, abs=1e-12)


def test_the_approach_begins_when_the_target_is_followed() -> None:
    steps = [PursuitStep(t, "tracking" if t < 4 else "following", HOLD) for t in times(10)]
    score = pursuit_score([sample(t) for t in times(10)], steps, GOAL)
    assert score.time_to_acquire_s == pytest.approx(4)
    assert score.approach_s == pytest.approx(0)
    assert score.scored_s == pytest.approx(6)


def test_time_to_acquire_counts_from_the_choice_of_the_target() -> None:
    names = {0: "idle", 2: "tracking", 5: "following"}
    steps = [
        PursuitStep(t, names[max(start for start in names if start <= t)], None) for t in times(10)
    ]
    truth = [sample(t) for t in times(10)]
    assert pursuit_score(truth, steps, GOAL).time_to_acquire_s == pytest.approx(3)
    asked = pursuit_score(truth, steps, GOAL, chosen_s=1.0)
    assert asked.time_to_acquire_s == pytest.approx(4)


def test_a_pursuit_that_only_watches_is_scored_without_range() -> None:
    truth = [sample(t, range_m=80) for t in times(5)]
    goal = dataclasses.replace(GOAL, distance_m=None)
    score = pursuit_score(truth, following(5), goal)
    assert score.range_error_median is None
    assert score.approach_s == 0
    assert verdict(score, Criteria()) == []


def test_what_comes_after_the_pursuits_end_is_not_scored() -> None:
    truth = [sample(t, in_frame_share=1.0 if t <= 6 else 0.0) for t in times(10)]
    steps = [PursuitStep(t, "following" if t <= 6 else "searching", HOLD) for t in times(10)]
    score = pursuit_score(truth, steps, GOAL, end_s=6.0)
    assert score.in_frame_share == 1
    assert score.losses == 0
    assert pursuit_score(truth, steps, GOAL).in_frame_share == pytest.approx(0.6, abs=0.01)


def test_a_target_never_followed_is_said_so_without_a_nan() -> None:
    score = pursuit_score([sample(t) for t in times(5)], following(5, None, "tracking"), GOAL)
    assert score.time_to_acquire_s is None
    assert score.in_frame_share is None
    assert score.scored_s == 0
    assert verdict(score, Criteria()) == ["The target was never followed"]


def test_a_pursuit_that_never_comes_near_fails_whatever_is_asked() -> None:
    score = pursuit_score([sample(t, range_m=60) for t in times(5)], following(5), GOAL)
    assert score.approach_s is None
    nothing = Criteria(**{field.name: None for field in dataclasses.fields(Criteria)})
    assert len(verdict(score, nothing)) == 1
    assert "approach" in verdict(score, nothing)[0].lower()


def test_a_flight_without_any_record_fails_and_does_not_crash() -> None:
    score = pursuit_score([], [], GOAL)
    assert verdict(score, Criteria()) == ["The target was never followed"]
    json.dumps(score.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("following", "coasting", "following"), (0, 0)),
        (("following", "coasting", "searching", "following"), (1, 1)),
        (("following", "searching", "searching", "holding", "following"), (1, 1)),
        (("following", "searching", "following", "coasting", "searching", "released"), (2, 1)),
        (("following", "holding", "following"), (0, 0)),
        (("idle", "tracking", "searching"), (0, 0)),
    ],
)
def test_losses_and_reacquisitions(names: tuple[str, ...], expected: tuple[int, int]) -> None:
    score = pursuit_score([], states(*names), GOAL)
    assert (score.losses, score.reacquisitions) == expected


def test_following_share_counts_from_the_first_following_step() -> None:
    score = pursuit_score(
        [], states("idle", "ready", "following", "coasting", "searching", "holding"), GOAL
    )
    assert score.following_share == pytest.approx(0.5)


def test_interventions_are_counted_over_the_sent_steps_alone() -> None:
    steps = [
        PursuitStep(0.00, "tracking", None, ("ceiling",)),
        PursuitStep(0.02, "following", HOLD, ("speed", "fence")),
        PursuitStep(0.04, "following", HOLD, ("speed",)),
        PursuitStep(0.06, "following", HOLD),
        PursuitStep(0.08, "following", HOLD),
    ]
    score = pursuit_score([], steps, GOAL)
    assert set(score.interventions) == {"speed", "fence"}
    assert (score.interventions["speed"].steps, score.interventions["speed"].share) == (2, 0.5)
    assert score.limited_share == 0.5


def test_delays_and_boxes_beside_the_target() -> None:
    delays = [0.050] * 98 + [0.200] * 2
    score = pursuit_score([], [], GOAL, delays_s=delays, overlaps=[0.8, 0.0, 0.1, 0.7])
    assert score.delay_median_s == pytest.approx(0.05)
    assert score.delay_p99_s == pytest.approx(0.2)
    assert score.wrong_box_share == 0.25


def test_a_ramp_has_its_slope_as_peak_acceleration_and_no_jerk() -> None:
    steps = [
        PursuitStep(t, "following", VelocitySetpoint(0.6 * t, 0.8 * t, -0.5 * t, 0.2 * t))
        for t in times(2)
    ]
    peaks = commanded_peaks(steps)
    assert peaks.horizontal_acceleration_m_s2 == pytest.approx(1.0)
    assert peaks.vertical_acceleration_m_s2 == pytest.approx(0.5)
    assert peaks.yaw_acceleration_deg_s2 == pytest.approx(math.degrees(0.2))
    assert peaks.horizontal_jerk_m_s3 == pytest.approx(0, abs=1e-9)


def test_a_parabola_has_constant_jerk() -> None:
    steps = [PursuitStep(t, "following", VelocitySetpoint(1.5 * t * t)) for t in times(1)]
    assert commanded_peaks(steps).horizontal_jerk_m_s3 == pytest.approx(3.0)


def test_setpoints_across_a_pause_in_sending_are_not_compared() -> None:
    steps = [
        PursuitStep(0.00, "following", VelocitySetpoint(5.0)),
        PursuitStep(0.02, "following", VelocitySetpoint(5.0)),
        PursuitStep(0.04, "released", None),
        PursuitStep(0.06, "following", HOLD),
    ]
    assert commanded_peaks(steps).horizontal_acceleration_m_s2 == 0


def test_engaging_at_the_vehicles_own_velocity_is_no_commanded_acceleration() -> None:
    names = ("ready", "following", "following", "released")
    speeds = (0.0, 0.4, 0.41, 0.41)
    steps = [
        PursuitStep(0.02 * n, name, VelocitySetpoint(speed))
        for n, (name, speed) in enumerate(zip(names, speeds, strict=True))
    ]
    assert commanded_peaks(steps).horizontal_acceleration_m_s2 == pytest.approx(0.5)
    assert commanded_peaks(steps[1:3]) == commanded_peaks(steps[:3])


def test_two_steps_at_the_same_time_do_not_divide_by_zero() -> None:
    steps = [PursuitStep(1.0, "following", VelocitySetpoint(v)) for v in (0.0, 5.0)]
    assert commanded_peaks(steps).horizontal_acceleration_m_s2 == 0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"in_frame_share": 0.98}, "in frame"),
        ({"line_of_sight_rms_deg": 3.5}, "RMS"),
        ({"range_error_median": 0.2}, "Range error"),
        ({"time_to_acquire_s": 60.0}, "acquire"),
        ({"approach_s": 31.0}, "Approach"),
        ({"wrong_box_share": 0.5}, "box"),
    ],
)
def test_each_broken_criterion_is_named_with_its_limit(change: dict[str, float], word: str) -> None:
    lines = verdict(dataclasses.replace(perfect(), **change), Criteria())
    assert len(lines) == 1
    assert word in lines[0]
    assert "wanted" in lines[0]


def test_losses_are_limited_only_if_asked() -> None:
    score = dataclasses.replace(perfect(), losses=2)
    assert verdict(score, Criteria()) == []
    assert len(verdict(score, Criteria(max_losses=1))) == 1


def test_a_figure_exactly_at_its_limit_passes() -> None:
    score = dataclasses.replace(perfect(), in_frame_share=0.99, line_of_sight_rms_deg=3.0)
    assert verdict(score, Criteria()) == []


def test_every_figure_of_the_score_is_in_the_table() -> None:
    table = checks(perfect(), Criteria())
    assert len({check.name for check in table}) == len(table) == 25
    assert [check.passed for check in table].count(True) == 5


def test_the_score_survives_json() -> None:
    score = perfect()
    assert json.loads(json.dumps(score.to_dict(), allow_nan=False)) == score.to_dict()


@pytest.mark.parametrize(
    "wrong",
    [
        {"min_in_frame_share": 99.0},
        {"max_wrong_box_share": 2.0},
        {"max_line_of_sight_rms_deg": -1.0},
        {"max_median_range_error": math.nan},
        {"max_acquire_s": math.inf},
    ],
)
def test_criteria_refuse_nonsense_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Criteria(**wrong)


@pytest.mark.parametrize("distance_m", [0.0, -1.0, math.nan, math.inf])
def test_a_goal_refuses_nonsense(distance_m: float) -> None:
    with pytest.raises(ValueError, match="distance"):
        PursuitGoal(distance_m=distance_m)
