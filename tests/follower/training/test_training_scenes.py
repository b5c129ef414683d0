"""Generated scenes: the same each time, and their boxes fit what is drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from follower.training.scenes import image_pool
from follower.training.scenes.generator import SceneMaker, SceneSettings, write_sequence
from follower.training.scenes.image_pool import COLLAGES, image_source, load, prepare, rendered
from follower.training.scenes.image_source import (
    Cutout,
    ImageSource,
    cut,
    mask_outline,
    random_mask,
)
from follower.training.scenes.scene import folded, hover, wander
from follower_control.common.strict_config import SettingsError
from follower_vision.evaluation.datasets import load_dataset
from follower_vision.geometry.box import Box

HARD = SceneSettings(perspective=1.0, deformation=1.0, occlusion=1.0, look_alikes=1.0, blur=1.0)
PLAIN = SceneSettings(blur=0.0, leaving=0.0, soft=0.0, grey=0.0, compression=0.0)


@pytest.mark.slow
def test_the_simulator_gives_grounds_and_objects() -> None:
    """From one seed the same; bodies are cut out whole, without the ground around them."""
    one, same = (rendered(np.random.default_rng(3), 2) for _ in range(2))
    assert len(one.photographs) == 6
    assert one.photographs[0].shape == (480, 640, 3)
    np.testing.assert_array_equal(one.photographs[5], same.photographs[5])
    assert len(one.cutouts) == len(same.cutouts) >= 3
    for cutout in one.cutouts:
        mask = cutout.levels[0][:, :, 3]
        assert 0.15 < (mask > 127).mean() < 0.95
        box = fitting(mask)
        assert box.width > 0.8 * mask.shape[1]
        assert box.height > 0.8 * mask.shape[0]


@pytest.mark.slow
def test_stocks_are_joined(pictures: ImageSource) -> None:
    both = pictures.joined(rendered(np.random.default_rng(3), 1))
    assert (len(both.textures), len(both.photographs)) == (len(pictures.textures), 3)
    scene = SceneMaker(both, HARD, 1).scene(0, 3)
    assert scene.whole(1).image.shape == (480, 640, 3)


def fitting(mask: np.ndarray) -> Box:
    outline = mask_outline(mask)
    (left, top), (right, bottom) = outline.min(axis=0), outline.max(axis=0)
    return Box.from_xywh(left, top, right - left, bottom - top)


@pytest.mark.parametrize("settings", [HARD, SceneSettings(pieces=1.0, leaving=0.0)])
def test_boxes_fit_masks(pictures: ImageSource, settings: SceneSettings) -> None:
    overlaps: list[float] = []
    for index in range(12):
        scene = SceneMaker(pictures, settings, 5).scene(index, 12)
        for frame in (0, 5, 11):
            box = scene.box(frame)
            if box.visible_share(scene.width, scene.height) < 1.0:
                continue
            mask = scene.whole(frame).mask
            # Spikes thinner than a pixel are in the box, but not to be seen.
            assert box.iou(fitting(mask)) > 0.8
            overlaps.append(box.iou(fitting(mask)))
    assert len(overlaps) > 10
    assert np.mean(overlaps) > 0.93


def test_a_scene_depends_on_its_seed_and_number_alone(pictures: ImageSource) -> None:
    one, same = (SceneMaker(pictures, HARD, 1).scene(7, 10) for _ in range(2))
    other_seed = SceneMaker(pictures, HARD, 2).scene(7, 10)
    other_number = SceneMaker(pictures, HARD, 1).scene(8, 10)
    image = one.whole(4).image
    np.testing.assert_array_equal(image, same.whole(4).image)
    assert (image != other_seed.whole(4).image).any()
    assert (image != other_number.whole(4).image).any()
    # Also when other frames were drawn before.
    same.whole(9)
    np.testing.assert_array_equal(image, same.whole(4).image)


def test_a_crop_is_what_the_whole_frame_shows_there(pictures: ImageSource) -> None:
    settings = SceneSettings(
        blur=0.0, low_light=0.0, leaving=0.0, least_scale=60.0, soft=0.0, compression=0.0
    )
    scene = SceneMaker(pictures, settings, 4).scene(2, 4)
    region = Box(320, 240, 128, 128)
    part = scene.whole(2).image[176:304, 256:384].astype(float)
    crop = scene.crop(2, region, 128).image.astype(float)
    # Only the camera's noise differs.
    assert np.abs(cv2.blur(part, (9, 9)) - cv2.blur(crop, (9, 9))).mean() < 2.5


def test_a_black_and_white_film_has_no_colours(pictures: ImageSource) -> None:
    for settings, grey in ((PLAIN, False), (replace(PLAIN, grey=1.0), True)):
        image = SceneMaker(pictures, settings, 4).scene(2, 4).whole(2).image
        assert (image == image[:, :, :1]).all() == grey


@pytest.mark.parametrize("trace", ["soft", "compression"])
def test_a_film_loses_detail_and_keeps_the_rest(pictures: ImageSource, trace: str) -> None:
    """Both take the finest detail; what is larger stays, and so does the target's place."""
    scenes = [
        SceneMaker(pictures, settings, 4).scene(5, 4)
        for settings in (PLAIN, replace(PLAIN, **{trace: 1.0}))
    ]
    # The sensor's noise comes after the lens.
    clear, film = (replace(scene, light=replace(scene.light, noise=0.0)) for scene in scenes)
    assert clear.box(2) == film.box(2)
    one, other = (scene.whole(2).image.astype(float) for scene in (clear, film))
    assert (one != other).any()
    fine = [float(cv2.Laplacian(image, cv2.CV_64F).var()) for image in (one, other)]
    assert fine[1] < 0.9 * fine[0]
    coarse = [cv2.blur(image, (33, 33)) for image in (one, other)]
    assert np.abs(coarse[0] - coarse[1]).mean() < 3.0


