"""Re3 learns: a step, a tiny run, the same again after an interruption; and is exported."""

from __future__ import annotations

import dataclasses
import resource
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from easy_scenes import EASY, check_interrupted
from onnx import helper, save

from follower.training.onnx_export import AGREEMENT, folded
from follower.training.re3.examples import (
    Batch,
    Example,
    Tracked,
    answered,
    looked,
    pair,
    remembered,
    swapped,
)
from follower.training.re3.network import Re3Module
from follower.training.re3.run import UNCALIBRATED, calibrated, export_re3
from follower.training.re3.settings import (
    Re3NetworkSettings,
    Re3TrainingSettings,
    TrainingStage,
)
from follower.training.re3.trainer import Re3Trainer, re3_loss
from follower.training.scenes.generator import SceneMaker, SceneSettings
from follower.training.scenes.image_source import ImageSource
from follower.training.trainer import load_checkpoint, save_checkpoint
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.re3 import SEARCH_PX, Re3Network, search_region

SMALL = Re3NetworkSettings(channels=16, hidden=16, head=16)
CPU = torch.device("cpu")


def settings(*stages: TrainingStage, scenes: SceneSettings = EASY) -> Re3TrainingSettings:
    return Re3TrainingSettings(
        stages=stages, network=SMALL, scenes=scenes, validation_scenes=6, validation_frames=10
    )


@pytest.mark.parametrize(("batch", "scenes"), [(2, 2), (9, 3), (24, 6), (32, 8)])
def test_a_picture_without_the_target_is_of_another_scene(batch: int, scenes: int) -> None:
    small, size = np.zeros((1, 1, 3), np.uint8), (1.0, 1.0)
    dealt = [
        Example(small, size, small, small + np.uint8(k % scenes), size, (0.0,) * 4, True)
        for k in range(batch)
    ]
    absent = 0
    for seed in range(100):
        for one, other in zip(dealt, swapped(np.random.default_rng(seed), dealt), strict=True):
            assert other.visible == bool((one.present == other.present).all())
            absent += not other.visible
    assert absent > batch


@pytest.mark.slow
def test_a_tiny_run_learns_to_track(pictures: ImageSource) -> None:
    trainer = Re3Trainer(settings(TrainingStage(steps=130, batch=8, rate=3e-3)), pictures)
    untrained = trainer.validate()
    while not trainer.done:
        trainer.train_step()
    assert trainer.validate() > untrained + 0.1


@pytest.mark.slow
@pytest.mark.parametrize("unroll", [1, 3])
def test_an_interrupted_training_ends_as_an_uninterrupted_one(
    pictures: ImageSource, tmp_path: Path, unroll: int
) -> None:
    plan = settings(TrainingStage(steps=4, batch=3, unroll=unroll, own_boxes=0.5))
    check_interrupted(lambda: Re3Trainer(plan, pictures), tmp_path)


@pytest.mark.slow
def test_a_checkpoint_of_another_size_is_refused(pictures: ImageSource) -> None:
    other = dataclasses.replace(
        settings(TrainingStage(steps=1)), network=Re3NetworkSettings(24, 16, 16)
    )
    with pytest.raises(SettingsError, match="another size"):
        Re3Trainer(other, pictures).restore(
            Re3Trainer(settings(TrainingStage(1)), pictures).state()
        )


@pytest.mark.slow
def test_the_trunk_rests_where_a_stage_says_so(pictures: ImageSource) -> None:
    trainer = Re3Trainer(settings(TrainingStage(steps=2, batch=2, unroll=2, trunk=False)), pictures)
    before = [value.clone() for value in trainer.network.trunk.state_dict().values()]
    lstm = trainer.network.first.weight_hh.clone()
    for _ in range(2):
        trainer.train_step()
    for value, old in zip(trainer.network.trunk.state_dict().values(), before, strict=True):
        torch.testing.assert_close(value, old, rtol=0, atol=0)
    assert (trainer.network.first.weight_hh != lstm).any()


def test_recurrence_begins_anew_without_a_say_and_learns_alone(pictures: ImageSource) -> None:
    plan = settings(
        TrainingStage(steps=2, batch=2, unroll=2, rate=0.01),
        TrainingStage(steps=2, batch=2, unroll=2, rate=0.01, recurrence_anew=True),
    )
    trainer = Re3Trainer(plan, pictures)
    trainer.train_step()
    trainer.train_step()
    before = {name: value.clone() for name, value in trainer.averaged.state_dict().items()}
    trainer.network.begin_recurrence()
    for reader in (trainer.network.prior, trainer.network.refine, trainer.network.recalled):
        assert not reader.weight.any()
    trainer.train_step()
    trainer.train_step()
    of_recurrence = {id(one) for part in trainer.network.recurrence() for one in part.parameters()}
    learnt = dict(trainer.network.named_parameters())
    for name, parameter in learnt.items():
        if id(parameter) not in of_recurrence:
            assert torch.equal(parameter, before[name]), f"{name} goes on from the averaged weights"
    assert learnt["recalled.weight"].any()
    with pytest.raises(ValueError, match="unroll"):
        TrainingStage(steps=1, recurrence_anew=True)


