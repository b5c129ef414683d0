"""`follower preflight` against simulated autopilots over real UDP, by both links."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from follower.apps.command_settings import command_settings, lens_is_given
from follower.apps.preflight import session as observation
from follower.apps.preflight.computer_checks import (
    free_bytes,
    load_per_core,
    read_computer,
    temperature_c,
    throttled,
)
from follower.apps.preflight.session import CheckScope, preflight
from follower.apps.video_input import VideoInput
from follower.settings.settings import load_settings

BASE = ("camera.fov_deg=70", "link.vehicle_id=1")
MakeVehicle = Callable[..., Any]
Run = Callable[..., dict[str, Any]]


@pytest.fixture
def run(port: int, video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the checks; return what --json says, with the exit code."""

    def run_it(*overrides: str, seconds: float = 4.5, **options: Any) -> dict[str, Any]:
        set_by_hand = overrides or BASE
        settings = command_settings(
            options.get("config"),
            set_by_hand,
            link=options.get("link"),
            detector=options.get("detector"),
        )
        scope = CheckScope(
            frozenset(options.get("skip", ())),
            options.get("out", tmp_path),
            lens_is_given(overrides=set_by_hand),
            seconds,
        )
        camera = VideoInput(options.get("camera", str(video)), realtime=True)
        code = preflight(settings, camera, f"udpin:127.0.0.1:{port}", scope, as_json=True)
        content = json.loads(capsys.readouterr().out)
        verdicts = {check["name"]: check["verdict"] for check in content["checks"]}
        whys = {check["name"]: check["why"] for check in content["checks"]}
        return {**content, "code": code, "verdicts": verdicts, "whys": whys}

    return run_it


def refusing(content: dict[str, Any]) -> set[str]:
    return {check["name"] for check in content["checks"] if check["refuses"]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "link"),
    [
        ("px4", "pymavlink"),
        ("ardupilot", "mavsdk"),
        pytest.param("px4", "mavsdk", marks=pytest.mark.slow),
        pytest.param("ardupilot", "pymavlink", marks=pytest.mark.slow),
    ],
)
def test_a_healthy_vehicle_is_ready(
    vehicle: MakeVehicle, run: Run, flavour: str, link: str
) -> None:
    there = vehicle(flavour)
    content = run(link=link, seconds=8.0)
    assert refusing(content) == set()
    assert (content["code"], content["ready"]) == (0, True)
    assert (content["vehicle_id"], content["autopilot"]) == (1, flavour)
    name, value = ("COM_OBL_RC_ACT", 0) if flavour == "px4" else ("FS_OPTIONS", 16)
    assert content["parameters"][name] == value
    assert content["camera"]["interval_s"] == pytest.approx(1 / 30, abs=0.01)
    assert there.setpoints == []
    assert not there.autopilot.armed


@pytest.mark.slow
def test_the_checklist_that_people_see_ends_with_ready(
    vehicle: MakeVehicle,
    port: int,
    video: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    keep_terminal: Callable[[Console, str, str], None],
) -> None:
    console = Console(record=True, width=100, file=io.StringIO())
    monkeypatch.setattr("follower.apps.preflight.session.Console", lambda: console)
    monkeypatch.setattr("follower.apps.preflight.computer_checks.load_per_core", lambda: 0.4)
    monkeypatch.chdir(tmp_path)
    Path("camera.mp4").symlink_to(video)
    vehicle("px4")
    scope = CheckScope(frozenset(), Path("runs"), lens_given=True, longest_s=8.0)
    camera = VideoInput("camera.mp4", realtime=True)
    settings = command_settings(overrides=BASE)
    assert preflight(settings, camera, f"udpin:127.0.0.1:{port}", scope) == 0
    shown = console.export_text(clear=False)
    assert shown.rstrip().splitlines()[-1].startswith("Ready")
    assert "→" in shown, "a warning says what to do"
    keep_terminal(console, "follower preflight", "preflight")


@pytest.mark.slow
def test_what_is_wrong_with_the_vehicle_is_told_each_for_its_reason(
    vehicle: MakeVehicle, run: Run
) -> None:
    autopilot = vehicle("px4").autopilot
    autopilot.parameters["COM_OBL_RC_ACT"] = 7.0
    autopilot.parameters["MPC_ACC_HOR"] = 1.0
    del autopilot.parameters["COM_RC_IN_MODE"]
    autopilot.health.estimates = 0xA7
    autopilot.health.fix_type = 1
    autopilot.health.unhealthy = 1
    autopilot.health.battery_percent = 7
    autopilot.faults.attitude_frozen = True
    content = run()
    assert content["code"] == 1
    assert refusing(content) == {
        *("COM_OBL_RC_ACT", "MPC_ACC_HOR", "COM_RC_IN_MODE"),
        *("estimator", "gps", "sensors", "battery", "attitude-age"),
    }
    assert content["verdicts"]["COM_RC_IN_MODE"] == "unknown"
    assert "motors stop" in content["whys"]["COM_OBL_RC_ACT"]
    assert "repeats itself" in content["whys"]["attitude-age"]


