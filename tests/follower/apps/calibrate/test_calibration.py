"""A lens is found from pictures of a board, or the reason why not is told."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from follower.apps.calibrate.board import Board, SeenBoard
from follower.apps.calibrate.session import advice, counts_line, is_enough
from follower.apps.calibrate.solve import CalibrationError, Coverage, _warnings, calibrate
from follower.apps.calibrate.views import MOST_VIEWS, BoardView, ViewCollection, blur_px, pose_of
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Image

Pose = tuple[float, float, float, float, float, float]
Render = Callable[[Board, CameraModel, Pose], Image]
SIZE = (640, 480)


def collected(board: Board, images: Iterable[Image]) -> ViewCollection:
    views = ViewCollection(board)
    for image in images:
        views.add(image)
    return views


def made_up(lens: CameraModel, poses: Iterable[Pose], noise_px: float = 0.05) -> list[BoardView]:
    """Return views without pixels: corners as the lens projects them, with noise."""
    board, rng = Board(), np.random.default_rng(4)
    views = []
    for number, (x, y, ahead, *angles_deg) in enumerate(poses):
        turn = np.asarray(cv2.Rodrigues(np.radians(angles_deg))[0])
        points = (board.grid_m - board.grid_m.mean(0)) @ turn.T + (x, y, ahead)
        image_px = (lens.pixels(points) + rng.normal(0, noise_px, (54, 2))).astype(np.float32)
        seen = SeenBoard(board.grid_m, image_px, np.arange(54))
        views.append(BoardView(seen, number, pose_of(seen, SIZE)))
    return views


@pytest.mark.slow
def test_a_known_lens_is_found_again(seen: tuple[Board, list[Image]], lens: CameraModel) -> None:
    views = collected(*seen)
    assert views.size == SIZE
    found = calibrate(views.views, views.size)
    assert found.lens.fx == pytest.approx(lens.fx, rel=0.01)
    assert (found.lens.cx, found.lens.cy) == pytest.approx((lens.cx, lens.cy), abs=2.5)
    assert found.error_px < 0.3
    pixels = np.stack(np.meshgrid(np.linspace(60, 580, 9), np.linspace(45, 435, 7)), -1)
    angle = np.arccos((found.lens.rays(pixels) * lens.rays(pixels)).sum(1).clip(-1, 1))
    assert np.degrees(angle).max() < 0.35, "lines of sight over the image, distortion and all"


def test_corners_are_where_the_lens_shows_them(lens: CameraModel, render: Render) -> None:
    pose = (0.02, -0.01, 0.36, 20.0, -15.0, 0.0)
    for kind in ("charuco", "chessboard"):
        board = Board(kind)
        found = board.find(render(board, lens, pose))
        turn = np.asarray(cv2.Rodrigues(np.array([np.radians(20.0), 0, 0]))[0]) @ np.asarray(
            cv2.Rodrigues(np.array([0, np.radians(-15.0), 0]))[0]
        )
        middle = np.array([board.across, board.down, 0]) * board.square_m / 2
        true = lens.pixels((found.board_m - middle) @ turn.T + pose[:3])
        turned = lens.pixels((middle - found.board_m) @ turn.T + pose[:3])
        best = min(np.abs(found.image_px - one).mean() for one in (true, turned))
        assert best < 0.1, kind


def test_a_part_of_a_charuco_board_is_enough_and_a_chessboard_has_to_be_whole(
    lens: CameraModel, render: Render
) -> None:
    pose = (-0.25, 0.0, 0.3, 0.0, 10.0, 0.0)
    part = Board("charuco").find(render(Board("charuco"), lens, pose))
    assert 8 <= len(part.ids) < Board("charuco").corners
    assert Board("chessboard").find(render(Board("chessboard"), lens, pose)) is None


def test_a_blurred_view_is_measured_and_left_out(lens: CameraModel, render: Render) -> None:
    board, pose = Board("chessboard"), (0.0, 0.0, 0.34, 12.0, 8.0, 0.0)
    sharp = render(board, lens, pose)
    soft = np.asarray(cv2.GaussianBlur(sharp, (0, 0), 2.5), np.uint8)
    seen, seen_soft = board.find(sharp), board.find(soft)
    assert seen is not None
    assert seen_soft is not None
    assert blur_px(board, seen, sharp) < 4 < 5 < blur_px(board, seen_soft, soft)
    views = collected(board, [soft, soft])
    assert (views.blurred, len(views.views)) == (2, 0)


def test_the_same_view_again_is_not_kept(lens: CameraModel, render: Render) -> None:
    board = Board()
    images = [render(board, lens, (0.001 * n, 0, 0.35, 10, 5 + 0.3 * n, 0)) for n in range(4)]
    views = collected(board, [*images, np.full((480, 640, 3), 90, np.uint8)])
    assert (len(views.views), views.known, views.without_board) == (1, 3, 1)
    assert "1 views kept, 3 like one of these, 0 blurred, 1 without the board" in counts_line(views)
    with pytest.raises(CalibrationError, match="1 different views of the board are too few: 8 are"):
        calibrate(views.views, SIZE)


@pytest.mark.slow
def test_of_many_views_those_are_taken_that_differ_most_not_the_first(
    lens: CameraModel, render: Render, poses: list[Pose], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A video that begins with the board in one corner shows it elsewhere later."""
    monkeypatch.setattr("follower.apps.calibrate.views.MOST_VIEWS", 11)
    tilts = [(x, y) for x in (-30, 0, 30) for y in (-30, -15, 15, 30)]
    corner: list[Pose] = [(-0.15, -0.1, 0.5, *tilt, 0.0) for tilt in tilts]
    views = collected(Board(), (render(Board(), lens, pose) for pose in (*corner, *poses)))
    found = calibrate(views.views, SIZE)
    assert len(found.views) + len(found.dropped) == 11
    assert found.lens.fx == pytest.approx(lens.fx, rel=0.01)


