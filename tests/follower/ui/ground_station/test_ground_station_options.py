"""What the settings make of the ground station's side of a flight."""

from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from follower.apps.main import app
from follower.links.connections import ConnectionFailedError
from follower.settings.settings import Settings, load_settings
from follower.settings.ui import GroundStationSettings
from follower.ui.ground_station import camera_messages as say
from follower.ui.ground_station.server import _with_stream, lens_of, operators_finder
from follower.ui.video.h264_encoder import fitted
from follower_control.common.strict_config import SettingsError

ON = "ground_station.enabled=true"


def test_a_flight_needs_no_target_that_a_ground_station_will_choose() -> None:
    arguments = ["fly", "--connect", "udpin:127.0.0.1:1x", "--camera", "0"]
    with pytest.raises(ConnectionFailedError, match="1x"):
        CliRunner().invoke(app, [*arguments, "--set", ON], catch_exceptions=False)
    with pytest.raises(SettingsError, match=r"ground_station\.enabled"):
        CliRunner().invoke(app, arguments, catch_exceptions=False)


def test_it_is_off_unless_asked_for() -> None:
    assert not Settings().ground_station.enabled
    assert operators_finder(Settings(), cockpit=False) is None
    assert operators_finder(Settings(), cockpit=True) is not None
    assert operators_finder(load_settings(overrides=[ON]), cockpit=False) is not None


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({}, ""),
        ({"video": {"rtsp": "192.168.1.5:8554"}}, "rtsp://192.168.1.5:8554/live"),
        ({"video": {"rtsp": "0.0.0.0:8554"}}, ""),
        ({"video": {"udp": "192.168.1.20:5600"}}, "udp://0.0.0.0:5600"),
        (
            {"video": {"udp": "10.0.0.2:5600"}, "ground_station": {"video_uri": "rtsp://a/b"}},
            "rtsp://a/b",
        ),
    ],
)
def test_our_own_video_is_told_of_where_its_address_is_known(
    settings: dict[str, Any], told: str
) -> None:
    assert _with_stream(load_settings(base=settings)).video_uri == told


@pytest.mark.parametrize(
    ("video", "size", "told"),
    [
        ({}, (1920, 1080), (None, 0)),
        ({"udp": "10.0.0.2:5600"}, (1920, 1080), ((1280, 720), 2_000_000)),
        ({"rtsp": "10.0.0.2:8554", "bitrate_kbit_s": 500}, (641, 481), ((640, 480), 500_000)),
    ],
)
def test_the_stream_is_told_as_it_is_sent(
    video: dict[str, Any], size: tuple[int, int], told: tuple[Any, int]
) -> None:
    lens = lens_of(load_settings(base={"video": video}), size, 30.0)
    assert (lens.stream_size, lens.bitrate_bit_s) == told
    information = say.video_stream_information(GroundStationSettings(), size, lens)
    sent = told[0] or size
    assert (information.resolution_h, information.resolution_v) == sent
    assert information.bitrate == told[1]
    image = np.zeros((size[1], size[0], 3), np.uint8)
    if told[0] is not None:
        assert fitted(image, 1280).shape[:2] == sent[::-1]
