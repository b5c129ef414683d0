"""Pictures of a calibration board, rendered through a known lens."""

import functools
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from follower.apps.calibrate.board import Board
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Image

Pose = tuple[float, float, float, float, float, float]
"""Where the board's middle is (right, down, ahead, metres), and how it is turned (about x, y, z in
degrees)."""
Render = Callable[[Board, CameraModel, Pose], Image]

_CELL_PX = 8


@functools.cache
def _rays(lens: CameraModel) -> npt.NDArray[np.float64]:
    x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    return lens.rays(np.stack([x, y], -1))


def _turn(angles_deg: tuple[float, ...]) -> npt.NDArray[np.float64]:
    turn = np.eye(3)
    for angle, axis in zip(np.radians(angles_deg), np.eye(3), strict=True):
        turn = turn @ np.asarray(cv2.Rodrigues(angle * axis)[0])
    return turn


def _render(board: Board, lens: CameraModel, pose: Pose) -> Image:
    """Return what the lens sees: each pixel's ray is cut with the board's plane."""
    scale = _CELL_PX * 9 // board.cells_a_square
    texture = board.cells().repeat(scale, 0).repeat(scale, 1).astype(np.float32)
    texture_px_m = board.cells_a_square * scale / board.square_m
    rays, middle, turn = _rays(lens), np.array(pose[:3]), _turn(pose[3:])
    normal = turn[:, 2]
    points = rays * (normal @ middle / (rays @ normal))[:, None] - middle
    on_board = points @ turn[:, :2] + np.array([board.across, board.down]) * board.square_m / 2
    where = (on_board * texture_px_m - 0.5).astype(np.float32)
    x, y = where.reshape(lens.height, lens.width, 2).transpose(2, 0, 1)
    pixel = pose[2] / lens.fx * texture_px_m
    smooth = cv2.GaussianBlur(texture, (0, 0), 0.35 * pixel)
    image = cv2.remap(
        smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=200.0
    )
    noise = np.random.default_rng(int(1e4 * abs(sum(pose)))).normal(0.0, 1.5, image.shape)
    grey = (image + noise).clip(0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)


@pytest.fixture(scope="session")
def render() -> Render:
    return _render


@pytest.fixture(scope="session")
def lens() -> CameraModel:
    """A wide lens whose picture bulges, and whose axis is beside the image's middle."""
    return CameraModel(640, 480, 455.0, 455.0, 327.0, 233.5, (-0.28, 0.09, 0.0006, -0.0009, 0.0))


@pytest.fixture(scope="session")
def poses() -> list[Pose]:
    """Return views as somebody waves a board about: everywhere, near and far, tilted."""
    rng = np.random.default_rng(1)
    places = [(x, y) for x in (-1.0, -0.35, 0.35, 1.0) for y in (-1.0, -0.3, 0.3, 1.0)]
    found: list[Pose] = []
    for x, y in places:
        ahead, tilt_x, tilt_y = rng.uniform(0.3, 0.45), *rng.uniform(-32, 32, 2)
        found.append((0.35 * x * ahead, 0.2 * y * ahead, ahead, tilt_x, tilt_y, 90 * x + 15 * y))
    return found


@pytest.fixture(scope="session", params=["charuco", "chessboard"])
def seen(
    request: pytest.FixtureRequest, lens: CameraModel, poses: list[Pose]
) -> tuple[Board, list[Image]]:
    """A board of each kind, and images of it."""
    board = Board(request.param)
    return board, [_render(board, lens, pose) for pose in poses]
