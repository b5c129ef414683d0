"""How the camera turns, from images and from lines of sight alone."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import rotation
from follower_vision.images.camera_rotation import CornerFollower, fit_rotation
from follower_vision.images.frame import Frame

CAMERA = CameraModel.from_fov(320, 240, math.radians(70))
SMALL = st.floats(-0.05, 0.05)


def directions(count: int = 80, seed: int = 3) -> np.ndarray:
    pixels = np.random.default_rng(seed).uniform((0, 0), (320, 240), (count, 2))
    return CAMERA.rays(pixels)


def turned(rays: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """What a camera sees of the same things after it has turned by a rotation vector."""
    matrix, _ = cv2.Rodrigues(np.asarray(turn, np.float64))
    return rays @ matrix


@given(SMALL, SMALL, SMALL)
@settings(max_examples=40)
def test_a_pure_turn_is_found(right: float, down: float, forward: float) -> None:
    turn = np.array([right, down, forward])
    found = fit_rotation(directions(), turned(directions(), turn))
    assert found == pytest.approx(turn, abs=5e-5)


def test_what_moves_by_itself_does_not_count() -> None:
    rays, turn = directions(), np.array([0.01, -0.02, 0.005])
    seen = turned(rays, turn)
    seen[:20] = turned(rays[:20], np.array([0.0, 0.06, 0.0]))
    assert fit_rotation(rays, seen) == pytest.approx(turn, abs=1e-4)


def test_the_way_over_the_ground_is_told_from_a_turn_where_down_is_known() -> None:
    # A camera pitched down by 25 degrees, 10 m above flat ground, flies 0.3 m forward and turns.
    down = np.array([0.0, math.cos(0.44), math.sin(0.44)])
    forward = np.array([0.0, -math.sin(0.44), math.cos(0.44)])
    rays = directions(150)
    rays = rays[rays @ down > 0.1]
    ground = rays * (10.0 / (rays @ down))[:, None]
    after = ground - 0.3 * forward
    turn = np.array([0.004, 0.01, -0.003])
    seen = turned(after / np.linalg.norm(after, axis=1)[:, None], turn)
    assert fit_rotation(rays, seen, down) == pytest.approx(turn, abs=3e-4)
    assert np.abs(fit_rotation(rays, seen) - turn).max() > 3e-3


def looking(yaw: float, pitch: float, roll: float, texture: np.ndarray) -> np.ndarray:
    """Render a far textured wall as a turned camera sees it."""
    to_body = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turn = to_body.T @ rotation(roll, pitch, yaw) @ to_body
    wall = np.array([[300.0, 0, 400], [0, 300, 300], [0, 0, 1]])
    pixel_centres = CAMERA.matrix - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    to_wall = wall @ turn @ np.linalg.inv(pixel_centres)
    return cv2.warpPerspective(
        texture, to_wall, (320, 240), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    noise = np.random.default_rng(7).integers(0, 255, (75, 100, 3), dtype=np.uint8)
    return cv2.resize(noise, (800, 600), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize(
    ("axis", "yaw", "pitch", "roll"), [(1, 0.02, 0, 0), (0, 0, 0.015, 0), (2, 0, 0, 0.02)]
)
def test_signs_in_images(
    axis: int, yaw: float, pitch: float, roll: float, texture: np.ndarray
) -> None:
    follower = CornerFollower(CAMERA)
    assert follower.step(Frame(looking(0, 0, 0, texture), 1.0, 0)) is None
    flow = follower.step(Frame(looking(yaw, pitch, roll, texture), 1.1, 1))
    rates = flow.rates_rad_s()
    assert rates is not None
    wanted = np.zeros(3)
    wanted[axis] = (yaw + pitch + roll) / 0.1
    assert rates == pytest.approx(wanted, abs=0.01)


def test_where_nothing_is_seen_nothing_is_said() -> None:
    follower = CornerFollower(CAMERA)
    grey = np.full((240, 320, 3), 90, np.uint8)
    follower.step(Frame(grey, 0.0, 0))
    flow = follower.step(Frame(grey, 0.1, 1))
    assert flow.rates_rad_s() is None


def test_time_that_stands_still_is_refused(texture: np.ndarray) -> None:
    follower = CornerFollower(CAMERA)
    follower.step(Frame(looking(0, 0, 0, texture), 1.0, 0))
    with pytest.raises(ValueError, match="after the one before"):
        follower.step(Frame(looking(0, 0, 0, texture), 1.0, 1))
