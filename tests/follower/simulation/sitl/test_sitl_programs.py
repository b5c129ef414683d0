"""Autopilots as programs: what is refused, what they are started with, and how they end."""

import math
import os
import signal
import socket
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.apps.sitl.run import programs, render
from follower.links.connections import ConnectionFailedError
from follower.settings.settings import find_scenario
from follower.simulation.sitl.gusts import Gusts
from follower.simulation.sitl.process import AutopilotProcess
from follower.simulation.sitl.programs import (
    ArduCopterProgram,
    ProgramStart,
    Px4Program,
    SimulatedProgram,
    SitlSetup,
    read_parameters,
)
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario import WindSettings
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock


def binary(folder: Path, content: bytes, mode: int = 0o755) -> Path:
    path = folder / "program"
    path.write_bytes(b"\x7fELF\x00" + content + b"\x00")
    path.chmod(mode)
    return path


def px4_build(folder: Path, version: str = "v1.18.0-rc1-3-gabc", without: str = "") -> Path:
    files = {
        "bin/px4": "",
        "etc/init.d-posix/rcS": "",
        "etc/init.d-posix/airframes/10040_sihsim_quadx": "",
        "src/lib/version/build_git_version.h": f'#define PX4_GIT_TAG_STR "{version}"\n',
    }
    for name, content in files.items():
        if name != without:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(content)
    return folder


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"#!/bin/sh", "is not ArduCopter"),
        (b"ArduPlane V4.6.3", "this is ArduPlane; ArduCopter is needed"),
        (b"ArduCopter V3.6.12", "ArduCopter 3.6.12 is too old; known to work: ArduCopter 4.6, 4.7"),
    ],
)
def test_a_program_that_is_not_arducopter_is_refused(
    tmp_path: Path, content: bytes, said: str
) -> None:
    with pytest.raises(SettingsError, match=said):
        ArduCopterProgram(binary(tmp_path, content))


def test_a_missing_a_folder_and_a_file_that_cannot_run_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="No such file or directory; build it by `waf copter`"):
        ArduCopterProgram(tmp_path / "arducopter")
    with pytest.raises(SettingsError, match="this is a folder"):
        ArduCopterProgram(tmp_path)
    with pytest.raises(SettingsError, match=r"chmod \+x"):
        ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.6.3", mode=0o600))


def test_arducopters_version_is_read_and_an_untried_one_is_remarked_on(tmp_path: Path) -> None:
    known = ArduCopterProgram(binary(tmp_path, b"x ArduCopter V4.6.3 (abc)"))
    assert (known.title, known.remark) == ("ArduCopter 4.6.3", "")
    other = ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.9.0"))
    assert "ArduCopter 4.9.0 was not tried" in other.remark


@pytest.mark.parametrize("missing", ["bin/px4", "etc/init.d-posix/rcS"])
def test_a_folder_that_is_not_px4s_build_is_refused(tmp_path: Path, missing: str) -> None:
    with pytest.raises(SettingsError, match=f"not PX4's build folder: {missing} is missing"):
        Px4Program(px4_build(tmp_path, without=missing))


def test_px4_without_sih_and_an_old_one_are_refused(tmp_path: Path) -> None:
    without = "etc/init.d-posix/airframes/10040_sihsim_quadx"
    with pytest.raises(SettingsError, match="no SIH quadrotor"):
        Px4Program(px4_build(tmp_path, without=without))
    with pytest.raises(SettingsError, match=r"PX4 1\.13\.3 is too old; known to work: PX4 1\.17"):
        Px4Program(px4_build(tmp_path, "v1.13.3"))


