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

import numpy as np
import pytest
from flying_vehicle import Vehicle, flying_vehicle, write_square
from waiting import until

import follower

pytestmark = pytest.mark.slow

HEIGHT_M = 12.0
SETTINGS = (
    *("camera.fov_deg=70", "camera.pitch_deg=-20"),
    *("link.vehicle_id=1", "servo.max_forward_m_s=2"),
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


def speeds(message: Any) -> tuple[float, ...]:
    return (message.vx, message.vy, message.vz, message.yaw_rate)


def follow(there: Vehicle, pursuit: follower.Pursuit) -> None:
    """Have the pilot switch the mode, and wait until the vehicle turns to the target."""
    assert pursuit.wait("ready", 90)
    until(lambda: there.autopilot.switch_mode(there.setpoint_mode))
    assert pursuit.wait("following", 90)
    until(lambda: any(m.yaw_rate > 0.05 for _, m in there.setpoints))


def assert_holds_and_is_released(there: Vehicle) -> None:
    """The last setpoints are zeros, the vehicle comes to a stand, and nothing more is sent."""
    sent = there.setpoints
    assert np.array([speeds(m) for _, m in sent[-5:]]) == pytest.approx(0.0, abs=1e-6)
    until(lambda: np.linalg.norm(there.autopilot.state.velocity_m_s) < 0.35)
    assert not any(thread.name == "pursuit" for thread in threading.enumerate())
    time.sleep(0.3)
    assert len(there.setpoints) == len(sent)


def test_it_follows_once_the_pilot_consents_and_prints_nothing(
    there: Vehicle, pursuit: follower.Pursuit, capfd: pytest.CaptureFixture[str]
) -> None:
    with pursuit:
        pursuit.select("#d02020")
        assert pursuit.wait("ready", 90)
        time.sleep(1.5)
        assert all(speeds(m) == (0, 0, 0, 0) for _, m in there.setpoints)
        assert there.autopilot.mode == "LOITER"
        assert pursuit.status.phase == "pilot: switch to OFFBOARD, and it follows"
        follow(there, pursuit)
        track = next(pursuit.tracks())
        assert track.state == "tracking"
        assert track.box.distance(follower.Box(210, 120, 40, 40)) < 15
        assert pursuit.track is not None
        pursuit.stop()
        assert pursuit.wait(timeout_s=60)
        assert list(pursuit.tracks()) == []
    assert_holds_and_is_released(there)
    assert pursuit.end.sentence == "Ended as asked"
    assert capfd.readouterr() == ("", "")
    flight = follower.open_flight(pursuit.folder)
    assert set(flight.arrays()["controls"]["state"]) >= {"ready", "following", "released"}
    assert (pursuit.folder / "preflight.json").is_file()


def test_an_exception_in_the_block_leaves_the_vehicle_holding_and_released(
    there: Vehicle, pursuit: follower.Pursuit
) -> None:
    def fail_in_the_block() -> None:
        with pursuit:
            pursuit.select(follower.Box.from_xywh(190, 100, 40, 40))
            follow(there, pursuit)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_in_the_block()
    assert_holds_and_is_released(there)
    assert there.autopilot.mode == "OFFBOARD"
    with pytest.raises(RuntimeError, match="flies once"), pursuit:
        pass


PROGRAM = """
import sys, follower
pursuit = follower.Pursuit({connect!r}, camera={camera!r}, target="#d02020", overrides={settings!r})
{how}
"""
FOLLOWING = "pursuit.wait('following'), print('on', flush=True)"
IN_BLOCK = f"with pursuit:\n    {FOLLOWING}\n    pursuit.wait()"
NEVER_LEFT = f"pursuit.__enter__()\n{FOLLOWING}"


@pytest.mark.parametrize(
    ("how", "ended_by"),
    [
        pytest.param(IN_BLOCK, signal.SIGINT, id="Ctrl-C"),
        pytest.param(IN_BLOCK, signal.SIGTERM, id="SIGTERM"),
        pytest.param(NEVER_LEFT, None, id="the program's end"),
    ],
)
def test_however_the_program_ends_the_vehicle_holds_and_is_released(
    there: Vehicle, port: int, video: Path, tmp_path: Path, how: str, ended_by: int | None
) -> None:
    connect = f"udpin:127.0.0.1:{port}"
    code = PROGRAM.format(connect=connect, camera=str(video), settings=SETTINGS, how=how)
    program = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=tmp_path, env=os.environ
    )
    try:
        until(lambda: there.autopilot.switch_mode(there.setpoint_mode))
        assert program.stdout is not None
        assert program.stdout.readline() == b"on\n"
        if ended_by is not None:
            program.send_signal(ended_by)
        program.communicate(timeout=90)
    finally:
        program.kill()
        program.communicate()
    assert_holds_and_is_released(there)


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
