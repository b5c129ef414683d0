"""MAVSDK as an independent ground station: its camera and parameter plugins against ours."""

import ctypes
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.camera import Camera, CameraError
from mavsdk.plugins.param import Param, ParamError, ProtocolVersion
from waiting import until

from follower.flight.target.request import BoxSelection, ClearSelection, PointSelection
from follower.ui.ground_station.parameters import parameters

pytestmark = pytest.mark.slow

MakeRig = Callable[..., Any]
_ANSWERS_WITHIN_S = 2.0
_PATIENCE_S = 120.0  # MAVSDK asks for a stream's description after 20 s


@contextmanager
def in_real_time(rig: Any) -> Iterator[None]:
    """Let the follower's side run on a thread, its clock as fast as MAVSDK's.

    A rig that a busy computer holds up catches up: MAVSDK gives up what beats no heart for 3 s.
    """
    stop = threading.Event()
    ahead_s = rig.now_s - time.monotonic()

    def run() -> None:
        while not stop.wait(0.02):
            rig.run(time.monotonic() + ahead_s - rig.now_s)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def be_patient(mavsdk: Mavsdk) -> None:
    """Have MAVSDK wait longer for answers: after 0.5 s it would repeat a question.

    The answer to a repeated question is then taken for the next one's. Nothing is lost on
    loopback: what comes late is a busy computer's. MAVSDK 4.1 has this in C, and not in Python.
    """
    handle = ctypes.c_void_p(mavsdk._handle)
    mavsdk._lib.mavsdk_set_timeout_s(handle, ctypes.c_double(_ANSWERS_WITHIN_S))


@pytest.fixture
def system(make_rig: MakeRig) -> Iterator[tuple[Any, Any]]:
    """Return the rig, and our vehicle as MAVSDK sees it."""
    rig = make_rig(video_uri="rtsp://10.0.0.5:8554/live")
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        with in_real_time(rig):
            be_patient(mavsdk)
            mavsdk.add_any_connection(f"udpout://127.0.0.1:{rig.port}")
            found = until(
                lambda: [one for one in mavsdk.get_systems() if one.has_camera()], _PATIENCE_S
            )
            yield rig, found[0]
    finally:
        mavsdk.destroy()


def test_mavsdk_finds_the_camera_and_tracks_with_it(system: tuple[Any, Any]) -> None:
    rig, vehicle = system
    camera = Camera(vehicle)
    (found,) = until(lambda: camera.camera_list().cameras, _PATIENCE_S)
    assert (found.component_id, found.vendor_name) == (100, "follower")
    assert (found.horizontal_resolution_px, found.vertical_resolution_px) == (640, 480)
    camera.track_rectangle(100, 0.25, 0.5, 0.5, 0.75)
    assert rig.requests.take_target().selection == BoxSelection(0.25, 0.5, 0.5, 0.75)
    camera.track_point(100, 0.5, 0.25, 0.05)
    assert rig.requests.take_target().selection == PointSelection(0.5, 0.25)
    with pytest.raises(CameraError, match="DENIED"):
        camera.track_rectangle(100, -0.5, -0.5, -0.2, -0.2)
    assert rig.requests.take_target() is None
    camera.track_stop(100)
    assert rig.requests.take_target().selection == ClearSelection()
    stream = until(lambda: _stream(camera), _PATIENCE_S)
    assert stream.settings.uri == "rtsp://10.0.0.5:8554/live"


def _stream(camera: Any) -> Any:
    """Return the stream's description once MAVSDK has fetched it."""
    try:
        stream = camera.get_video_stream_info(100)
    except CameraError:
        return None
    return stream if stream.settings.uri else None


def test_mavsdk_reads_and_sets_our_parameters(system: tuple[Any, Any]) -> None:
    rig, vehicle = system
    parameter = Param(vehicle)
    with suppress(ParamError):  # MAVSDK 4.1 selects it, and says that it does not know whether
        parameter.select_component(191, ProtocolVersion.V1)
    assert parameter.get_param_float("SRV_DIST") == 15.0
    parameter.set_param_float("SRV_DIST", 12.5)
    assert rig.requests.settings.servo.distance_m == 12.5
    with pytest.raises(Exception, match="set_param_float"):
        parameter.set_param_float("SRV_DIST", -3.0)
    everything = until(lambda: parameter.get_all_params().float_params, _PATIENCE_S)
    assert {one.name for one in everything} == {one.name for one in parameters()}
