"""What `follower track` is asked for becomes settings, or is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from follower.apps.command_settings import usual_detector
from follower.apps.main import app
from follower.apps.video_input import VideoInput
from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError
from follower_vision.fusion import FusionSettings

BOX = "50,50,20,20"
Run = Callable[..., Settings]


@pytest.fixture
def settings(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Settings]:
    """Run the command as far as its settings, and return these."""
    given: list[Settings] = []

    def tracked(settings: Settings, *_: object) -> int:
        given.append(settings)
        return 0

    monkeypatch.setattr("follower.apps.track.session.track", tracked)

    def run(*options: object, choice: tuple[str, ...] = ("--target", BOX)) -> Settings:
        arguments = ["track", "clip.mp4", *choice, *map(str, options)]
        CliRunner().invoke(app, arguments, catch_exceptions=False)
        return given.pop()

    return run


def test_the_paper_is_an_algorithm_of_its_own(settings: Run) -> None:
    assert settings("--paper").fusion == FusionSettings.paper()


def test_what_is_set_by_hand_comes_last_and_the_file_first(settings: Run, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("fusion: {validate_every: 3, algorithm: fitted}\n", "utf-8")
    fusion = settings("--paper", "-c", file, "--set", "fusion.doubt_every=1").fusion
    assert fusion == FusionSettings("paper", validate_every=3, doubt_every=1)
    by_hand = settings("--paper", "--set", "fusion.algorithm=fitted").fusion
    assert by_hand.algorithm == "fitted"


@pytest.mark.parametrize(
    "options",
    [
        ("--select", "person"),
        ("--target", BOX, "--paper"),
    ],
)
def test_what_needs_a_detector_takes_the_usual_one_unless_another_is_named(
    settings: Run, options: tuple[str, ...]
) -> None:
    assert settings(choice=options).detector == usual_detector() == "yolox-nano"
    assert settings("--detector", "fastestdet", choice=options).detector == "fastestdet"


def test_a_target_is_followed_by_our_own_networks_unless_something_else_is_named(
    settings: Run, tmp_path: Path
) -> None:
    usual = settings()
    assert (usual.tracker, usual.detector) == ("siamese-correlation", "embedded")
    for named in (("--tracker", "correlation"), ("--set", "tracker=correlation")):
        alone = settings(*named)
        assert (alone.tracker, alone.detector) == ("correlation", None)
    file = tmp_path / "mine.yaml"
    file.write_text("detector: fastestdet\n", "utf-8")
    assert settings("-c", file).tracker == "correlation"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "which target"),
        (("--target", BOX, "--select", "person"), "one of --target, --select and --colour alone"),
        (("--target", BOX, "--colour", "#ff0000"), "one of --target, --select and --colour"),
        (("--target", BOX) * 5, "at most 4 targets"),
        (("--select", "list", "--select", "car"), "stands alone"),
        (
            ("--target", BOX, "--set", "fusion.size_clamp=true"),
            "size_clamp is gone: Fusion chooses",
        ),
        (("--target", BOX, "--set", "longterm.coast_s=1"), "longterm is gone: without a detector"),
        (("--target", BOX, "--tracker", "goturn"), "--tracker goturn: .*correlation"),
        (("--target", BOX, "--no-video", "--save", "a.mp4"), "contradict"),
    ],
)
def test_contradictions_are_refused_with_what_to_do(options: tuple[str, ...], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        CliRunner().invoke(app, ["track", "clip.mp4", *options], catch_exceptions=False)


def test_an_empty_source_is_refused() -> None:
    with pytest.raises(SettingsError, match="which source"):
        VideoInput(" ")


@pytest.mark.parametrize("source", ["udp://0.0.0.0:5600", "/dev/video0", "rtsp://10.0.0.1/a"])
def test_live_sources_are_in_real_time_and_recordings_if_asked(source: str) -> None:
    assert VideoInput(source).in_real_time
    assert VideoInput("clip.mp4", realtime=True).in_real_time
    assert not VideoInput("clip.mp4").in_real_time
