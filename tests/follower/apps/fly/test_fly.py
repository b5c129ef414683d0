"""`follower fly` from the command line: a simulated autopilot, a video as camera, a pilot."""

from __future__ import annotations

import json
import math
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying_vehicle import PATIENT
from program import RunningProgram
from promises import LateS, assert_keeps, assert_releases
from waiting import until

from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import open_flight

SETTINGS = (
    *("--set", "camera.fov_deg=70", "--set", "camera.pitch_deg=-20"),
    *("--set", "link.vehicle_id=1", "--set", "servo.max_forward_m_s=2"),
    *(argument for setting in PATIENT for argument in ("--set", setting)),
)
HEIGHT_M = 12.0
READY, REFUSED, UNUSABLE, HANDED_OVER, RELEASED_FOR_SAFETY, INTERRUPTED = 0, 1, 2, 3, 4, 130
MakeVehicle = Callable[..., Any]


@pytest.fixture
def launch(port: int, video: Path, tmp_path: Path) -> Any:
    programs: list[RunningProgram] = []

    def start(*more: str, camera: str = str(video)) -> RunningProgram:
        link = ("--connect", f"udpin:127.0.0.1:{port}", "--camera", camera)
        programs.append(RunningProgram("fly", *link, *SETTINGS, *more, cwd=tmp_path))
        return programs[-1]

    yield start
    for program in programs:
        program.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "link"),
    [
        ("px4", "pymavlink"),
        pytest.param("ardupilot", "mavsdk", marks=pytest.mark.slow),
    ],
)
def test_it_waits_for_the_pilot_follows_and_holds_on_ctrl_c(
    vehicle: MakeVehicle, launch: Any, tmp_path: Path, late_s: LateS, flavour: str, link: str
) -> None:
    there = vehicle(flavour, HEIGHT_M)
    program = launch("--colour", "#d02020", "--link", link)
    program.wait_for("Ready")
    program.wait_for(f"pilot: switch to {there.setpoint_mode}, and it follows")
    assert all(one.is_zero for one in there.setpoints)
    assert there.autopilot.mode == "LOITER"
    yaw = there.autopilot.state.yaw_rad
    # PX4 refuses while no set-point has come for a second; a pilot turns the switch again.
    until(lambda: there.autopilot.switch_mode(there.setpoint_mode))
    until(lambda: there.autopilot.state.yaw_rad - yaw > math.radians(5))
    program.wait_for("following")
    asked_s = there.clock.now()
    assert program.end(signal.SIGINT) == READY, program.said
    ended_s = there.clock.now()
    assert "Ended as asked" in program.said
    assert re.search(f"still in {there.setpoint_mode}", program.said)
    look, late = (lambda: there.evidence), (lambda: 0.2 + late_s())
    assert_releases(look, "process-interrupted", asked_s, late, ended_s)
    check_recording(tmp_path / "runs" / "fly", there)


def check_recording(folder: Path, there: Any) -> None:
    flight = open_flight(folder)
    # A busy computer may leave frames out of the video, and nothing else.
    assert [remark for remark in flight.remarks if "left out" not in remark] == []
    assert flight.config.kind == "real"
    states = [record.state for record in flight.log.controls]
    assert SupervisorState.FOLLOWING in states
    assert states[-1] is SupervisorState.RELEASED
    turning = [r.allowed.yaw_rate_rad_s for r in flight.log.controls if r.sent]
    assert max(turning) == pytest.approx(max(s.values[3] for s in there.setpoints), abs=1e-6)
    numbers = np.array([frame.sequence for frame in flight.pictures()])
    assert len(numbers) > 10
    assert (np.diff(numbers) > 0).all()
    assert json.loads((folder / "preflight.json").read_text())["ready"] is True
    for name in ("inspection.html", "boxes.csv", "setpoints.csv", "mavlink.tlog"):
        assert (folder / name).stat().st_size > 1000, name
    assert "password" not in (folder / "config.yaml").read_text()


@pytest.mark.slow
def test_a_flight_goes_on_when_nobody_reads_what_it_says_any_more(
    vehicle: MakeVehicle, launch: Any, tmp_path: Path
) -> None:
    """As with `follower fly … | head`, or a terminal that was closed."""
    there = vehicle("ardupilot", HEIGHT_M)
    program = launch("--colour", "#d02020")
    program.wait_for("pilot: switch to GUIDED")
    there.autopilot.switch_mode("GUIDED")
    program.wait_for("following")
    program.deaf.set()
    program.reader.join(30)
    assert not program.reader.is_alive()
    heard = len(there.setpoints)
    time.sleep(7.0)  # a line each five seconds
    assert len(there.setpoints) > heard + 50
    assert program.end(signal.SIGINT) == READY
    check_recording(tmp_path / "runs" / "fly", there)


@pytest.mark.slow
def test_the_pilot_takes_over_and_nothing_is_sent_any_more(
    vehicle: MakeVehicle, launch: Any, late_s: LateS
) -> None:
    there = vehicle("ardupilot", HEIGHT_M)
    program = launch("--target", "190,100,40,40")
    program.wait_for("pilot: switch to GUIDED")
    there.autopilot.switch_mode("GUIDED")
    until(lambda: there.turns)
    there.autopilot.switch_mode("LOITER")
    switched_s = there.clock.now()
    program.wait_for("pilot took over")
    time.sleep(1.0)
    assert program.end(signal.SIGTERM) == HANDED_OVER, program.said
    assert "Handed over to the pilot, who took another mode" in program.said
    look, late = (lambda: there.evidence), (lambda: 0.2 + late_s())
    assert_keeps(look, "pilot-while-following", switched_s, late)
    assert "still in" not in program.said
    assert there.autopilot.mode == "LOITER"