def test_torch_and_onnx_agree(tmp_path: Path) -> None:
    torch.manual_seed(2)
    network = Re3Module(SMALL)
    for layer in (network.prior, network.refine, network.recalled):
        torch.nn.init.normal_(layer.weight, std=0.1)
    exported = export_re3(network, tmp_path / "tracker.onnx")
    assert exported.difference <= AGREEMENT
    weights = sum(value.numel() for value in network.parameters())
    assert exported.path.stat().st_size < 2 * weights + 220_000


def test_where_there_is_no_room_the_earlier_checkpoint_stays(tmp_path: Path) -> None:
    save_checkpoint(tmp_path, {"step": 1})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"checkpoint\.pt"):
            save_checkpoint(tmp_path, {"step": 2, "network": torch.zeros(100_000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]
    assert load_checkpoint(tmp_path, CPU) == {"step": 1}


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(tmp_path, {"kind": "re3"})
    damaged = path.read_bytes().replace(b"kind", b"\xffind")
    save_checkpoint(tmp_path, [1])
    for content in (damaged, path.read_bytes(), b"no checkpoint", b""):
        path.write_bytes(content)
        with pytest.raises(SettingsError, match=r"checkpoint\.pt: this is no checkpoint of ours"):
            load_checkpoint(tmp_path, CPU)


def test_a_network_that_answers_with_no_numbers_is_not_exported_as_agreeing(tmp_path: Path) -> None:
    network = Re3Module(SMALL)
    torch.nn.init.constant_(network.refine.weight, torch.nan)
    with pytest.raises(ModelError, match="differs from the trained network by nan"):
        export_re3(network, tmp_path / "tracker.onnx")


def test_folding_the_normalisation_in_changes_nothing(pictures: ImageSource) -> None:
    torch.manual_seed(2)
    network = Re3Module(SMALL)
    rng, maker = np.random.default_rng(0), SceneMaker(pictures, EASY, 1)
    batch = Batch([pair(rng, maker.scene(index, 6)) for index in range(6)], CPU)
    for _ in range(3):
        network.memory(batch.memory)
    network.eval()
    with torch.no_grad():
        torch.testing.assert_close(
            folded(network).memory(batch.memory), network.memory(batch.memory)
        )
    assert not any(isinstance(one, torch.nn.BatchNorm2d) for one in folded(network).modules())


def test_the_tracker_sees_what_the_training_shows(pictures: ImageSource) -> None:
    maker = SceneMaker(pictures, EASY, 8)
    for index in range(5):
        scene = maker.scene(index, 3)
        region = search_region(scene.drawn_box(2))
        flown = crop(scene.whole(2).image, region, SEARCH_PX, SEARCH_PX, scene.fill)
        trained = scene.crop(2, region, SEARCH_PX).image
        grey = [
            cv2.cvtColor(one, cv2.COLOR_BGR2GRAY).astype(np.float32) for one in (flown, trained)
        ]
        (right, down), _ = cv2.phaseCorrelate(*grey)
        assert max(abs(right), abs(down)) < 0.2
        assert np.abs(grey[0] - grey[1]).mean() < 8


def test_another_network_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.onnx"
    sides = [helper.make_tensor_value_info(name, 1, [1, 3]) for name in ("x", "y")]
    graph = helper.make_graph(
        [helper.make_node("Relu", ["x"], ["y"])], "other", sides[:1], sides[1:]
    )
    save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    with pytest.raises(ModelError, match="not a Re3 network"):
        Re3Network(path)


def test_a_hidden_target_is_not_to_be_answered(pictures: ImageSource) -> None:
    scene = SceneMaker(pictures, EASY, 1).scene(0, 4)
    away = Box(scene.box(0).cx + 300, scene.box(0).cy, 40, 40)
    example = looked(scene, (0, 1), away, *remembered(scene, 0))
    assert not example.visible
    assert looked(scene, (0, 1), scene.box(0), *remembered(scene, 0)).visible


def test_a_perfect_answer_costs_less(pictures: ImageSource) -> None:
    torch.manual_seed(0)
    network, rng = Re3Module(SMALL).eval(), np.random.default_rng(0)
    batch = Batch([pair(rng, SceneMaker(pictures, EASY, 1).scene(0, 6)) for _ in range(4)], CPU)
    answer = answered(network, batch, network.memory(batch.memory), network.start_state(4))
    right = answer._replace(box=batch.wanted)
    ours, perfect = (
        re3_loss(one, batch.wanted, batch.visible, network.places) for one in (answer, right)
    )
    assert float(perfect.box) == 0.0
    assert float(perfect.box) < float(ours.box.detach())


def test_confidence_is_calibrated() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(3.0, 1.0, 4000)
    likelihood = 1 / (1 + np.exp(-(2.0 * logits - 4.0)))
    overlaps = np.where(rng.uniform(size=4000) < likelihood, 0.8, 0.1)
    slope, offset = calibrated(Tracked(logits, overlaps))
    assert slope == pytest.approx(2.0, rel=0.15)
    assert offset == pytest.approx(-4.0, rel=0.2)
    # Where it is worse than nothing, it is left alone.
    assert calibrated(Tracked(-logits, overlaps)) == UNCALIBRATED
