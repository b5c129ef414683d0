"""The paper's peers learn by the same loop, and are exported to run as Re3 does."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from follower.configs import configs_folder
from follower.training.re3 import peers
from follower.training.re3.config import Re3Config
from follower.training.re3.examples import pair
from follower.training.re3.export import AGREEMENT, export_re3, random_inputs
from follower.training.re3.loss import re3_loss
from follower.training.re3.network import Re3NetworkSettings, Re3State
from follower.training.re3.peers import KINDS, make_network
from follower.training.re3.rollout import Batch, answered
from follower.training.scenes.maker import SceneMaker
from follower.training.scenes.pictures import procedural
from follower.training.scenes.settings import SceneSettings
from follower_control.strict_yaml import read_mapping
from follower_vision.box import Box
from follower_vision.re3_network import Re3Network as Re3Runner
from follower_vision.trackers import make_tracker

PEERS = ["goturn", "siamfc"]


def small(kind: str) -> Re3NetworkSettings:
    return dataclasses.replace(Re3NetworkSettings(channels=16, hidden=16, head=16), kind=kind)


@pytest.mark.parametrize("kind", PEERS)
def test_a_step_lowers_the_loss_on_a_fixed_batch(kind: str) -> None:
    torch.manual_seed(0)
    network, rng = make_network(small(kind)), np.random.default_rng(0)
    maker = SceneMaker(procedural(np.random.default_rng(3), 4), SceneSettings(), 1)
    examples = [pair(rng, maker.scene(index, 6)) for index in range(8)]
    batch = Batch(examples, torch.device("cpu"))
    optimiser = torch.optim.AdamW(network.parameters(), 3e-3)

    def loss() -> torch.Tensor:
        answer = answered(network, batch, network.memory(batch.memory), network.start_state(8))
        return re3_loss(answer, batch.wanted, batch.visible, network.places).place

    before = loss()
    for _ in range(15):
        optimiser.zero_grad()
        loss().backward()
        optimiser.step()
    assert float(loss().detach()) < 0.95 * float(before.detach())


@pytest.mark.parametrize("kind", PEERS)
def test_each_knows_its_own_half_alone(kind: str) -> None:
    network = make_network(small(kind)).eval()
    one = random_inputs(network, np.random.default_rng(0))
    other = random_inputs(network, np.random.default_rng(1))
    previous, present, size, memory, memory_size = one[:5]
    blind = {"goturn": (previous, other[3]), "siamfc": (other[0], memory)}[kind]
    with torch.no_grad():
        boxes = [
            network(before, present, size, first, memory_size, Re3State(*state)).box
            for before, first, state in ((previous, memory, one[5:]), (*blind, other[5:]))
        ]
        seeing = (other[0], memory) if kind == "goturn" else (previous, other[3])
        third = network(seeing[0], present, size, seeing[1], memory_size, Re3State(*one[5:])).box
    torch.testing.assert_close(boxes[0], boxes[1])
    assert not torch.allclose(boxes[0], third)


def test_the_siamese_tracker_grows_with_its_target(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "_SCALE_PENALTY", 1.0)  # an untrained trunk finds all alike
    network = make_network(small("siamfc")).eval()
    rng = np.random.default_rng(5)
    picture = torch.from_numpy(rng.uniform(0, 255, (1, 3, 8, 8)).astype(np.float32))

    def crop(side: int, of: int) -> torch.Tensor:
        whole = torch.nn.functional.interpolate(picture, (side, side), mode="bilinear")
        margin = (of - side) // 2
        return torch.nn.functional.pad(whole, (margin,) * 4, value=120.0)

    size = torch.ones(1, 2)
    with torch.no_grad():
        memory = network.memory(crop(40, 64))
        grown = [
            float(network.compared(memory, crop(side, 128), size, memory, size, _state()).box[0, 2])
            for side in (38, 40, 42)
        ]
    assert grown[0] < 0 == grown[1] < grown[2]


def _state() -> Re3State:
    return Re3State(torch.zeros(2, 1, 16), torch.zeros(2, 1, 16))


@pytest.mark.parametrize("kind", PEERS)
def test_an_exported_peer_is_a_tracker_by_its_path(tmp_path: Path, kind: str) -> None:
    torch.manual_seed(1)
    path = tmp_path / f"{kind}.onnx"
    exported = export_re3(make_network(small(kind)), path)
    assert exported.difference <= AGREEMENT
    Re3Runner(path)
    tracker = make_tracker(str(path), lambda _: tmp_path)
    assert tracker.name == kind
    image = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)
    tracker.start(image, Box(80, 60, 30, 24))
    assert 0 <= tracker.update(image).box.cx <= 160


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_its_configuration(kind: str) -> None:
    path = configs_folder() / "train" / f"{kind}.yaml"
    config = Re3Config.model_validate(read_mapping(path))
    assert config.training.network.kind == kind