def test_px4_takes_the_first_instance_whose_ports_are_free(tmp_path: Path) -> None:
    program = Px4Program(px4_build(tmp_path))
    with closing(program.listen()):
        taken = program.port
        with closing(program.listen()):
            assert program.port > taken >= 14540
            start = program.start(tmp_path, SitlSetup(2.0, {"NAV_DLL_ACT": 0.0}))
    words = list(start.command)
    assert words[words.index("-i") + 1] == str(program.port - 14540)
    assert start.environment["PX4_PARAM_NAV_DLL_ACT"] == "0"
    assert start.environment["PX4_SIM_SPEED_FACTOR"] == "2"


def test_px4_says_so_when_all_its_ports_are_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = Px4Program(px4_build(tmp_path))
    monkeypatch.setattr("follower.simulation.sitl.programs._PX4_INSTANCES", 0)
    with pytest.raises(ConnectionFailedError, match="end the PX4s that are still running"):
        program.listen()


def test_arducopter_is_started_at_our_port_with_its_parameters(tmp_path: Path) -> None:
    program = ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.6.3"))
    with closing(program.listen()):
        start = program.start(tmp_path, SitlSetup(3.0, {"GUID_TIMEOUT": 1.0}))
    assert f"udpclient:127.0.0.1:{program.port}" in start.command
    assert "tcp" not in " ".join(start.command)
    words = list(start.command)
    assert words[words.index("--speedup") + 1] == "3"
    defaults = Path(words[words.index("--defaults") + 1])
    assert read_parameters(defaults) == {"GUID_TIMEOUT": 1.0}
    assert defaults.parent == tmp_path


def test_a_wind_from_behind_is_one_from_the_south_for_who_faces_north(tmp_path: Path) -> None:
    wind = WindSettings(mean_m_s=6.0, from_deg=90.0, gust_m_s=1.5)
    copter = ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.6.3"))
    assert copter.wind(wind, heading_deg=-90.0) == {
        "SIM_WIND_T": 1,
        "SIM_WIND_SPD": 6.0,
        "SIM_WIND_DIR": 180.0,
        "SIM_WIND_TC": 0.1,
    }
    px4 = Px4Program(px4_build(tmp_path))
    assert px4.wind(wind, -90.0) == {"SIH_WIND_N": -6.0, "SIH_WIND_E": 0.0}
    assert px4.wind(WindSettings(mean_m_s=8.0, from_deg=250.0), 0.0) == {
        "SIH_WIND_N": round(8 * math.cos(math.radians(250)), 3),
        "SIH_WIND_E": round(8 * math.sin(math.radians(250)), 3),
    }


def test_gusts_are_told_in_flight_in_the_world_of_the_autopilot(tmp_path: Path) -> None:
    """A scenario that starts eastwards: its east is the autopilot's north."""
    ours, theirs = MemoryTransport.pair()
    clock, parser = SimulatedClock(), mavlink.MAVLink(None)
    scenario = load_scenario(find_scenario("windy"))
    start = scenario.start.model_copy(update={"heading_deg": 90.0})
    world = World(scenario.model_copy(update={"start": start}))
    copter = ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.6.3"))

    def told() -> dict[str, float]:
        messages = parser.parse_buffer(theirs.receive()) or []
        assert all((one.target_system, one.target_component) == (7, 1) for one in messages)
        return {one.param_id: one.param_value for one in messages}

    def expected(time_s: float) -> dict[str, float]:
        north, east, _ = world.wind.velocity_m_s(time_s)
        return {
            name: pytest.approx(value, abs=1e-3) for name, value in copter.air(east, -north).items()
        }

    gusts = Gusts(copter, (), world, ours, clock)
    gusts.step(None)
    assert told() == {}
    gusts.step(7)
    first = told()
    assert first == expected(0.0)
    clock.sleep_until(0.1)
    gusts.step(7)
    assert told() == {}
    clock.sleep_until(1.0)
    gusts.step(7)
    assert told() == expected(1.0) != first
    Gusts(copter, {"SIM_WIND_SPD": 3.0}, world, ours, clock).step(7)
    assert told().keys() == {"SIM_WIND_DIR"}
    Gusts(Px4Program(px4_build(tmp_path)), (), world, ours, clock).step(7)
    assert told() == {}


