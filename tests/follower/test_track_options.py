"""What `follower track` is asked for becomes settings, or is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from follower.track_options import TrackOptions, usual_detector
from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.fusion import FusionSettings
from follower_vision.fusion.settings import IMPROVEMENTS

BOX = Box(50, 50, 20, 20)


def options(**wanted: object) -> TrackOptions:
    return TrackOptions("clip.mp4", **({"targets": (BOX,)} | wanted))


def test_the_paper_switches_every_improvement_off_and_nothing_else() -> None:
    assert options(paper=True).settings().fusion == FusionSettings.paper()


@pytest.mark.parametrize("name", IMPROVEMENTS)
def test_each_improvement_can_be_switched_off_alone(name: str) -> None:
    fusion = options(without=(name,)).settings().fusion
    assert fusion == FusionSettings().without(name)


def test_what_is_set_by_hand_comes_last_and_the_file_first(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("fusion: {validate_every: 3, search_every: 5, size_clamp: true}\n", "utf-8")
    asked = options(paper=True, config=file, overrides=("fusion.size_clamp=true",))
    fusion = asked.settings().fusion
    assert fusion.validate_every == FusionSettings.paper().validate_every
    assert fusion.search_every == 5
    assert fusion.size_clamp
    assert not fusion.camera_motion


@pytest.mark.parametrize(
    "wanted",
    [
        {"targets": (), "select": ("person",)},
        {"paper": True},
        {"without": ("size_clamp",)},
        {"appearance": "osnet-x0.25"},
    ],
)
def test_what_needs_a_detector_takes_the_usual_one_unless_another_is_named(
    wanted: dict[str, object],
) -> None:
    assert options(**wanted).settings().detector == usual_detector() == "yolox-nano"
    assert options(**wanted, detector="fastestdet").settings().detector == "fastestdet"
    assert options().settings().detector is None


def test_an_appearance_network_is_asked_only_if_one_is_named(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("{detector: fastestdet, appearance: of_mine.onnx}\n", "utf-8")
    assert options().settings().appearance is None
    assert options(config=file).settings().appearance == "of_mine.onnx"
    assert options(config=file, appearance="osnet-x0.25").settings().appearance == "osnet-x0.25"


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"targets": ()}, "which target"),
        ({"select": ("person",)}, "one of --target, --select and --colour alone"),
        ({"targets": (BOX,), "colour": "#ff0000"}, "one of --target, --select and --colour"),
        ({"targets": (BOX,) * 5}, "at most 4 targets"),
        ({"targets": (), "select": ("list", "car")}, "stands alone"),
        ({"without": ("speed",)}, "--without speed: .*zoomed_validation.*keep_template"),
        ({"tracker": "goturn"}, "--tracker goturn: .*correlation"),
        ({"video": False, "save": Path("a.mp4")}, "contradict"),
    ],
)
def test_contradictions_are_refused_with_what_to_do(
    wanted: dict[str, object], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        options(**wanted)


def test_an_empty_source_is_refused() -> None:
    with pytest.raises(SettingsError, match="which source"):
        TrackOptions("", targets=(BOX,))


@pytest.mark.parametrize("source", ["udp://0.0.0.0:5600", "/dev/video0", "rtsp://10.0.0.1/a"])
def test_live_sources_are_in_real_time_and_recordings_if_asked(source: str) -> None:
    assert TrackOptions(source, targets=(BOX,)).in_real_time
    assert options(realtime=True).in_real_time
    assert not options().in_real_time
