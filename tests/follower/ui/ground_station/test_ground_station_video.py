"""What a pilot has on the screen: our video by RTP, and on it the box that is told by MAVLink."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.vision.video_sink import SeveralVideos
from follower.settings.settings import load_settings
from follower.settings.ui import GroundStationSettings
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.ui.cockpit.start import open_station
from follower.ui.ground_station.flight_view import CameraOptics
from follower.ui.ground_station.server import GroundStation
from follower_control.common.transport import MemoryTransport, Transport
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.selection import colour_from_hex, find_by_colour
from follower_vision.trackers.track import Track

pytestmark = pytest.mark.slow

WIDTH, HEIGHT, RATE_HZ = 480, 360, 12
RED = "#e0401c"
PARAMETERS_S, SELECT_S, END_S = 3.0, 9.0, 12.5
SHOWS_WITHIN_S, SETTLES_S, PATIENCE_S = 0.1, 0.5, 30.0
SCENARIO = {
    "name": "test",
    "title": "Two cars.",
    "duration_s": END_S + 1,
    "seed": 4,
    "targets": [
        {
            "kind": "car",
            "colour": RED,
            "path": {
                "points": [[0, 0], [60, 0]],
                "speeds": [{"at_s": SELECT_S, "speed_m_s": 2.0, "acceleration_m_s2": 1.0}],
            },
        },
        {"kind": "car", "colour": "#2050d0", "path": {"points": [[6, 7], [7, 7]]}},
    ],
    "ground": {"roads": [{"points": [[-60, 0], [200, 0]], "width_m": 6}]},
    "camera": {
        "width": WIDTH,
        "height": HEIGHT,
        "fov_deg": 75,
        "pitch_deg": -16,
        "rate_hz": RATE_HZ,
    },
    "start": {"at": [-18, 0], "heading_deg": 0},
    "takeoff_height_m": 8,
    "select": {"colour": RED},
    "follow": {"servo": {"distance_m": 15.0, "target_size_m": 2.2, "elevation_deg": -25}},
}


class Screen:
    """Takes RTP as QGroundControl does at its UDP port, and keeps the newest picture."""

    def __init__(self, folder: Path, port: int) -> None:
        self.port = port
        self._sdp = folder / "stream.sdp"
        self._sdp.write_text(
            f"v=0\nc=IN IP4 127.0.0.1\nm=video {self.port} RTP/AVP 96\na=rtpmap:96 H264/90000\n"
        )
        self.pictures = 0
        self._newest: Image | None = None
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def picture(self) -> Image:
        """What is on the screen once all has come that is on its way."""
        end_s, seen = time.monotonic() + PATIENCE_S, -1
        while self._newest is None or self.pictures != seen:
            assert time.monotonic() < end_s, "no picture"
            seen = self.pictures
            time.sleep(SETTLES_S)
        return self._newest

    def _watch(self) -> None:
        options = {"protocol_whitelist": "file,udp,rtp", "fflags": "nobuffer", "flags": "low_delay"}
        # A stream that has ended is told of by a time-out, long after the test.
        with (
            suppress(av.FFmpegError),
            av.open(str(self._sdp), options={**options, "probesize": "2048"}) as container,
        ):
            container.streams.video[0].codec_context.thread_count = 1
            for frame in container.decode(video=0):
                self._newest = np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
                self.pictures += 1


class Pilot:
    """Draws a box onto the received video, as QGroundControl sends it, and lists parameters."""

    def __init__(self, folder: Path, share: Callable[..., Transport], port: int) -> None:
        scenario, self._clock = Scenario.model_validate(SCENARIO), SimulatedClock()
        ours, autopilot = MemoryTransport.pair()
        near, self._far = MemoryTransport.pair()
        self.screen = Screen(folder, port)
        wanted = (f"video.udp=127.0.0.1:{self.screen.port}", "video.overlay=false")
        settings = load_settings(None, base_settings(scenario), wanted)
        station = open_station(settings, False, {}, folder, print)
        assert station is not None
        self._codec = mavlink.MAVLink(None, 255, 190)
        self._codec.robust_parsing = True
        self.heard: list[Any] = []
        self.drawn: Box | None = None
        self._script = self._hands()
        with station:
            ends = share(ours, near), autopilot
            videos = SeveralVideos((self, station))
            world = World(scenario)
            shown = FlightOptions(video=videos)
            self.flight = SimulatedFlight(world, settings, "px4", self._clock, ends, shown)
            self.flight.operate()
            ground = GroundStationSettings(enabled=True)
            lens = CameraOptics(75.0, RATE_HZ)
            self._ground = GroundStation(ground, self.flight.view, lens, self._clock)
            fly_lockstep(self.flight, self._clock, self._each)
        self.flight.close()

    def add(self, frame: Frame, _tracks: Sequence[Track], _lines: Sequence[str]) -> None:
        """Give the screen time to show one more: the flight's clock does not wait for the video."""
        del frame
        end_s, seen = time.monotonic() + SHOWS_WITHIN_S, self.screen.pictures
        while self.screen.pictures == seen and time.monotonic() < end_s:
            time.sleep(0.005)

    def _each(self) -> None:
        next(self._script, None)
        self._ground.step(self._clock.now())
        self.heard += self._codec.parse_buffer(bytearray(self._far.receive())) or ()

    def _hands(self) -> Iterator[None]:
        while self._clock.now() < PARAMETERS_S:
            yield
        self._send(mavlink.MAVLink_param_request_list_message(1, 191))
        while self._clock.now() < SELECT_S:
            yield
        self.drawn = car_in(self.screen.picture)
        box = self.drawn
        corners = box.left / WIDTH, box.top / HEIGHT, box.right / WIDTH, box.bottom / HEIGHT
        self._command(mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE, *corners)
        self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 275, 66_000)
        while self._clock.now() < END_S:
            yield
        self.last_picture = self.screen.picture
        self.last_state = self.flight.log.controls[-1].state
        self.told_box = self._told_box()
        self.flight.stop()

    def _command(self, number: int, *params: float) -> None:
        padded = (*params, *([0.0] * (7 - len(params))))
        self._send(mavlink.MAVLink_command_long_message(1, 100, number, 0, *padded))

    def _send(self, message: Any) -> None:
        self._far.send(message.pack(self._codec))

    def of(self, name: str) -> list[Any]:
        return [one for one in self.heard if one.get_type() == name]

    def _told_box(self) -> Box:
        """Return the newest box by MAVLink, in pixels of the video."""
        one = self.of("CAMERA_TRACKING_IMAGE_STATUS")[-1]
        assert one.tracking_status == mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE
        left, top = one.rec_top_x * WIDTH, one.rec_top_y * HEIGHT
        right, bottom = one.rec_bottom_x * WIDTH, one.rec_bottom_y * HEIGHT
        return Box.from_xywh(left, top, right - left, bottom - top)


