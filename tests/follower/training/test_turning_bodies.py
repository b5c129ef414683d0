"""Bodies that turn in space: what is seen of them from all sides, and in scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from easy_scenes import EASY

from follower.training.scenes.generator import SceneMaker
from follower.training.scenes.image_pool import image_source
from follower.training.scenes.image_source import Cutout, ImageSource, TurningBody, procedural
from follower.training.scenes.scene import Turning
from follower.training.scenes.turning_body import block_body, simulated_body

PICTURES = procedural(np.random.default_rng(3), 4)
KINDS: dict[str, Callable[[np.random.Generator], TurningBody]] = {
    "simulated": simulated_body,
    "blocks": lambda rng: block_body(rng, PICTURES),
}


def aspect(view: Cutout) -> float:
    box = view.box(np.eye(3))
    return math.log(box.width / box.height)


@pytest.mark.parametrize("kind", KINDS)
def test_all_views_show_the_whole_body_on_canvases_of_one_size(kind: str) -> None:
    for seed in range(8):
        body = KINDS[kind](np.random.default_rng(seed))
        sizes = {view.size for view in body.views}
        assert len(sizes) == 1
        ((width, height),) = sizes
        for view in body.views:
            picture = view.levels[0]
            edge = np.ones((height, width), bool)
            edge[1:-1, 1:-1] = False
            assert not (picture[edge] > 127).any()
            assert (picture[:, :, :3] <= picture[:, :, 3:]).all()
        scales = [view.box(np.eye(3)).scale for view in body.views]
        assert body.fill == pytest.approx(np.mean(scales) / width)


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_are_the_same_each_time_and_differ_from_one_another(kind: str) -> None:
    one, same, other = (KINDS[kind](np.random.default_rng(seed)) for seed in (5, 5, 6))
    for view, again in zip(one.views, same.views, strict=True):
        np.testing.assert_array_equal(view.levels[0], again.levels[0])
    assert any(
        not np.array_equal(view.levels[0], another.levels[0])
        for view, another in zip(one.views, other.views, strict=True)
    )


def test_opposite_views_of_a_block_have_one_outline_and_quarter_turns_another() -> None:
    """From afar a point and its mirror image fall on mirrored places: width stays, height too."""
    changed = []
    for seed in range(12):
        views = block_body(np.random.default_rng(seed), PICTURES).views
        half = len(views) // 2
        first, behind = (views[k].box(np.eye(3)) for k in (0, half))
        assert behind.width == pytest.approx(first.width, abs=2)
        changed.append(abs(aspect(views[0]) - aspect(views[half // 2])))
    assert max(changed) > 0.5


def test_a_turn_shows_one_view_after_the_other_and_the_first_again() -> None:
    body = simulated_body(np.random.default_rng(0))
    count = len(body.views)
    turning = Turning(body, np.linspace(0, 2 * math.pi, count + 1))
    assert [turning.bent(k) for k in range(count)] == list(body.views)
    assert turning.bent(count) is body.views[0]
    backwards = Turning(body, np.array([-2 * math.pi / count]))
    assert backwards.bent(0) is body.views[-1]


def test_in_scenes_what_turns_changes_its_aspect_and_its_box_fits_what_is_drawn() -> None:
    bodies = tuple(KINDS[kind](np.random.default_rng(seed)) for kind in KINDS for seed in range(3))
    pictures = PICTURES.joined(ImageSource((), (), (), bodies))
    still = replace(
        EASY, turning=1.0, pieces=0.0, aspect_change=0.0, rotation=0.0, scale_change=0.0,
        perspective=0.0, deformation=0.0,
    )  # fmt: skip
    spread = []
    for index in range(10):
        scene = SceneMaker(pictures, still, 2).scene(index, 48)
        layer = scene.layers[scene.target]
        assert isinstance(layer.bending, Turning)
        boxes = [scene.box(frame) for frame in range(scene.frames)]
        spread.append(np.ptp([math.log(box.width / box.height) for box in boxes]))
        mask = scene.whole(7).mask
        rows, columns = np.nonzero(mask > 127)
        if boxes[7].visible_share(scene.width, scene.height) == 1.0:
            assert rows.max() - rows.min() + 1 == pytest.approx(boxes[7].height, abs=3)
            assert columns.max() - columns.min() + 1 == pytest.approx(boxes[7].width, abs=3)
    assert max(spread) > 0.5
    no_bodies = SceneMaker(PICTURES, still, 2).scene(0, 8)
    assert not isinstance(no_bodies.layers[no_bodies.target].bending, Turning)


def test_a_training_makes_as_many_as_it_wants(tmp_path: Path) -> None:
    assert len(image_source(None, tmp_path, 1, 0, bodies=3).bodies) == 3