def test_images_of_another_size_are_refused() -> None:
    views = collected(Board(), [np.full((480, 640, 3), 90, np.uint8)])
    with pytest.raises(ValueError, match=r"image 2 has 320 x 240 pixels, .* it 640 x 480: a"):
        views.add(np.full((240, 320, 3), 90, np.uint8))


def test_a_board_that_is_never_tilted_tells_no_focal_length(lens: CameraModel) -> None:
    flat = [(x, y, 0.35, 0.0, 0.0, 0.0) for x in (-0.09, 0, 0.09) for y in (-0.05, 0, 0.05)]
    with pytest.raises(CalibrationError, match=r"always faces the camera the same way.*tilt it"):
        calibrate(made_up(lens, flat), SIZE)


def test_a_board_in_one_corner_alone_is_refused_by_its_place(lens: CameraModel) -> None:
    tilts = [(30, 0), (-30, 0), (0, 30), (0, -30), (20, 20), (-20, 20), (20, -20), (-20, -20)]
    corner = [(-0.35, -0.22, 0.9, *tilt, 0.0) for tilt in tilts]
    with pytest.raises(CalibrationError, match=r"of the image only.*bottom right"):
        calibrate(made_up(lens, corner), SIZE)


def test_a_view_that_does_not_fit_is_dropped(lens: CameraModel, poses: list[Pose]) -> None:
    views = made_up(lens, poses)
    bent = views[5].seen.image_px + np.random.default_rng(0).normal(0, 4, (54, 2))
    views[5] = replace(views[5], seen=replace(views[5].seen, image_px=bent.astype(np.float32)))
    found = calibrate(views, SIZE)
    assert found.dropped == (5,)
    assert 5 not in [view.number for view in found.views]
    assert found.lens.fx == pytest.approx(lens.fx, rel=0.005)


def test_views_that_do_not_agree_are_refused(lens: CameraModel, poses: list[Pose]) -> None:
    with pytest.raises(CalibrationError, match=r"px from where they should be|is the board flat"):
        calibrate(made_up(lens, poses, noise_px=4.0), SIZE)


def test_coverage_names_what_is_missing(lens: CameraModel, poses: list[Pose]) -> None:
    views = made_up(lens, [(-0.12, -0.07, 0.4, 0.0, 0.0, 0.0)])
    coverage = Coverage(views, SIZE)
    assert 0 < coverage.share < 0.5
    assert "top left" not in coverage.missing()
    assert "bottom right" in coverage.missing()
    assert Coverage(made_up(lens, poses), SIZE).share > 0.6


def test_gaps_that_are_spread_over_the_image_are_warned_of_too(
    lens: CameraModel, poses: list[Pose]
) -> None:
    found = calibrate(made_up(lens, poses), SIZE)
    coverage = Coverage((), SIZE)
    coverage.counts[:] = 9 * (np.indices(coverage.counts.shape).sum(0) % 2)  # as a chessboard
    assert coverage.missing() == []
    (warning,) = _warnings(found, coverage)
    assert warning == "the board was in 50% of the image: the distortion is a guess elsewhere"


def test_what_is_shown_next_follows_from_what_is_missing(
    lens: CameraModel, poses: list[Pose]
) -> None:
    views = ViewCollection(Board())
    assert advice(views) == "show the board to the camera"
    views.size = SIZE
    views.views = made_up(lens, [(-0.12, -0.07, 0.4, 0.0, 0.0, 0.0)])
    assert advice(views).startswith("show it at the ")
    everywhere = [(x, y, 0.3, 0.0, 0.0, 0.0) for x in (-0.12, 0, 0.12) for y in (-0.05, 0, 0.05)]
    views.views = made_up(lens, everywhere)
    assert advice(views).startswith("tilt it")
    views.views = made_up(lens, [*everywhere, *poses])
    assert advice(views) == ""
    assert is_enough(views)
    views.views = views.views[:1] * MOST_VIEWS
    assert is_enough(views)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"across": 2}, "3 x 3 squares"),
        ({"square_m": 0.0}, "between 1 and 1000 mm"),
        ({"across": 20, "down": 20}, "fewer squares"),
        ({"kind": "chessboard", "across": 8, "down": 10}, "which way up"),
    ],
)
def test_a_board_that_cannot_be_is_refused(asked: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Board(**asked)  # type: ignore[arg-type]