@pytest.mark.slow
def test_a_camera_and_a_lens_that_cannot_be_used(vehicle: MakeVehicle, run: Run) -> None:
    vehicle("ardupilot")
    wrong = run("link.vehicle_id=1", "camera.frame_size=[640, 480]", seconds=3.0)
    assert {"frame-size", "lens"} <= refusing(wrong)
    assert "frames are 320x240" in wrong["whys"]["frame-size"]


@pytest.mark.slow
def test_no_camera_no_autopilot_and_no_room(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = SimpleNamespace(total=1, used=1, free=1000)
    monkeypatch.setattr(
        "follower.apps.preflight.computer_checks.shutil.disk_usage", lambda _: usage
    )
    content = run(camera="/nowhere/clip.mp4", seconds=1.0)
    assert {"vehicle", "camera", "disk"} <= refusing(content)
    assert "/nowhere/clip.mp4" in content["whys"]["camera"]
    assert "no heartbeat" in content["whys"]["vehicle"]
    assert content["whys"]["disk"].startswith("0.0 GB")


@pytest.mark.slow
def test_two_vehicles_are_not_guessed_among(vehicle: MakeVehicle, run: Run) -> None:
    vehicle("px4")
    vehicle("ardupilot").autopilot._link._codec.srcSystem = 2
    content = run("camera.fov_deg=70", seconds=3.0)
    assert "several vehicles send heartbeats: 1 (px4), 2 (ardupilot)" in content["whys"]["vehicle"]
    assert "vehicle" in refusing(content)


@pytest.mark.slow
def test_what_is_skipped_does_not_refuse(vehicle: MakeVehicle, run: Run) -> None:
    there = vehicle("px4")
    there.autopilot.parameters["COM_OBL_RC_ACT"] = 7.0
    content = run(skip=("COM_OBL_RC_ACT",))
    assert content["code"] == 0
    assert content["verdicts"]["COM_OBL_RC_ACT"] == "fail"


def test_a_computer_is_read_where_it_tells(tmp_path: Path) -> None:
    zone = tmp_path / "sys/class/thermal/thermal_zone0"
    zone.mkdir(parents=True)
    (zone / "temp").write_text("61234\n")
    flags = tmp_path / "sys/devices/platform/soc/soc:firmware"
    flags.mkdir(parents=True)
    (flags / "get_throttled").write_text("50005\n")
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/loadavg").write_text("1.50 1.0 0.5 2/300 4000\n")
    assert temperature_c(tmp_path) == pytest.approx(61.234)
    assert throttled(tmp_path) == 0x50005
    assert load_per_core(tmp_path) == pytest.approx(1.5 / (os.cpu_count() or 1))
    empty = tmp_path / "empty"
    assert (temperature_c(empty), throttled(empty), load_per_core(empty)) == (
        None,
        None,
        None,
    )
    assert (free_bytes(tmp_path / "not" / "made" / "yet") or 0) > 0


def test_where_no_recording_can_be_made_is_told_before_the_flight(tmp_path: Path) -> None:
    assert read_computer(tmp_path / "not" / "made" / "yet").writable
    (tmp_path / "file").touch()
    assert not read_computer(tmp_path / "file" / "runs").writable


def test_networks_that_are_missing_or_wrong_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path))
    (tmp_path / "yolox_nano_bi.onnx").write_bytes(b"no network")
    settings = load_settings(overrides=["tracker=nanotrack-v3", "detector=yolox-nano"])
    states = observation.model_states(settings)
    assert states == {
        "nanotrackv3_backbone.onnx": "missing",
        "nanotrackv3_head.onnx": "missing",
        "yolox_nano_bi.onnx": "wrong",
    }
    own = load_settings(overrides=[f"detector={tmp_path}/own.onnx"])
    assert observation.model_states(own) == {"own.onnx": "missing"}
    assert observation.model_states(load_settings()) == {}
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.onnx").touch()
    at_home = load_settings(overrides=["detector=~/mine.onnx"])
    assert observation.model_states(at_home) == {"mine.onnx": "good"}
