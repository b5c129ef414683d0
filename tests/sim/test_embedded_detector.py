"""The detector that comes along: it is whole, listed, and knows the simulator's targets."""

import math
from pathlib import Path

import pytest

from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import Scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.render import Renderer
from follower_sim.world.world import World
from follower_vision.detection import OnnxDetector, detector_names, make_detector
from follower_vision.geometry.box import Box
from follower_vision.models import FileState, ModelStore
from follower_vision.onnx_network import ModelError

NAME = "follower-detector"


@pytest.fixture(scope="module")
def detector(tmp_path_factory: pytest.TempPathFactory) -> OnnxDetector:
    """As on a machine without any download."""
    return make_detector("embedded", ModelStore(tmp_path_factory.mktemp("none")))


def test_it_is_listed_whole_and_needs_no_download(tmp_path: Path) -> None:
    store = ModelStore(tmp_path / "none")
    model = store.model(NAME)
    assert model.embedded
    assert not model.can_be_fetched
    assert store.is_present(model)
    assert store.verify(model) == {f"{NAME}.onnx": FileState.GOOD}
    assert store.pull(model) == store.paths(model)
    assert not store.folder.exists()
    assert NAME in detector_names(store)


def test_a_store_without_an_embedded_detector_says_so(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no detector is part of this package"):
        make_detector("embedded", ModelStore(tmp_path, ()))


def test_a_missing_part_of_the_package_is_named(tmp_path: Path) -> None:
    store = ModelStore(tmp_path, embedded=tmp_path)
    with pytest.raises(ModelError, match="install it again"):
        store.paths(store.model(NAME))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("colour", "azimuth_deg"), [("#e0401c", 20), ("#2a62c8", 200), ("#e8e8e8", 110)]
)
def test_it_finds_the_car_in_a_rendered_frame(
    detector: OnnxDetector, colour: str, azimuth_deg: float
) -> None:
    scenario = Scenario.model_validate(
        {
            "name": "car",
            "title": "A car on a meadow.",
            "duration_s": 1,
            "seed": 3,
            "targets": [{"kind": "car", "colour": colour, "path": {"points": [[0, 0], [9, 0]]}}],
            "camera": {"fov_deg": 75},
            "start": {"at": [-10, 0]},
            "select": {"colour": colour},
        }
    )
    world, azimuth = World(scenario), math.radians(azimuth_deg)
    place = (-10 * math.cos(azimuth), -10 * math.sin(azimuth), -5.0)
    body = BodyState(0.0, place, attitude_rad=(0.0, math.radians(-3), azimuth))
    image = Renderer(world).render(0.0, body)
    true = GroundTruth(world).seen(0.0, body).box
    region = Box(true.cx, true.cy, 5 * true.scale, 5 * true.scale)
    best = detector.detect(image, region)[0]
    assert best.class_name == "car"
    assert best.box.iou(true) > 0.5
