"""`follower calibrate`: from a folder of images to settings that fly and track take."""

import io
import os
import re
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
from rich.console import Console, Group
from typer.testing import CliRunner

from follower.apps.calibrate import session
from follower.apps.calibrate.board import Board
from follower.apps.calibrate.views import ViewCollection
from follower.apps.main import app
from follower.settings.settings import CameraSettings, load_settings
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Frame, Image
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.open import ImageFolder

Pose = tuple[float, float, float, float, float, float]
Render = Callable[[Board, CameraModel, Pose], Image]


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["calibrate", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, " ".join(result.output.split())


def image_of(path: Path) -> Image:
    image = cv2.imread(str(path))
    assert image is not None
    return np.asarray(image, np.uint8)


@pytest.fixture(scope="module")
def photos(
    tmp_path_factory: pytest.TempPathFactory, lens: CameraModel, render: Render, poses: list[Pose]
) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for number, pose in enumerate(poses):
        cv2.imwrite(str(folder / f"{number:02}.png"), render(Board(), lens, pose))
    return folder


@pytest.mark.slow
def test_images_become_settings_and_a_picture(
    photos: Path, tmp_path: Path, lens: CameraModel
) -> None:
    known = tmp_path / "mine.yaml"
    known.write_text("camera: {pitch_deg: -30, fov_deg: 50}\nservo: {distance_m: 9}\n")
    out = tmp_path / "lens" / "wide.yaml"
    code, said = run(photos, "--out", out, "-c", known)
    assert code == 0
    assert "focal length 45" in said
    assert "px off over" in said
    assert "mount" not in out.read_text()
    settings = load_settings(out)
    assert (settings.camera.pitch_deg, settings.servo.distance_m) == (-30, 9)
    assert settings.camera.frame_size == (640, 480)
    found = settings.camera.model(640, 480)
    assert found.fx == pytest.approx(lens.fx, rel=0.01)
    assert (found.cx, found.cy) == pytest.approx((lens.cx, lens.cy), abs=2.5)
    half = settings.camera.model(320, 240)
    assert (half.fx, half.cx, half.cy) == pytest.approx((found.fx / 2, found.cx / 2, found.cy / 2))
    shown = image_of(out.with_suffix(".png"))
    assert shown.shape == (514, 1280, 3)
    assert np.ptp(shown[40:, :640]) > 100, "coverage"
    assert np.ptp(shown[40:, 640:]) > 100, "an undistorted image"
    if wanted := os.environ.get("FOLLOWER_PICTURES"):  # `docs/pictures`, for the guides
        coarse = (shown // 16 * 16 + 8).astype(np.uint8)  # without noise it is a sixth as large
        cv2.imwrite(str(Path(wanted) / "calibration.png"), coarse)


def test_a_camera_is_watched_until_there_are_views_enough(
    photos: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    keep_terminal: Callable[[Console, str, str], None],
) -> None:
    console = Console(record=True, width=100, file=io.StringIO())
    seen: list[Group] = []
    really_shown = session.shown

    def shown(views: ViewCollection, board_in_sight: bool) -> Group:
        seen.append(really_shown(views, board_in_sight))
        return seen[-1]

    monkeypatch.setattr(session, "shown", shown)
    monkeypatch.setattr(session, "is_live", lambda _: True)
    monkeypatch.setattr(session, "GOOD_VIEWS", 10)
    monkeypatch.setattr(session, "GOOD_COVERAGE", 0.6)
    code, said = run(photos, "--out", tmp_path / "camera.yaml", "--every-s", 0)
    assert code == 0
    looked = re.search(r"(\d+) images: (\d+) views kept", said)
    assert 10 <= int(looked[2]) <= int(looked[1]) < len(list(photos.iterdir())), "it ended early"
    assert "Ctrl-C ends it and computes the lens" in said
    console.print(seen[len(seen) // 2])
    assert "the board is in view; next: show it at the" in console.export_text(clear=False)
    keep_terminal(console, "follower calibrate 0", "calibrating")


class FallsSilent(ImageFolder):
    """A camera whose last picture is followed by a Ctrl-C instead of another one."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._closed = threading.Event()

    def read(self) -> Frame | None:
        frame = super().read()
        if frame is None:
            os.kill(os.getpid(), signal.SIGINT)
            assert self._closed.wait(30), "Ctrl-C leaves it waiting for a picture"
        return frame

    def close(self) -> None:
        self._closed.set()


@pytest.mark.slow
def test_ctrl_c_computes_the_lens_also_while_the_camera_is_silent(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "open_source", lambda *_, **__: FallsSilent(photos))
    monkeypatch.setattr(session, "is_live", lambda _: True)
    code, said = run("0", "--out", tmp_path / "camera.yaml", "--every-s", 0)
    assert code == 0
    assert "has the lens" in said


def test_what_is_there_is_not_overwritten(photos: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.png").write_text("mine")
    with pytest.raises(SettingsError, match=r"camera\.png exists already"):
        run(photos, "--out", tmp_path / "camera.yaml")


def test_the_settings_name_the_camera_where_the_command_does_not(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("camera: {source: /dev/video99}\n")
    with pytest.raises(SourceError, match="/dev/video99: there is no such device"):
        run("-c", mine, "--out", tmp_path / "camera.yaml")


def test_images_without_the_board_say_so(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), np.full((120, 160, 3), 90, np.uint8))
    code, said = run(tmp_path, "--out", tmp_path / "camera.yaml")
    assert code == 1
    assert "the board was never seen" in said
    assert not (tmp_path / "camera.yaml").exists()


def test_too_few_views_say_how_many_are_needed(photos: Path, tmp_path: Path) -> None:
    for name in ("00.png", "05.png", "10.png"):
        (tmp_path / name).write_bytes((photos / name).read_bytes())
    code, said = run(tmp_path, "--out", tmp_path / "camera.yaml")
    assert code == 1
    assert "3 different views of the board are too few: 8 are needed" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "which source"),
        (("clip.mp4", "--board", "board.pdf"), "give no source"),
        (("clip.mp4", "--kind", "circles"), "charuco or chessboard"),
        (("clip.mp4", "--squares", "7*10"), "write it like 7x10"),
        (("--kind", "chessboard", "--squares", "8x10", "--board", "b.pdf"), "which way up"),
        (("--board", "board.svg"), "pdf or .png"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    arguments: tuple[str, ...], words: str
) -> None:
    with pytest.raises(SettingsError, match=re.escape(words)):
        run(*arguments)


@pytest.mark.parametrize("kind", ["charuco", "chessboard"])
@pytest.mark.slow
def test_a_board_is_printed_to_scale(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "board.png"
    code, said = run("--board", path, "--kind", kind, "--square-mm", 18)
    assert code == 0
    assert "126 x 180 mm, squares of 18 mm, on A4" in said
    with PIL.Image.open(path) as page:
        dpi = page.info["dpi"][0]
        size_m = [side / dpi * 0.0254 for side in page.size]
    assert size_m == pytest.approx([0.210, 0.297], rel=1e-3)
    found = Board(kind, square_m=0.018).find(image_of(path))  # type: ignore[arg-type]
    sides_px = np.diff(found.image_px.reshape(9, 6, 2), axis=1)
    sides_m = np.hypot(*sides_px.reshape(-1, 2).T) / dpi * 0.0254
    assert sides_m == pytest.approx(0.018, rel=0.005)


def test_a_board_as_pdf_fills_its_paper(tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    code, said = run("--board", path)
    assert code == 0
    assert "175 x 250 mm, squares of 25 mm, on A4" in said
    pdf = path.read_bytes()
    assert b"DCTDecode" not in pdf, "no JPEG, which blurs edges"
    box = re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", pdf)
    size_m = [float(side) / 72 * 0.0254 for side in box.groups()]
    assert size_m == pytest.approx([0.210, 0.297], rel=1e-3)


@pytest.mark.slow
def test_a_board_larger_than_any_paper_gets_a_page_of_its_own(tmp_path: Path) -> None:
    code, said = run("--board", tmp_path / "wall.png", "--square-mm", 500)
    assert code == 0
    assert "3500 x 5000 mm, squares of 500 mm, on a page of its own" in said


def test_an_axis_outside_of_the_image_is_refused() -> None:
    with pytest.raises(ValueError, match="center_px lies in an image 640 px wide"):
        CameraSettings(center_px=(700.0, 200.0))
    assert CameraSettings(center_px=(300.0, 250.0)).model(640, 480).cx == 300.0