def car_in(image: Image) -> Box:
    """Return where the red car is, as a person would draw around it."""
    return find_by_colour(image, colour_from_hex(RED))[0]


@pytest.fixture(scope="module")
def pilot(
    tmp_path_factory: pytest.TempPathFactory,
    share: Callable[..., Transport],
    free_port: Callable[[], int],
) -> Pilot:
    return Pilot(tmp_path_factory.mktemp("pilot"), share, free_port())


def test_what_was_drawn_on_the_received_video_is_followed(pilot: Pilot) -> None:
    assert pilot.last_state is SupervisorState.FOLLOWING
    assert pilot.screen.pictures > 50
    (ack, *_) = pilot.of("COMMAND_ACK")
    assert ack.command == mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED


def test_the_box_that_is_told_lies_on_the_target_in_the_video(pilot: Pilot) -> None:
    assert pilot.told_box.iou(car_in(pilot.last_picture)) > 0.4


def test_all_parameters_are_listed(pilot: Pilot) -> None:
    found = parameters(pilot)
    counts = {one.param_count for one in pilot.of("PARAM_VALUE") if one.get_srcComponent() == 191}
    assert counts == {len(found)}
    assert found["SRV_DIST"] == 15.0
    wanted = os.environ.get("FOLLOWER_PICTURES")  # `docs/pictures`, for the guides
    if wanted:
        draw(pilot, Path(wanted) / "ground-station.jpg")


def parameters(pilot: Pilot) -> dict[str, float]:
    values = [one for one in pilot.of("PARAM_VALUE") if one.get_srcComponent() == 191]
    return {one.param_id: one.param_value for one in values}


def draw(pilot: Pilot, path: Path) -> None:
    """Draw what the test's ground station has: video, the box that was told, parameters."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    figure = Figure(figsize=(9.6, 4.35), facecolor="#222428")
    video = figure.add_axes((0.0, 0.0, 0.61, 0.93))
    video.imshow(pilot.last_picture[..., ::-1], aspect="auto")
    video.set_axis_off()
    box = pilot.told_box
    corner = box.left, box.top
    video.add_patch(Rectangle(corner, box.width, box.height, fill=False, ec="#00e04b", lw=1.8))
    words = {"color": "#e8edf1", "family": "monospace", "va": "center"}
    figure.text(0.01, 0.965, "video by RTP, and the box of CAMERA_TRACKING_IMAGE_STATUS", **words)
    figure.text(0.63, 0.965, "PARAM_VALUE, component 191", **words)
    found = sorted(parameters(pilot).items())
    shown = [one for one in found if one[0].startswith(("SRV", "ENV_M", "ENV_C"))][:40]
    for number, (name, value) in enumerate(shown):
        x, y = 0.63 + 0.19 * (number // 20), 0.9 - 0.045 * (number % 20)
        figure.text(x, y, f"{name:<14}{value:>6.4g}", fontsize=7.5, **words)
    figure.savefig(path, dpi=100, pil_kwargs={"quality": 82})
