"""What the page is told: settings with their ranges, moments, numbered objects; and the pace."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cockpit_client import PATIENCE_S

from follower.flight.lockstep import Pacer
from follower.flight.log import FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.status import LiveStatus
from follower.flight.target.request import RequestRefusedError
from follower.settings.settings import Settings
from follower.ui.cockpit import mjpeg
from follower.ui.cockpit.detections import Objects, objects_in
from follower.ui.cockpit.mjpeg import JpegStream, MjpegResponse
from follower.ui.cockpit.publisher import (
    PeriodicPublisher,
    setting_list,
    setting_values,
    state_message,
)
from follower.ui.cockpit.recordings_api import RecordingFolder
from follower.ui.video.channel import Picture
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.clock import MonotonicClock, SimulatedClock
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.onnx_network import ModelError

FRAME = Frame(np.zeros((100, 200, 3), np.uint8), 1.0, 5)


class TwoCars:
    """Sees two cars, one of them in the middle."""

    class_names = ("car",)

    def detect(self, image: Any, region: Box | None = None) -> list[Detection]:
        del image, region
        return [
            Detection(Box(20, 20, 60, 20), 0, "car", 0.9),
            Detection(Box(100, 50, 20, 10), 0, "car", 0.8),
        ]


def test_objects_are_numbered_from_the_middle_with_boxes_inside_the_image() -> None:
    first, second = objects_in(FRAME, TwoCars())
    assert (first["number"], first["name"]) == (1, "car:1")
    assert first["box"] == pytest.approx([0.45, 0.45, 0.55, 0.55])
    assert second["name"] == "car:2"
    assert second["box"] == pytest.approx([0.0, 0.1, 0.25, 0.3])
    json.dumps([first, second])


def test_the_detector_is_made_when_somebody_wants_to_see_objects() -> None:
    made, shown = list[bool](), threading.Event()

    def make() -> TwoCars:
        made.append(True)
        return TwoCars()

    objects = Objects(make, lambda: FRAME, lambda _: shown.set(), print, MonotonicClock())
    assert not shown.wait(0.1)
    assert not made
    objects.want("me", True)
    assert shown.wait(PATIENCE_S)
    objects.want("me", False)


def test_a_missing_network_is_said() -> None:
    said, told = list[str](), threading.Event()

    def make() -> TwoCars:
        raise ModelError("no such network")

    def say(text: str) -> None:
        said.append(text)
        told.set()

    Objects(make, lambda: FRAME, print, say, MonotonicClock()).want("me", True)
    assert told.wait(PATIENCE_S)
    assert "no such network" in said[0]


def test_numbers_do_not_outlive_their_detector(monkeypatch: pytest.MonkeyPatch) -> None:
    shown, said, ended = list[Any](), list[str](), threading.Event()
    monkeypatch.setattr(threading, "excepthook", lambda _: ended.set())
    monkeypatch.setattr(TwoCars, "detect", lambda *_: 1 / 0)
    Objects(TwoCars, lambda: FRAME, shown.append, said.append, MonotonicClock()).want("me", True)
    assert ended.wait(PATIENCE_S)
    assert shown == [[]]
    assert "any more" in said[0]


def test_every_setting_has_a_range_that_holds_its_value_and_a_meaning() -> None:
    entries = setting_list(Settings())
    assert [entry["key"] for entry in entries] == list(setting_values(Settings()))
    for entry in entries:
        if "low" in entry:
            assert entry["low"] <= entry["value"] <= entry["high"]
        if entry["type"] == "choice":
            assert entry["value"] in entry["choices"]
    about = {entry["key"]: entry["about"] for entry in entries}
    assert about["servo.distance_m"] == "wanted distance to the target."
    assert all(about.values()), [key for key, text in about.items() if not text]


def test_the_limits_sliders_only_tighten() -> None:
    requests = OperatorRequests(Settings())
    for entry in setting_list(Settings()):
        if entry["key"].startswith(("envelope.", "supervisor.")) and entry["value"] is not None:
            loose = entry["low"] if "min_" in entry["key"] else entry["high"]
            assert loose == entry["value"]
            beyond = loose - 0.5 if "min_" in entry["key"] else loose + 0.5
            with pytest.raises(RequestRefusedError):
                requests.change(entry["key"], beyond, "a test")


def test_a_moment_has_no_number_that_json_does_not_know() -> None:
    bad = LiveStatus(
        1.0,
        azimuth_error_rad=math.nan,
        range_m=math.inf,
        asked=VelocitySetpoint(math.nan, 0, 0, 0),
        allowed=VelocitySetpoint(1.0, 2.0, 3.0, math.pi),
    )
    found = state_message(bad, None)
    json.dumps(found, allow_nan=False)
    assert found["azimuth_deg"] is None
    assert found["asked"] is None
    assert found["allowed"] == [1.0, 2.0, 3.0, 180.0]
    json.dumps(state_message(LiveStatus.of(FlightLog(), 0.0), None), allow_nan=False)


def test_the_page_is_told_by_a_thread_of_its_own_until_it_is_closed() -> None:
    told = threading.Semaphore(0)
    with PeriodicPublisher(told.release):
        assert all(told.acquire(timeout=PATIENCE_S) for _ in range(3))
    while told.acquire(blocking=False):
        pass
    assert not told.acquire(timeout=0.3)


def test_who_takes_no_pictures_loses_his_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjpeg, "_STUCK_S", 0.05)

    async def run() -> tuple[int, int]:
        stream = JpegStream(asyncio.get_running_loop())
        taken: list[Any] = []

        async def send(event: Any) -> None:
            taken.append(event)
            if len(taken) > 2:
                await asyncio.Event().wait()

        response = MjpegResponse(stream.parts())
        task = asyncio.create_task(response.stream_response(send))
        for number in range(1, 20):
            await asyncio.sleep(0.02)
            stream.show(Picture(FRAME.image, number, float(number)))
        await asyncio.wait_for(task, PATIENCE_S)
        await asyncio.sleep(0.02)
        return len(taken), stream._readers

    assert asyncio.run(run()) == (3, 0)


def test_a_recording_that_is_removed_while_one_looks_does_not_hide_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = [tmp_path / name / "flight.mcap" for name in ("here", "gone")]
    for log in logs:
        log.parent.mkdir()
        log.write_bytes(b"log")
    logs[1].unlink()
    monkeypatch.setattr(Path, "glob", lambda *_: logs)
    assert [flight.name for flight in RecordingFolder(tmp_path).listed()] == ["here"]


def test_simulated_time_waits_for_real_time_and_does_not_catch_up() -> None:
    simulated, real = SimulatedClock(), SimulatedClock(100.0)
    pace = Pacer(simulated, real)
    simulated.sleep_until(1.0)
    pace.wait()
    assert real.now() == 101.0
    real.sleep_until(110.0)
    pace.wait()
    simulated.sleep_until(2.0)
    pace.wait()
    assert real.now() == 111.0
