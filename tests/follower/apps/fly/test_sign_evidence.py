"""The sign test's judgement: mirrored, rotated and wrongly mounted cameras are found out."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower.apps.preflight.sign_estimator import (
    Reaction,
    Sign,
    SignEvidence,
    SignJudgement,
    gain_remark,
)
from follower.apps.preflight.sign_test import (
    diagnosis,
    intent,
    movers,
    progress,
    where,
)
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_control.vehicle.state import Attitude
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import CameraMount, rotation

PERIOD_S, SWING_RAD = 4.0, math.radians(17)
AS_IT_IS, MIRROR, FLIP = np.eye(3), np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])


def attitude(time_s: float, *moves: str) -> Attitude:
    """By hand: first one move, then the next, 8 s each, to and fro."""
    angles = {"roll": 0.0, "pitch": 0.0, "yaw": 1.0}
    move = moves[int(time_s / 8) % len(moves)]
    angles[move] += SWING_RAD * math.sin(2 * math.pi * time_s / PERIOD_S)
    return Attitude(angles["roll"], angles["pitch"], angles["yaw"], 0.0, 0.0, 0.0, time_s)


def times(seconds: float = 16.0) -> Iterator[float]:
    return iter(np.arange(0.0, seconds, 1 / 30))


def judged(
    said: CameraMount,
    true: CameraMount,
    image: Vector = AS_IT_IS,
    moves: tuple[str, ...] = ("yaw", "pitch"),
    target: tuple[float, float, float] = (0.05, 0.03, 1.0),
    scale: float = 1.0,
) -> SignJudgement:
    """Move a camera by hand before a standing target; `target` in the camera's frame at first.

    `image` is what is done to the picture, `scale` how much too large its angles are taken.
    """
    evidence = SignEvidence(said)
    start = attitude(0.0, *moves)
    still = _turn(start) @ true.camera_to_body @ np.array(target)
    for time_s in times():
        now = attitude(time_s, *moves)
        ray = image @ (true.camera_to_body.T @ _turn(now).T @ still)
        ray = np.array([scale * ray[0], scale * ray[1], ray[2]])
        evidence.add(time_s, ray / np.linalg.norm(ray), now)
    return evidence.judge()


def _turn(a: Attitude) -> Vector:
    return rotation(a.roll_rad, a.pitch_rad, a.yaw_rad)


def mount(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> CameraMount:
    return CameraMount(math.radians(roll), math.radians(pitch), math.radians(yaw))


@settings(max_examples=25)
@given(
    st.floats(-80, 10),
    st.sampled_from([0.0, 90.0, -90.0, 180.0]),
    st.floats(-0.2, 0.2),
    st.floats(-0.2, 0.2),
)
def test_a_camera_mounted_as_described_passes(
    pitch: float, roll: float, right: float, down: float
) -> None:
    described = mount(roll, pitch)
    moves = movers(described)
    result = judged(described, described, moves=moves, target=(right, down, 1.0))
    assert result.passed
    assert result.across.gain == pytest.approx(1.0, abs=0.05)
    assert result.down.gain == pytest.approx(1.0, abs=0.05)
    assert diagnosis(result) == ""


@pytest.mark.parametrize(
    ("true", "image", "words"),
    [
        (mount(), MIRROR, "mirrored left to right"),
        (mount(), FLIP, "up and down are exchanged"),
        (mount(yaw=180), AS_IT_IS, "camera.yaw_deg: 180"),
        (mount(roll=180), AS_IT_IS, "upside down"),
        (mount(roll=90), AS_IT_IS, "add 90 to camera.roll_deg"),
        (mount(roll=-90), AS_IT_IS, "subtract 90 from camera.roll_deg"),
        (mount(pitch=-25), MIRROR, "mirrored left to right"),
    ],
)
def test_what_is_wrong_with_the_camera_is_said(
    true: CameraMount, image: Vector, words: str
) -> None:
    said = mount(pitch=-25) if true.pitch_rad else mount()
    result = judged(said, true, image)
    assert result.is_wrong
    assert words in diagnosis(result)


@pytest.mark.parametrize("roll", [90.0, -90.0, 180.0])
def test_what_is_advised_mends_it(roll: float) -> None:
    """Adding what the diagnosis says to camera.roll_deg gives the true mount."""
    assert not judged(mount(), mount(roll=roll)).passed
    assert judged(mount(roll=roll), mount(roll=roll)).passed


def test_a_camera_that_looks_sideways_is_unclear_and_does_not_pass() -> None:
    result = judged(mount(), mount(yaw=90))
    assert not result.passed
    assert result.down.sign is Sign.UNCLEAR


def test_one_movement_alone_is_not_enough() -> None:
    result = judged(mount(), mount(), moves=("yaw",))
    assert result.signs == (Sign.RIGHT, Sign.WAITING)
    assert any("nose" in line for line in progress(result, mount()))


def test_a_camera_that_looks_down_is_rolled_and_pitched() -> None:
    down = mount(pitch=-90)
    assert movers(down) == ("roll", "pitch")
    assert movers(mount()) == ("yaw", "pitch")
    assert judged(down, down, moves=("roll", "pitch")).passed
    assert not judged(down, down, MIRROR, moves=("roll", "pitch")).passed


@pytest.mark.parametrize(("scale", "words"), [(0.6, "too narrow"), (1.6, "too wide"), (1.1, "")])
def test_a_wrong_field_of_view_shows_in_how_far_the_image_moves(scale: float, words: str) -> None:
    result = judged(mount(), mount(), scale=scale)
    assert result.passed
    assert words in gain_remark(result.across.gain)
    assert bool(gain_remark(result.across.gain)) == bool(words)


def test_a_target_that_is_carried_about_is_no_evidence_for_or_against() -> None:
    evidence = SignEvidence(mount())
    for time_s in times():
        x = 0.5 * math.sin(time_s)
        ray = np.array([x, 0.0, 1.0])
        still = Attitude(0, 0, 1, 0, 0, 0, time_s)
        evidence.add(time_s, ray / np.linalg.norm(ray), still)
    result = evidence.judge()
    assert result.signs == (Sign.WAITING, Sign.WAITING)
    assert result.attitude_stands
    assert any("not that vehicle's autopilot" in line for line in progress(result, mount()))


def test_pauses_and_disorder_are_left_out() -> None:
    evidence = SignEvidence(mount())
    for time_s in (0.0, 5.0, 3.0, 12.0, 11.0):
        turned = Attitude(0, 0, time_s, 0, 0, 0, time_s)
        evidence.add(time_s, np.array([0.0, 0.0, 1.0]), turned)
    assert evidence.judge().across.share == 0.0


@pytest.mark.parametrize(("factor", "sign"), [(-1.5, Sign.RIGHT), (1.5, Sign.REVERSED)])
def test_the_turn_asked_for_has_to_go_against_the_hand(factor: float, sign: Sign) -> None:
    reaction = Reaction()
    assert reaction.judge() is Sign.WAITING
    for time_s in times(8.0):
        yaw = 3.1 + SWING_RAD * math.sin(2 * math.pi * time_s / PERIOD_S)  # across +-pi
        wrapped = (yaw + math.pi) % (2 * math.pi) - math.pi
        reaction.add(time_s, wrapped, factor * (yaw - 3.1))
    assert reaction.judge() is sign


def test_words_for_every_way() -> None:
    right = VelocitySetpoint(1.0, 0.0, 0.5, math.radians(18))
    left = VelocitySetpoint(-1.0, 0.0, -0.5, math.radians(-18))
    assert intent(right) == ("would yaw RIGHT (clockwise) 18°/s, SINK 0.5 m/s, go FORWARD 1.0 m/s")
    assert intent(left) == ("would yaw LEFT (anticlockwise) 18°/s, CLIMB 0.5 m/s, BACK OFF 1.0 m/s")
    assert intent(VelocitySetpoint()) == "would stay as it is"


def test_where_names_the_side_and_the_height() -> None:
    from follower_vision.geometry.line_of_sight import LineOfSight

    sight = LineOfSight(math.radians(12), math.radians(-5))
    assert where(sight) == ("target 12° right of the nose, 5° below the horizon")