def test_outside_the_frame_there_is_one_colour(pictures: ImageSource) -> None:
    scene = SceneMaker(pictures, SceneSettings(compression=1.0), 4).scene(1, 4)
    crop = scene.crop(1, Box(0, 0, 100, 100), 100).image
    assert np.ptp(crop[:49, :49].reshape(-1, 3), axis=0).max() == 0
    assert np.ptp(crop[51:, 51:].reshape(-1, 3), axis=0).max() > 0


@pytest.mark.slow
def test_what_hides_the_target_counts(pictures: ImageSource) -> None:
    settings = SceneSettings(occlusion=1.0, look_alikes=0.0, leaving=0.0)
    shares = []
    for index in range(20):
        scene = SceneMaker(pictures, settings, 9).scene(index, 20)
        shares += [scene.whole(frame).visible for frame in range(0, 20, 4)]
    assert min(shares) < 0.3
    assert max(shares) == pytest.approx(1.0, abs=0.01)


def test_a_target_may_leave_the_frame_and_return(pictures: ImageSource) -> None:
    settings = SceneSettings(leaving=1.0, motion=1.5, least_scale=40, most_scale=60, pieces=0.0)
    gone_and_back = 0
    for index in range(10):
        scene = SceneMaker(pictures, settings, 2).scene(index, 150)
        seen = [scene.box(frame).visible_share(640, 480) > 0.5 for frame in range(150)]
        first_gone = seen.index(False) if False in seen else len(seen)
        gone_and_back += any(seen[:first_gone]) and any(seen[first_gone:])
    assert gone_and_back >= 2


def test_drawn_boxes_keep_to_the_target(pictures: ImageSource) -> None:
    scene = SceneMaker(pictures, SceneSettings(loose=1.0, leaving=0.0), 3).scene(0, 10)
    ratios = {
        round(scene.drawn_box(frame).width / scene.box(frame).width, 9) for frame in range(10)
    }
    assert len(ratios) == 1
    assert scene.drawn_box(5) != scene.box(5)


def test_an_empty_mask_is_no_object() -> None:
    with pytest.raises(ValueError, match="solid part"):
        Cutout.of(np.zeros((20, 20, 4), np.uint8))


def test_an_object_far_smaller_than_its_picture_is_drawn_from_a_small_level() -> None:
    checks = (np.indices((128, 128)).sum(axis=0) % 2 * 255).astype(np.uint8)
    cutout = Cutout.of(np.dstack([checks] * 3 + [np.full_like(checks, 255)]))
    canvas, _ = cutout.draw(np.zeros((8, 8, 3), np.uint8), np.diag([1 / 16, 1 / 16, 1.0]))
    # Sampled from the first level, checks would come out black or white.
    assert np.abs(canvas.astype(float) - 127).max() < 3


