"""`follower.Pursuit` over a real UDP link, flown by the project's own simulated autopilot."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flying_vehicle import PATIENT, Vehicle, flying_vehicle, write_square
from promises import LateS, assert_releases
from waiting import until

import follower

pytestmark = pytest.mark.slow

HEIGHT_M = 12.0
SETTINGS = (
    *("camera.fov_deg=70", "camera.pitch_deg=-20"),
    *("link.vehicle_id=1", "servo.max_forward_m_s=2", *PATIENT),
)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_square(tmp_path_factory.mktemp("camera") / "square.mp4", 60)


@pytest.fixture
def there(port: int) -> Iterator[Vehicle]:
    with flying_vehicle("px4", port, HEIGHT_M) as vehicle:
        yield vehicle


@pytest.fixture
def pursuit(port: int, video: Path, tmp_path: Path) -> follower.Pursuit:
    return follower.Pursuit(
        f"udpin:127.0.0.1:{port}", camera=video, overrides=SETTINGS, out=tmp_path / "runs"
    )


def follow(there: Vehicle, pursuit: follower.Pursuit) -> None:
    """Have the pilot switch the mode, and wait until the vehicle turns to the target."""
    assert pursuit.wait("ready", 90)
    until(lambda: there.autopilot.switch_mode(there.setpoint_mode))
    assert pursuit.wait("following", 90)
    until(lambda: there.turns)


def assert_holds_and_is_released(
    there: Vehicle, late_s: LateS, asked_s: float, how: str = "stop-requested"
) -> None:
    assert not any(thread.name == "pursuit" for thread in threading.enumerate())
    ended_s = there.clock.now()
    assert_releases(lambda: there.evidence, how, asked_s, lambda: 0.2 + late_s(), ended_s)


def test_it_follows_once_the_pilot_consents_and_prints_nothing(
    there: Vehicle, pursuit: follower.Pursuit, late_s: LateS, capfd: pytest.CaptureFixture[str]
) -> None:
    with pursuit:
        pursuit.select("#d02020")
        assert pursuit.wait("ready", 90)
        time.sleep(1.5)
        assert all(s.is_zero for s in there.setpoints)
        assert there.autopilot.mode == "LOITER"
        assert pursuit.status.phase == "pilot: switch to OFFBOARD, and it follows"
        follow(there, pursuit)
        track = next(pursuit.tracks())
        assert track.state == "tracking"
        assert track.box.distance(follower.Box(210, 120, 40, 40)) < 15
        assert pursuit.track is not None
        stopped_s = there.clock.now()
        pursuit.stop()
        assert pursuit.wait(timeout_s=60)
        assert list(pursuit.tracks()) == []
    assert_holds_and_is_released(there, late_s, stopped_s)
    assert pursuit.end.sentence == "Ended as asked"
    assert capfd.readouterr() == ("", "")
    flight = follower.open_flight(pursuit.folder)
    assert set(flight.arrays()["controls"]["state"]) >= {"ready", "following", "released"}
    assert (pursuit.folder / "preflight.json").is_file()


def test_an_exception_in_the_block_leaves_the_vehicle_holding_and_released(
    there: Vehicle, pursuit: follower.Pursuit, late_s: LateS
) -> None:
    failed_s = 0.0

    def fail_in_the_block() -> None:
        nonlocal failed_s
        with pursuit:
            pursuit.select(follower.Box.from_xywh(190, 100, 40, 40))
            follow(there, pursuit)
            failed_s = there.clock.now()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_in_the_block()
    assert there.autopilot.mode == "OFFBOARD"
    assert_holds_and_is_released(there, late_s, failed_s)
    with pytest.raises(RuntimeError, match="flies once"), pursuit:
        pass


PROGRAM = """
import sys, follower
pursuit = follower.Pursuit({connect!r}, camera={camera!r}, target="#d02020", overrides={settings!r})
{how}
"""
FOLLOWING = "pursuit.wait('following'), print('on', flush=True)"
IN_BLOCK = f"with pursuit:\n    {FOLLOWING}\n    pursuit.wait()"
NEVER_LEFT = f"pursuit.__enter__()\n{FOLLOWING}\nsys.stdin.read()"


@pytest.mark.parametrize(
    ("how", "ended_by", "fault"),
    [
        pytest.param(IN_BLOCK, signal.SIGINT, "process-interrupted", id="Ctrl-C"),
        pytest.param(IN_BLOCK, signal.SIGTERM, "process-terminated", id="SIGTERM"),
        pytest.param(NEVER_LEFT, None, "stop-requested", id="the program's end"),
    ],
)
def test_however_the_program_ends_the_vehicle_holds_and_is_released(
    there: Vehicle,
    port: int,
    video: Path,
    tmp_path: Path,
    late_s: LateS,
    how: str,
    ended_by: int | None,
    fault: str,
) -> None:
    connect = f"udpin:127.0.0.1:{port}"
    code = PROGRAM.format(connect=connect, camera=str(video), settings=SETTINGS, how=how)
    program = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=tmp_path,
        env=os.environ,
    )
    try:
        until(lambda: there.autopilot.switch_mode(there.setpoint_mode))
        assert program.stdout.readline() == b"on\n"
        until(lambda: there.turns)
        asked_s = there.clock.now()
        if ended_by is not None:
            program.send_signal(ended_by)
        program.communicate(timeout=90)
    finally:
        program.kill()
        program.communicate()
    assert_holds_and_is_released(there, late_s, asked_s, fault)


def test_a_check_that_fails_refuses_the_flight_and_leaves_nothing_behind(
    there: Vehicle, pursuit: follower.Pursuit, tmp_path: Path
) -> None:
    before = signal.getsignal(signal.SIGINT)
    there.autopilot.parameters["COM_OBL_RC_ACT"] = 6.0
    with pytest.raises(follower.PreflightError, match="COM_OBL_RC_ACT: 6: termination") as refused:
        pursuit.__enter__()
    assert [one.check.name for one in refused.value.failed] == ["COM_OBL_RC_ACT"]
    assert not (tmp_path / "runs").exists()
    assert there.setpoints == []
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.usefixtures("there")
def test_a_target_beside_the_image_and_an_unknown_colour_are_refused_and_the_flight_goes_on(
    pursuit: follower.Pursuit,
) -> None:
    with pursuit:
        with pytest.raises(follower.SourceError, match="lies outside the image, which is 320x240"):
            pursuit.select(follower.Box(900, 900, 40, 40))
        with pytest.raises(follower.SettingsError, match="#d0"):
            pursuit.select("#d0")
        with pytest.raises(follower.ModelError, match="detector"):
            pursuit.select("car")
        pursuit.select("#d02020")
        assert pursuit.wait("ready", 90)
        assert not pursuit.wait(timeout_s=0.2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mode": "circle"}, "circle"),
        ({"target": "#d0"}, "#d0"),
        ({"skip_preflight": ["gpss"]}, "no such check"),
        ({"camera": " "}, "which source"),
        ({"overrides": ["camera.fov=7"]}, "fov_deg"),
        ({"overrides": ["video.udp=127.0.0.1:5600"]}, "video"),
        ({"overrides": ["consent.kind=terminal"]}, "reads no keys"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_is_opened(
    arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(follower.SettingsError, match=message):
        follower.Pursuit("udpin:127.0.0.1:1", **{"camera": 0, **arguments})