@pytest.mark.slow
def test_a_live_camera_that_dies_is_held_for_and_the_program_still_ends(
    vehicle: MakeVehicle, launch: Any, stream: Any, tmp_path: Path, late_s: LateS
) -> None:
    there = vehicle("ardupilot", HEIGHT_M)
    hold = ("--set", "supervisor.hold_s=1")
    program = launch("--colour", "#d02020", *hold, camera=stream.address)
    program.wait_for("pilot: switch to GUIDED")
    there.autopilot.switch_mode("GUIDED")
    until(lambda: there.turns)
    stopped_s = there.clock.now()
    stream.stop()
    program.wait_for("holding .*frames stale")
    program.wait_for("released .*hold timed out")
    assert program.end(signal.SIGINT) == RELEASED_FOR_SAFETY, program.said
    assert "Released after a hold: frames stale" in program.said
    look, late = (lambda: there.evidence), (lambda: 0.5 + late_s())
    assert_keeps(look, "frames-stop", stopped_s, late)
    assert open_flight(tmp_path / "runs" / "fly").remarks == []


@pytest.mark.slow
def test_full_autonomy_takes_off_follows_and_hands_back(vehicle: MakeVehicle, launch: Any) -> None:
    there = vehicle("ardupilot")
    program = launch("--colour", "#d02020", "--set", "autonomy=full", "--set", "takeoff_height_m=6")
    until(lambda: there.turns)
    assert -there.autopilot.state.position_m[2] > 4
    assert program.end(signal.SIGINT) == READY, program.said
    assert there.autopilot.mode == "BRAKE"


@pytest.mark.slow
def test_a_camera_that_gives_more_than_the_last_bench_held_is_told_of_and_flown_with(
    vehicle: MakeVehicle, launch: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = {"tracker": "correlation", "detector": None, "device": "cpu", "camera_hz": None}
    row = {**setup, "width": 320, "height": 240, "video": True, "rate_hz": 12.0}
    (tmp_path / "cache" / "follower").mkdir(parents=True)
    (tmp_path / "cache" / "follower" / "bench.json").write_text(json.dumps({"rows": [row]}))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    there = vehicle("px4", HEIGHT_M)
    program = launch("--colour", "#d02020")
    program.wait_for(f"pilot: switch to {there.setpoint_mode}, and it follows")
    assert program.end(signal.SIGINT) == READY, program.said
    (told,) = re.findall(r"^Vision will leave.*$", program.said, re.MULTILINE)
    assert "correlation held 12 frames/s at 320x240" in told
    assert "the camera gives 30 at 320x240" in told


@pytest.mark.slow
def test_ctrl_c_during_the_checks_leaves_nothing_behind(launch: Any, tmp_path: Path) -> None:
    program = launch("--colour", "#d02020")
    until(lambda: (tmp_path / "runs" / "fly" / "mavlink.tlog").exists())
    code = program.end(signal.SIGINT)
    assert code == INTERRUPTED, program.said
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_a_failed_check_refuses_and_leaves_nothing_behind(
    vehicle: MakeVehicle, port: int, video: Path, tmp_path: Path, capsys: Any
) -> None:
    from follower.apps.fly.opened import FlightPlan
    from follower.apps.fly.session import fly
    from follower.apps.preflight.session import CheckScope
    from follower.apps.target_choice import TargetChoice
    from follower.apps.video_input import VideoInput
    from follower.settings.settings import load_settings

    there = vehicle("px4")
    there.autopilot.parameters["COM_OBL_RC_ACT"] = 6.0
    plan = FlightPlan(
        load_settings(overrides=["camera.fov_deg=70", "link.vehicle_id=1"]),
        TargetChoice(colour="#d02020"),
        "nobody",
        VideoInput(str(video), realtime=True),
        f"udpin:127.0.0.1:{port}",
        CheckScope(frozenset(), tmp_path / "runs", lens_given=True, longest_s=4.0),
    )
    assert fly(plan) == REFUSED
    said = capsys.readouterr().out
    assert "Do not fly: 1 check failed" in said
    assert "COM_OBL_RC_ACT: 6: termination: the motors stop; set it to 5 (Hold)" in said
    assert "--skip-preflight COM_OBL_RC_ACT" in said
    assert not (tmp_path / "runs").exists()
    assert there.setpoints == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--connect", "udpin:0.0.0.0:1x", "--camera", "0", "--colour", "#d02020"), "1x"),
        (("--connect", "/dev/tty-none:9600", "--camera", "0", "--colour", "#d02020"), "tty-none"),
        (("--connect", "udpin:127.0.0.1:1", "--camera", "0"), "which target"),
        (
            ("--connect", "x", "--camera", "0", "--colour", "#d02020", "--select", "car"),
            "by one of",
        ),
        (("--connect", "x", "--camera", "0", "--target", "1,2,3"), "x,y,w,h"),
        (
            ("--connect", "x", "--camera", "0", "--colour", "#d02020", "--link", "ros"),
            "pymavlink or mavsdk",
        ),
        (
            ("--connect", "x", "--camera", "0", "--colour", "#d02020", "--skip-preflight", "gpss"),
            "no such check",
        ),
        (
            ("--connect", "x", "--camera", "0", "--colour", "#d02020", "--set", "camera.fov=7"),
            "fov_deg",
        ),
        (("--connect", "x", "--camera", " ", "--colour", "#d02020"), "which source"),
    ],
)
def test_what_can_be_mended_ends_in_one_line_and_exit_code_2(
    arguments: tuple[str, ...], message: str, tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    ended = run_command("fly", *arguments)
    assert ended.code == UNUSABLE
    assert message in ended.err
    assert ended.err.startswith("follower: ")
    assert ended.err.count("\n") == 1
    assert not (tmp_path / "runs").exists()
