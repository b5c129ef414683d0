"""Training the Siamese tracker: examples, loss, steps, and the networks that come out."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from easy_scenes import EASY, check_interrupted
from hypothesis import given
from hypothesis import strategies as st
from program import output_of

from follower.training.onnx_export import AGREEMENT
from follower.training.scenes.generator import SceneMaker, SceneSettings
from follower.training.scenes.image_source import ImageSource
from follower.training.siamese.examples import Batches, pair
from follower.training.siamese.network import (
    CELLS,
    SEARCH_PX,
    SiameseAnswer,
    SiameseModule,
    places,
)
from follower.training.siamese.run import export_siamese, sample_sheet
from follower.training.siamese.settings import SiameseNetworkSettings, SiameseTrainingSettings
from follower.training.siamese.trainer import SiameseTrainer, in_shape, siamese_loss
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.box import Box
from follower_vision.trackers.nanotrack import NanoTrackNetwork
from follower_vision.trackers.registry import make_tracker

SMALL = SiameseNetworkSettings(channels=16, head=16)
RECIPE = """
name: tiny
licence: Apache-2.0
training:
  network: {channels: 16, head: 16}
  steps: 2
  batch: 2
  scene_frames: 4
  held_out: 2
  validate_every: 2
  save_every: 1
  workers: 0
"""


def settings(steps: int, batch: int = 3, **changes: object) -> SiameseTrainingSettings:
    plan = SiameseTrainingSettings(
        steps=steps, batch=batch, network=SMALL, scenes=EASY, scene_frames=8, held_out=24, workers=0
    )
    return dataclasses.replace(plan, **changes)


def sure_answer(box: Box) -> SiameseAnswer:
    """What a network says that sees `box`, in pixels from the crop's middle, from each place."""
    at = places()
    corners = torch.tensor([box.left, box.top, box.right, box.bottom])
    sides = torch.stack(
        [*(at - corners[:2]).T, *(corners[2:] - at).T],
    ).reshape(1, 4, CELLS, CELLS)
    inside = (sides.amin(dim=1, keepdim=True) > 0).float()
    return SiameseAnswer(20 * inside - 10, sides)


def loss_of(answer: SiameseAnswer, box: Box, visible: bool = True) -> tuple[float, float]:
    """The side's loss, and the overlap of the best box."""
    true = torch.tensor([[box.cx, box.cy, box.width, box.height]])
    loss, overlap = siamese_loss(answer, true, torch.tensor([visible]))
    return float(loss.side), float(overlap)


offset = st.floats(-25, 25)
side = st.floats(24, 60)


@given(offset, offset, side, side, offset, offset, side, side)
def test_the_overlap_is_that_of_the_boxes(
    x: float, y: float, w: float, h: float, x2: float, y2: float, w2: float, h2: float
) -> None:
    said, true = Box(x, y, w, h), Box(x2, y2, w2, h2)
    lost, overlap = loss_of(sure_answer(said), true)
    assert overlap == pytest.approx(said.iou(true), abs=1e-4)
    assert -1e-4 <= lost <= 2.0


def test_the_right_answer_costs_nothing_and_a_missing_target_no_box() -> None:
    box = Box(8.0, -16.0, 40.0, 30.0)
    assert loss_of(sure_answer(box), box)[0] == pytest.approx(0.0, abs=1e-5)
    assert loss_of(sure_answer(Box(-30.0, 20.0, 24.0, 24.0)), box)[0] > 0.5
    assert loss_of(sure_answer(Box(-30.0, 20.0, 24.0, 24.0)), box, visible=False)[0] == 0.0


def test_believing_an_absent_target_costs_more_than_doubting_it() -> None:
    true, there = torch.tensor([[0.0, 0.0, 40.0, 40.0]]), torch.tensor([False])
    sides = torch.full((1, 4, CELLS, CELLS), 20.0)
    losses = [
        float(
            siamese_loss(SiameseAnswer(torch.full_like(sides[:, :1], logit), sides), true, there)[
                0
            ].total
        )
        for logit in (-6.0, 0.0, 6.0)
    ]
    assert losses == sorted(losses)
    assert losses[0] < 0.01 * losses[2]