def test_the_mean_wind_is_the_gusts_wind_without_gusts(tmp_path: Path) -> None:
    copter = ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.6.3"))
    mean = copter.wind(WindSettings(mean_m_s=5.0, from_deg=30.0), heading_deg=0.0)
    assert (mean["SIM_WIND_SPD"], mean["SIM_WIND_DIR"]) == (5.0, 30.0)
    assert copter.air(0.0, 2.0) == {"SIM_WIND_SPD": 2.0, "SIM_WIND_DIR": 270.0}


def test_px4s_airframe_has_the_drag_of_the_scenarios(tmp_path: Path) -> None:
    """SIH's own is four times a real one's, so that it could not keep up."""
    px4 = Px4Program(px4_build(tmp_path))
    with_drag, without = (load_scenario(find_scenario(one)) for one in ("pursue-boat", "winding"))
    assert px4.for_scenario(with_drag, {})["SIH_KDV"] == 0.25
    assert px4.for_scenario(with_drag, {"SIH_KDV": 0.5})["SIH_KDV"] == 0.5
    assert "SIH_KDV" not in px4.for_scenario(without, {})


def test_parameters_are_names_with_numbers_and_comments(tmp_path: Path) -> None:
    path = tmp_path / "mine.parm"
    path.write_text("# mine\nA_B 1.5\nC,2  # with a comma\n\n")
    assert read_parameters(path) == {"A_B": 1.5, "C": 2.0}
    for line in ("A_B", "A_B one", "A_B nan", "A_B 1 2"):
        path.write_text(f"C 1\n{line}\n")
        with pytest.raises(SettingsError, match=r"mine\.parm:2: write NAME VALUE"):
            read_parameters(path)
    with pytest.raises(SettingsError, match="No such file"):
        read_parameters(tmp_path / "none.parm")


def test_the_usual_parameters_have_the_autopilot_stop_by_itself_in_a_second(tmp_path: Path) -> None:
    """As docs/how-to/fly.md asks for on a real vehicle."""
    copter = ArduCopterProgram(binary(tmp_path, b"ArduCopter V4.6.3")).usual_parameters()
    px4 = Px4Program(px4_build(tmp_path)).usual_parameters()
    assert (copter["GUID_TIMEOUT"], copter["FRAME_CLASS"]) == (1.0, 1.0)
    assert (px4["COM_OF_LOSS_T"], px4["COM_OBL_RC_ACT"]) == (1.0, 5.0)
    assert SimulatedProgram("px4").usual_parameters() == {}


def test_the_environment_names_programs_where_the_command_line_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ARDUCOPTER_SITL", "PX4_SITL"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SettingsError, match="no autopilot is named: give --arducopter"):
        programs(None, None, None, None)
    monkeypatch.setenv("PX4_SITL", str(px4_build(tmp_path)))
    assert [one.title for one in programs(None, None, None, None) if one] == ["PX4 1.18.0"]
    (simulated,) = programs(None, None, "px4", None)
    assert isinstance(simulated, SimulatedProgram)
    with pytest.raises(SettingsError, match="choose px4 or ardupilot"):
        programs(None, None, "ardupilots", None)
    with pytest.raises(SettingsError, match="name no program with it"):
        programs(None, None, "px4", "udpin:0.0.0.0:14540")


class Scripted(SimulatedProgram):
    """Runs a line of Python in place of an autopilot."""

    def __init__(self, code: str) -> None:
        super().__init__("px4")
        self._code = code

    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        return ProgramStart(
            [sys.executable, "-c", self._code], {"FOLDER": str(folder), "SPEED": str(setup.speedup)}
        )


def until_dead(process: AutopilotProcess) -> str:
    for _ in range(600):
        if process.death:
            return process.death
        time.sleep(0.05)
    raise AssertionError("it lives on")


