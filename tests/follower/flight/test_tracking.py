"""The trackers that the settings name."""

from __future__ import annotations

import pytest

from follower.flight.vision.tracker_factory import (
    close_tracker,
    make_multi_tracker,
    make_target_tracker,
)
from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detection
from follower_vision.fusion import FusionSettings, FusionTracker, MultiFusion, PaperFusion
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.target_tracker import SeparateTrackers

PAPER = FusionSettings.paper()


class BlindDetector:
    """Sees nothing."""

    class_names = ("thing",)

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        return []


@pytest.mark.parametrize(
    ("settings", "kind"),
    [
        (Settings(), FusionTracker),
        (Settings(detector="embedded"), FusionTracker),
        (Settings(detector="embedded", fusion=PAPER), PaperFusion),
    ],
)
def test_one_target_is_followed_by_what_the_settings_name(settings: Settings, kind: type) -> None:
    tracker = make_target_tracker(settings)
    assert type(tracker) is kind
    close_tracker(tracker)


def test_the_papers_algorithm_without_a_detector_is_refused() -> None:
    with pytest.raises(SettingsError, match="the paper's needs a detector"):
        make_target_tracker(Settings(fusion=PAPER))


@pytest.mark.parametrize(
    ("count", "settings", "kind"),
    [
        (1, Settings(), SeparateTrackers),
        (2, Settings(), MultiFusion),
        (2, Settings(fusion=PAPER), SeparateTrackers),
    ],
)
def test_several_share_a_detector(count: int, settings: Settings, kind: type) -> None:
    tracker = make_multi_tracker(settings, count, BlindDetector())
    assert type(tracker) is kind
    tracker.close()


@pytest.mark.parametrize(
    ("detector", "message"),
    [
        ("osnet", "no network 'osnet'; there are follower-detector"),
        ("gone.onnx", "no such network"),
    ],
)
def test_a_detector_that_is_not_there_is_refused(detector: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make_target_tracker(Settings(detector=detector))


def test_a_model_that_cannot_be_used_is_refused() -> None:
    settings = Settings(detector="embedded", fusion=FusionSettings(model="gone.json"))
    with pytest.raises(ValueError, match=r"gone\.json: no file of `follower train fusion`"):
        make_target_tracker(settings)
