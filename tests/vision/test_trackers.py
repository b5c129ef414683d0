"""Every tracker has a name, and OpenCV's stand behind the same seam as ours."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

import follower_vision
from follower_vision.fusion.candidates import corners_of
from follower_vision.geometry.box import Box
from follower_vision.models import ModelStore
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.correlation import CorrelationTracker
from follower_vision.trackers.motion_tracker import IdentityTracker, JoinedTracker, ResponseMap
from follower_vision.trackers.opencv import OPENCV_KINDS, opencv_tracker_names
from follower_vision.trackers.registry import make_tracker, tracker_names

WEIGHTS = Path(follower_vision.__file__).parent / "weights"
NETLESS = [name for name in opencv_tracker_names() if not OPENCV_KINDS[name].files]


def no_file(name: str) -> Path:
    raise AssertionError(f"{name} was asked for")


class StillSearch(IdentityTracker):
    """Answers that the target is where it is searched; writes its lessons down."""

    def __init__(self) -> None:
        super().__init__()
        self.learnt: list[tuple[Box, float]] = []

    def search(self, image: np.ndarray, box: Box) -> ResponseMap:  # noqa: ARG002
        one = np.ones(1)
        return ResponseMap(corners_of([box]), one, one, box.scaled(4))

    def learn(self, image: np.ndarray, box: Box, probability: float) -> None:  # noqa: ARG002
        self.learnt.append((box, probability))


def scene(cx: float, cy: float) -> np.ndarray:
    """A textured patch on a noisy ground."""
    ground = np.random.default_rng(5).integers(60, 120, (240, 320, 3), dtype=np.uint8)
    patch = np.random.default_rng(6).integers(0, 256, (5, 5, 3), dtype=np.uint8)
    x, y = round(cx - 20), round(cy - 20)
    ground[y : y + 40, x : x + 40] = cv2.resize(patch, (40, 40))
    return ground


def test_names_are_unique_and_ours_come_first() -> None:
    names = tracker_names()
    assert names[:4] == ["identity", "correlation", "siamese", "siamese-correlation"]
    assert len(set(names)) == len(names)
    assert "mil" in names


def test_unknown_name_tells_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"no tracker 'kalman'; there are identity, correlation"):
        make_tracker("kalman", no_file)


def test_one_that_this_opencv_lacks_says_where_it_is() -> None:
    missing = [name for name in OPENCV_KINDS if name not in opencv_tracker_names()]
    if not missing:
        pytest.skip("this OpenCV has every tracker")
    with pytest.raises(ValueError, match="opencv-contrib-python-headless"):
        make_tracker(missing[0], no_file)


@pytest.mark.parametrize("name", ["nanotrack-v3", "nano", "vit", "dasiamrpn"])
def test_missing_network_names_the_pull_command(tmp_path: Path, name: str) -> None:
    with pytest.raises(ModelError, match="follower models pull"):
        make_tracker(name, lambda file: tmp_path / file)


def test_a_joined_tracker_tells_both_places_and_puts_the_second_back() -> None:
    first, second = StillSearch(), CorrelationTracker()
    joined, alone = JoinedTracker(first, second), CorrelationTracker()
    here, there = Box(160, 120, 40, 40), Box(230, 160, 40, 40)
    for tracker in (joined, alone):
        tracker.start(scene(here.cx, here.cy), here)
    moved = scene(here.cx + 3, here.cy)
    answer = joined.search(moved, here)
    assert answer.second == alone.update(moved)
    assert answer.corners == pytest.approx(corners_of([here]))
    joined.learn(scene(there.cx, there.cy), there, 0.5)
    assert joined.search(moved, here).second.box.iou(there) == 0.0
    joined.learn(scene(there.cx, there.cy), there, 0.9)
    assert joined.search(scene(there.cx, there.cy), there).second.box.iou(there) > 0.8
    assert first.learnt == [(there, 0.5), (there, 0.9)]


@pytest.mark.parametrize("name", ["identity", *NETLESS])
def test_trackers_without_networks_hold_a_slow_target(name: str) -> None:
    tracker = make_tracker(name, no_file)
    assert tracker.name == name
    with pytest.raises(RuntimeError, match="not started"):
        tracker.update(scene(100, 100))
    tracker.start(scene(100, 100), Box(100, 100, 40, 40))
    for step in range(1, 4):
        estimate = tracker.update(scene(100 + 2 * step, 100 + step))
    assert estimate.box.iou(Box(106, 103, 40, 40)) > 0.5
    assert estimate.confidence in (0.0, 1.0)  # MOSSE gives up on so plain a patch


@pytest.mark.parametrize(
    "name", ["identity", "correlation", "re3", "siamese", "siamese-correlation"]
)
def test_it_has_to_be_started_and_begun_anew_it_is_like_a_new_one(
    name: str, tmp_path: Path
) -> None:
    used, new = (make_tracker(name, ModelStore(tmp_path / "nothing").file) for _ in range(2))
    for ask in ("update", "search"):
        if hasattr(new, ask):
            with pytest.raises(RuntimeError, match="not started"):
                getattr(new, ask)(scene(100, 100), *[Box(100, 100, 9, 9)][: ask == "search"])
    used.start(scene(160, 120), Box(160, 120, 40, 40))
    used.update(scene(163, 121))
    for one in (used, new):
        one.start(scene(100, 100), Box(100, 100, 40, 40))
    assert used.update(scene(102, 101)) == new.update(scene(102, 101))


@pytest.mark.parametrize("name", NETLESS)
def test_a_start_beyond_the_edge_is_cut_to_the_image(name: str) -> None:
    tracker = make_tracker(name, no_file)
    tracker.start(scene(60, 60), Box(5.4, 60.2, 40, 40))
    assert 0.0 <= tracker.update(scene(60, 60)).confidence <= 1.0


@pytest.mark.parametrize(
    "box", [Box(160, 120, 4, 4), Box(160, 120, 320, 60), Box(160, 120, 9, 900)]
)
def test_mil_refuses_boxes_on_which_opencv_would_never_end(box: Box) -> None:
    with pytest.raises(ValueError, match="mil tracker needs"):
        make_tracker("mil", no_file).start(scene(160, 120), box)


def test_a_network_that_opencv_cannot_load_is_told_before_any_target(tmp_path: Path) -> None:
    cut = (WEIGHTS / "follower-siamese_backbone.onnx").read_bytes()[:200_000]
    (tmp_path / "cut.onnx").write_bytes(cut)
    with pytest.raises(
        ModelError, match=r"OpenCV's nano tracker cannot load .*cut\.onnx"
    ) as raised:
        make_tracker("nano", lambda _: tmp_path / "cut.onnx")
    assert "follower models verify" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_opencv_loads_networks_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    """It warns of each that its engine takes no target, of which nobody has asked for one."""
    level = cv2.utils.logging.getLogLevel()
    tracker = make_tracker("nano", lambda _name: WEIGHTS / "follower-siamese_backbone.onnx")
    with suppress(ValueError):  # these are not its networks, which do not come along
        tracker.start(np.zeros((120, 160, 3), np.uint8), Box(40, 40, 20, 20))
    assert "setPreferableTarget" not in capfd.readouterr().err
    assert cv2.utils.logging.getLogLevel() == level