def test_the_death_of_a_program_is_told_with_what_it_said_last(tmp_path: Path) -> None:
    code = "print('one\\n\\ntwo\\n\\x1b[32mthree\\x1b[0m\\nfour', flush=True); raise SystemExit(3)"
    with AutopilotProcess(Scripted(code), SitlSetup(), tmp_path) as process:
        assert until_dead(process) == "simulated px4 ended with code 3"
        assert process.last_lines == "two / three / four"
    killed = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    with AutopilotProcess(Scripted(killed), SitlSetup(), tmp_path) as process:
        assert until_dead(process).endswith("died by SIGKILL")
        assert process.last_lines == "it wrote nothing"


def test_a_program_is_ended_and_its_log_kept_its_folder_not(tmp_path: Path) -> None:
    told = tmp_path / "told"
    code = (
        "import os, pathlib, signal, sys, time\n"
        "signal.signal(signal.SIGINT, lambda *_: sys.exit(0))\n"
        "pathlib.Path('flight.csv').write_text('logged')\n"
        f"part = pathlib.Path({str(told)!r} + '.part')\n"
        "part.write_text(f'{os.getcwd()}\\n{os.getpid()}')\n"
        f"part.rename({str(told)!r})\n"
        "while True: time.sleep(0.01)"
    )
    with AutopilotProcess(Scripted(code), SitlSetup(), tmp_path) as process:
        while not told.exists() and not process.death:
            time.sleep(0.02)
        work, number = told.read_text().splitlines()
        assert Path(work).is_dir()
        assert not process.death
    assert not Path(work).exists()
    assert (tmp_path / "autopilot.csv").read_text() == "logged"
    with pytest.raises(ProcessLookupError):
        os.kill(int(number), signal.SIGCONT)


def test_what_cannot_be_started_is_one_clear_line(tmp_path: Path) -> None:
    build = px4_build(tmp_path)
    program = Px4Program(build)
    (build / "bin" / "px4").rename(tmp_path / "elsewhere")
    said = "bin/px4 cannot be started: No such file"
    with closing(program.listen()), pytest.raises(ConnectionFailedError, match=said):
        AutopilotProcess(program, SitlSetup(), tmp_path)


@pytest.mark.slow
def test_the_simulated_autopilot_sends_heartbeats_to_our_port(tmp_path: Path) -> None:
    program = SimulatedProgram("ardupilot")
    with closing(program.listen()) as ours:
        setup = SitlSetup(1.0, {"GUID_TIMEOUT": 1.0})
        with AutopilotProcess(program, setup, tmp_path) as process:
            data = b""
            while not data and not process.death:
                data = ours.receive()
                time.sleep(0.02)
            assert not process.death, process.last_lines
    assert data[:1] == b"\xfd"
    assert (tmp_path / "autopilot.csv").read_text().startswith("time_s,mode,armed")
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as again:
        again.bind(("127.0.0.1", program.port))


@pytest.fixture
def row() -> dict[str, Any]:
    return {
        "scenario": "winding",
        "autopilot": "simulated px4",
        "link": "pymavlink",
        "seed": 7,
        "command": "follower sitl winding --simulated px4",
        "end": "The pursuit succeeded",
        "passed": True,
        "folder": "winding",
    }


def test_the_report_of_one_simulated_flight_does_not_speak_of_real_autopilots(
    row: dict[str, Any],
) -> None:
    page = render([row])
    assert "1 of 1 flight passed" in page
    assert "real autopilot" not in page


def test_the_report_names_flights_that_the_computer_was_too_slow_for(row: dict[str, Any]) -> None:
    late = row | {"passed": False, "too_slow": ["Control came late: 12 of the wanted 50 steps"]}
    page = render([late, row | {"scenario": "boat", "too_slow": []}])
    assert "<li>winding, simulated px4, seed 7: Control came late: 12 of the wanted 50" in page
    assert "<li>boat" not in page
