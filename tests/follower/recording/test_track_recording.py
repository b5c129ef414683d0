"""`follower track --record`: a run on recorded video becomes a flight that replays."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from follower.apps.replay.run import SAME, replay_flight
from follower.apps.target_choice import TargetChoice
from follower.apps.track.run import TrackFiles
from follower.apps.track.session import track
from follower.apps.video_input import VideoInput
from follower.recording import open_flight
from follower.settings.settings import Settings, load_settings
from follower_vision.geometry.box import Box

TARGET = TargetChoice((Box(70.0, 60.0, 20.0, 16.0),))


@pytest.fixture(scope="module")
def pictures(small_flight: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clip")
    for frame in small_flight.frames[:30]:
        cv2.imwrite(str(folder / f"{frame.sequence:04}.png"), frame.image)
    return folder


@pytest.mark.slow
def test_a_recorded_run_is_a_flight_and_replays_bit_for_bit(
    pictures: Path, small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = load_settings(overrides=["recorder.video=lossless"])
    files = TrackFiles(tmp_path, video=False, record=True)
    assert track(settings, TARGET, VideoInput(str(pictures), rate_hz=20.0), files) == 0
    (folder,) = tmp_path.iterdir()
    assert "flight.mcap" in capsys.readouterr().out
    flight = open_flight(folder)
    assert len(flight.log.tracks) == 30
    assert flight.log.controls
    assert flight.selections[0].box == Box(70.0, 60.0, 20.0, 16.0)
    assert not flight.config.needs_telemetry
    images = [picture.image for picture in flight.pictures()]
    assert all(
        np.array_equal(a, b.image) for a, b in zip(images, small_flight.frames[:30], strict=True)
    )
    assert replay_flight(folder, out=tmp_path / "runs") == SAME
    assert "identical to the flight, bit for bit" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_without_the_option_nothing_is_recorded(pictures: Path, tmp_path: Path) -> None:
    assert track(Settings(), TARGET, VideoInput(str(pictures)), TrackFiles(tmp_path)) == 0
    (folder,) = tmp_path.iterdir()
    assert not (folder / "flight.mcap").exists()