@pytest.mark.slow
def test_a_batch_is_the_same_whoever_draws_it(pictures: ImageSource) -> None:
    batches = Batches(SceneMaker(pictures, SceneSettings(), 1), 6, 8)
    first, again, other = batches[4], batches[4], batches[5]
    for one, same in zip(first, again, strict=True):
        assert torch.equal(one, same)
    assert not torch.equal(first.search, other.search)
    assert sample_sheet(first).shape == (SEARCH_PX, 6 * (SEARCH_PX // 2 + SEARCH_PX), 3)
    assert first.box[first.visible, 2:].min() >= 1.0


def test_a_network_that_sees_no_change_gives_the_first_boxs_shape_at_the_size_it_sees() -> None:
    sides = torch.full((2, 4, CELLS, CELLS), 20.0)
    shape = torch.tensor([[2.0, 0.5], [1.0, 1.0]])
    left, top, right, bottom = in_shape(SiameseAnswer(sides[:, :1], sides), shape).sides[0]
    assert torch.equal(left + right, torch.full((CELLS, CELLS), 80.0))
    assert torch.equal(top + bottom, torch.full((CELLS, CELLS), 20.0))
    assert torch.equal(in_shape(SiameseAnswer(sides[:, :1], sides), shape).sides[1], sides[1])


@pytest.mark.slow
def test_an_examples_shape_is_that_of_the_first_drawn_box(pictures: ImageSource) -> None:
    """Where the target keeps its shape and fits its box, both frames have the same one."""
    still = dataclasses.replace(EASY, scale_change=0.0, aspect_change=0.0, rotation=0.0, loose=0.0)
    seen = 0
    for index in range(8):
        scene = SceneMaker(pictures, still, 4).scene(index, 8)
        found = pair(np.random.default_rng(index), scene)
        if found is not None:
            assert np.prod(found.shape) == pytest.approx(1.0, abs=1e-5)
            seen_shape = found.box[2:] / np.sqrt(np.prod(found.box[2:]))
            np.testing.assert_allclose(seen_shape, found.shape, rtol=1e-3)
            seen += 1
    assert seen > 4


def test_a_training_from_before_is_not_gone_on_with(pictures: ImageSource) -> None:
    """Its sides were pixels."""
    trainer = SiameseTrainer(settings(1), pictures)
    size = dataclasses.asdict(SMALL)
    with pytest.raises(SettingsError, match="the checkpoint is of another network"):
        trainer.restore(trainer.state() | {"size": size})


@pytest.mark.slow
def test_a_tiny_run_learns_to_find_the_target(pictures: ImageSource) -> None:
    trainer = SiameseTrainer(settings(120, 12, rate=4e-3), pictures)
    untrained = trainer.validate()
    while not trainer.done:
        trainer.train_step()
    assert trainer.validate() > untrained + 0.15


@pytest.mark.slow
def test_an_interrupted_training_ends_as_an_uninterrupted_one(
    pictures: ImageSource, tmp_path: Path
) -> None:
    check_interrupted(lambda: SiameseTrainer(settings(4), pictures), tmp_path)


def test_the_exported_networks_answer_as_the_trained_one(tmp_path: Path) -> None:
    torch.manual_seed(1)
    module = SiameseModule(SMALL).eval()
    export_siamese(module, tmp_path / "mine")
    network = NanoTrackNetwork(tmp_path / "mine_backbone.onnx", tmp_path / "mine_head.onnx")
    rng = np.random.default_rng(2)
    search = rng.integers(0, 256, (SEARCH_PX, SEARCH_PX, 3), np.uint8)
    template = search[40:120, 40:120]
    shape = (2.0, 0.5)
    found = network.match(network.template(template), network.features(search), shape)

    def crops(image: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32))

    with torch.no_grad():
        answer = in_shape(module(crops(template), crops(search)), torch.tensor([shape]))
    likely = torch.sigmoid(answer.scores).flatten().numpy()
    np.testing.assert_allclose(found.scores, likely, atol=2e-3)
    at, sides = places().numpy(), answer.sides.reshape(4, -1).T.numpy()
    corners = np.hstack([at - sides[:, :2], at + sides[:, 2:]])
    np.testing.assert_allclose(found.corners, corners, rtol=1e-2, atol=0.1)


def test_an_export_is_compared_with_the_statistics_that_its_file_keeps(tmp_path: Path) -> None:
    torch.manual_seed(1)
    module = SiameseModule(SiameseNetworkSettings(channels=64, head=8)).eval()
    module.head.levelled.running_mean.normal_()
    module.head.levelled.running_var.uniform_(0.01, 0.1)
    for exported in export_siamese(module, tmp_path / "mine"):
        assert exported.difference < AGREEMENT / 10


@pytest.mark.slow
def test_a_training_leaves_a_tracker_by_its_head_and_can_be_exported_again(tmp_path: Path) -> None:
    recipe = tmp_path / "tiny.yaml"
    recipe.write_text(RECIPE, encoding="utf-8")
    output_of("train", "siamese", "-c", str(recipe), "--out", str(tmp_path), "--device", "cpu")
    folder = tmp_path / "tiny"
    made = {path.name for path in folder.iterdir()}
    networks = {f"tiny_{part}.{kind}" for part in ("backbone", "head") for kind in ("onnx", "md")}
    assert made >= {"config.yaml", "checkpoint.pt", "samples.png", "log.csv", *networks}
    head = folder / "tiny_head.onnx"
    tracker = make_tracker(str(head), Path)
    image = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    tracker.start(image, Box(80, 60, 30, 20))
    assert tracker.name == "tiny"
    assert 0 <= tracker.update(image).confidence <= 1
    head.unlink()
    output = output_of("export", str(folder))
    assert output.rsplit("sha256 ", 1)[1].strip() in (folder / "tiny_head.md").read_text("utf-8")
    assert head.is_file()
