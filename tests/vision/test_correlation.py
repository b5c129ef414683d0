"""The correlation tracker on generated images: physics and failures."""

import cv2
import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.correlation import CorrelationSettings, CorrelationTracker

RNG_SEED = 7


def texture(rng, height, width, grain=4):
    """Smooth random colours."""
    coarse = rng.integers(0, 256, (height // grain + 2, width // grain + 2, 3), dtype=np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


class Scene:
    """A textured patch that moves over a still textured background."""

    def __init__(self, seed=RNG_SEED, height=240, width=320, target=(40, 40)):
        rng = np.random.default_rng(seed)
        self.background = texture(rng, height, width, 12)
        self.patch = texture(rng, 2 * target[1], 2 * target[0])
        self.target = target

    def box(self, cx, cy, size=1.0):
        return Box(cx, cy, self.target[0] * size, self.target[1] * size)

    def image(self, cx, cy, size=1.0):
        """The scene with the patch's centre at (cx, cy), interpolated."""
        zoom = size / 2
        rows, columns = self.patch.shape[:2]
        # A pixel's centre is at +0.5, in the patch as in the image.
        matrix = np.array(
            [
                [zoom, 0, cx - zoom * columns / 2 + 0.5 * zoom - 0.5],
                [0, zoom, cy - zoom * rows / 2 + 0.5 * zoom - 0.5],
            ]
        )
        size_px = self.background.shape[1::-1]
        moved = cv2.warpAffine(self.patch, matrix, size_px, flags=cv2.INTER_AREA)
        mask = cv2.warpAffine(np.ones((rows, columns), np.float32), matrix, size_px)[..., None]
        return np.uint8(np.rint(moved * mask + self.background * (1 - mask)))


def follow(scene, path, sizes=None):
    """Start on the path's first point and return the last estimate."""
    sizes = sizes if sizes is not None else [1.0] * len(path)
    tracker = CorrelationTracker()
    tracker.start(scene.image(*path[0], sizes[0]), scene.box(*path[0], sizes[0]))
    for point, size in zip(path[1:], sizes[1:], strict=True):
        estimate = tracker.update(scene.image(*point, size))
    return estimate


@pytest.mark.parametrize("step", [(3.0, 0.0), (0.0, -3.0), (2.3, 1.7), (-0.4, 0.6)])
def test_translation_is_recovered_to_a_fraction_of_a_pixel(step):
    path = [(160 + step[0] * k, 120 + step[1] * k) for k in range(20)]
    box = follow(Scene(), path).box
    assert box.cx == pytest.approx(path[-1][0], abs=0.7)
    assert box.cy == pytest.approx(path[-1][1], abs=0.7)
    assert box.width == pytest.approx(40, rel=0.05)


@pytest.mark.parametrize("growth", [1.01, 1 / 1.01])
def test_a_change_of_size_is_recovered_within_a_few_percent(growth):
    sizes = growth ** np.arange(40)
    box = follow(Scene(), [(160, 120)] * 40, sizes).box
    assert box.width / 40 == pytest.approx(sizes[-1], rel=0.05)
    assert box.width / box.height == pytest.approx(1.0)


def test_a_still_target_keeps_its_box():
    box = follow(Scene(), [(160.3, 119.6)] * 10).box
    assert box.iou(Scene().box(160.3, 119.6)) > 0.95


def test_confidence_drops_when_the_target_vanishes():
    scene = Scene()
    tracker = CorrelationTracker()
    tracker.start(scene.image(160, 120), scene.box(160, 120))
    seen = [tracker.update(scene.image(160 + k, 120)).confidence for k in range(15)]
    gone = [tracker.update(scene.background).confidence for _ in range(15)]
    assert min(seen) > 2 * max(gone)
    assert all(0 <= value <= 1 for value in seen + gone)


def test_the_target_is_found_again_after_a_short_occlusion():
    scene = Scene()
    tracker = CorrelationTracker()
    tracker.start(scene.image(160, 120), scene.box(160, 120))
    for _ in range(5):
        tracker.update(scene.image(160, 120))
    for _ in range(8):
        tracker.update(scene.background)
    for _ in range(3):
        box = tracker.update(scene.image(165, 122)).box
    assert box.iou(scene.box(165, 122)) > 0.7


def test_update_before_start_is_an_error():
    with pytest.raises(RuntimeError, match="not started"):
        CorrelationTracker().update(np.zeros((10, 10, 3), np.uint8))


def test_the_same_images_give_the_same_boxes_bit_for_bit():
    path = [(160 + 2 * k, 120 - k) for k in range(8)]
    assert follow(Scene(), path) == follow(Scene(), path)


def test_start_forgets_everything_earlier():
    scene, other = Scene(), Scene(seed=8)
    used = CorrelationTracker()
    used.start(other.image(100, 100), other.box(100, 100))
    used.update(other.image(102, 100))
    fresh = CorrelationTracker()
    for tracker in (used, fresh):
        tracker.start(scene.image(160, 120), scene.box(160, 120))
    image = scene.image(163, 121)
    assert used.update(image) == fresh.update(image)


@pytest.mark.parametrize(
    "box",
    [
        Box(100, 80, 3, 3),
        Box(100, 80, 1, 60),
        Box(100, 80, 300, 2),
        Box(0, 0, 40, 40),
        Box(319, 239, 30, 30),
        Box(-50, -50, 20, 20),
        Box(500, 120, 40, 40),
        Box(160, 120, 900, 700),
    ],
)
def test_unusual_boxes_give_finite_boxes_with_a_confidence(box):
    scene = Scene()
    tracker = CorrelationTracker()
    tracker.start(scene.image(160, 120), box)
    for k in range(4):
        estimate = tracker.update(scene.image(160 + 3 * k, 120))
        assert estimate.box.scale > 0
        assert 0 <= estimate.confidence <= 1


@pytest.mark.parametrize("level", [0, 128, 255])
def test_uniform_images_give_finite_boxes_without_confidence(level):
    image = np.full((120, 160, 3), level, np.uint8)
    tracker = CorrelationTracker()
    tracker.start(image, Box(80, 60, 20, 20))
    for _ in range(3):
        estimate = tracker.update(image)
    assert estimate.confidence < 0.5
    assert estimate.box.distance(Box(80, 60, 20, 20)) < 20


def test_black_frames_mid_way_give_no_confidence():
    scene = Scene()
    tracker = CorrelationTracker()
    tracker.start(scene.image(160, 120), scene.box(160, 120))
    tracker.update(scene.image(161, 120))
    assert tracker.update(np.zeros_like(scene.background)).confidence < 0.2


def test_the_centre_of_a_target_that_leaves_stays_in_the_image():
    scene = Scene()
    tracker = CorrelationTracker()
    tracker.start(scene.image(280, 120), scene.box(280, 120))
    for k in range(20):
        box = tracker.update(scene.image(280 + 5 * k, 120)).box
        assert 0 <= box.cx <= 320
        assert 0 <= box.cy <= 240


def test_a_smaller_image_mid_way_is_taken_as_it_is():
    scene = Scene()
    tracker = CorrelationTracker()
    tracker.start(scene.image(160, 120), scene.box(160, 120))
    box = tracker.update(np.ascontiguousarray(scene.image(160, 120)[:100, :120])).box
    assert 0 <= box.cx <= 120
    assert 0 <= box.cy <= 100


def test_a_grey_target_is_followed_in_three_equal_channels():
    scene = Scene()
    grey = [
        cv2.cvtColor(cv2.cvtColor(scene.image(160 + 2 * k, 120), cv2.COLOR_BGR2GRAY), 8)
        for k in range(15)
    ]
    tracker = CorrelationTracker()
    tracker.start(grey[0], scene.box(160, 120))
    for image in grey[1:]:
        box = tracker.update(image).box
    assert box.cx == pytest.approx(188, abs=1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("patch_px", 201),
        ("patch_px", 16),
        ("cell_px", 1),
        ("gradient_channels", 32),
        ("colour_channels", 0),
        ("scale_count", 4),
        ("search_factor", 1.0),
        ("scale_step", 1.0),
        ("iterations", 0),
        ("label_sigma", 0.0),
        ("learning_rate", 1.5),
    ],
)
def test_nonsense_settings_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        CorrelationSettings(**{name: value})