def test_every_random_shape_fills_its_rectangle() -> None:
    rng = np.random.default_rng(0)
    for _ in range(40):
        box = fitting(cut(np.zeros((40, 60, 3), np.uint8), random_mask(rng, 60, 40))[:, :, 3])
        assert box.width > 20
        assert box.height > 15


def test_courses_keep_to_their_sizes() -> None:
    rng = np.random.default_rng(1)
    assert np.std([hover(rng, 50, 2.0, 0.9) for _ in range(300)]) == pytest.approx(2.0, rel=0.1)
    steps = np.diff([wander(rng, 50, 2.0, 0.9) for _ in range(300)], axis=1)
    assert np.std(steps) == pytest.approx(2.0, rel=0.1)
    walked = folded(np.linspace(-7, 9, 200), 0.0, 1.0)
    assert (walked.min(), walked.max()) >= (0.0, 0.9)
    assert walked.max() <= 1.0


@pytest.mark.slow
def test_pictures_are_made_small_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "free").mkdir()
    photograph = rng.integers(0, 255, (300, 2200, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "free" / "photo.jpg"), photograph)
    mask = np.zeros((400, 500), np.uint8)
    mask[100:300, 100:400] = 255
    cv2.imwrite(str(tmp_path / "free" / "object.png"), np.dstack([mask] * 4))
    cv2.imwrite(str(tmp_path / "free" / "opaque.png"), photograph)
    listing = tmp_path / "pictures.yaml"
    listing.write_text("photographs: [{files: free/*.jpg}]\ncutouts: [{files: free/*.png}]\n")
    with monkeypatch.context() as patch:
        patch.setattr(cv2, "imwrite", Mock(side_effect=[True, KeyboardInterrupt]))
        with pytest.raises(KeyboardInterrupt):
            prepare(tmp_path, tmp_path / "stock", 1, listing)
    assert not (tmp_path / "stock").exists()
    left = tmp_path / "stock.part" / "cutouts" / "00099.png"
    left.write_bytes(b"of another folder")
    prepare(tmp_path, tmp_path / "stock", 1, listing)
    assert not (tmp_path / "stock" / "cutouts" / left.name).exists()
    pictures = load(tmp_path / "stock", 1, collages=1)
    assert pictures.photographs[0].shape == (150, 1100, 3)
    assert [cutout.size for cutout in pictures.cutouts] == [(128, 85)]
    with pytest.raises(SettingsError, match="no pictures"):
        prepare(tmp_path / "stock", tmp_path / "other", 1, listing)


def test_a_training_that_begins_anew_takes_the_pictures_that_are_there_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "train").mkdir()
    listing = tmp_path / "train" / "pictures.yaml"
    listing.write_text("photographs: [{files: '*.jpg'}]\ncutouts: [{files: '*.png'}]\n")
    monkeypatch.setattr(image_pool, "configs_folder", lambda: tmp_path)
    monkeypatch.setattr(image_pool, "collage", lambda _, stock: stock.photographs[0])
    given = tmp_path / "pictures"
    given.mkdir()
    cv2.imwrite(str(given / "object.png"), np.full((64, 64, 4), 255, np.uint8))

    def photographs(number: int, resume: bool) -> int:
        cv2.imwrite(str(given / f"{number}.jpg"), np.zeros((64, 64, 3), np.uint8))
        source = image_source(given, tmp_path / "mine", 1, 0, resume=resume)
        return len(source.photographs) - COLLAGES

    assert [photographs(1, False), photographs(2, True), photographs(3, False)] == [1, 1, 3]


def test_generated_sequences_can_be_evaluated(tmp_path: Path, pictures: ImageSource) -> None:
    scene = SceneMaker(pictures, SceneSettings(leaving=0.0), 6).scene(0, 4)
    write_sequence(scene, tmp_path / "one")
    (sequence,), remarks = load_dataset(tmp_path)
    assert (sequence.name, len(sequence.truth), remarks) == ("one", 4, [])
    assert sequence.truth[2].iou(scene.drawn_box(2)) > 0.98
