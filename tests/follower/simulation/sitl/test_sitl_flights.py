"""`follower sitl`: whole flights of programs in processes of their own."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from follower.apps.sitl.run import SitlMatrix, fly_matrix
from follower.links.connections import ConnectionFailedError
from follower.recording import open_flight
from follower.simulation.fault_tests.run_fault import SCENE
from follower.simulation.options import VisionSource
from follower.simulation.sitl.programs import ProgramStart, SimulatedProgram, SitlSetup
from follower_control.common.strict_config import SettingsError
from follower_vision.onnx_network import ModelError


@pytest.fixture
def matrix() -> SitlMatrix:
    scene = "duration_s=6", "wind.mean_m_s=3", "targets.0.path.speeds.0.at_s=2"
    program = SimulatedProgram("ardupilot")
    return SitlMatrix(
        (str(SCENE),),
        (program,),
        vision=VisionSource.TRUTH,
        scene=scene,
        speedup=2.0,
    )


def rows(out: Path) -> list[dict[str, object]]:
    content = json.loads((out / "sitl" / "results.json").read_text())
    assert isinstance(content, list)
    return content


class Broken(SimulatedProgram):
    """Lives for a moment."""

    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        whole = super().start(folder, setup)
        return ProgramStart(["/bin/sh", "-c", "echo out of memory; exit 7"], whole.environment)


@pytest.mark.slow
def test_a_scenario_is_flown_on_a_program_and_reported(matrix: SitlMatrix, tmp_path: Path) -> None:
    out = tmp_path / "runs"
    # A busy machine is silent for longer than a link may be; how long that is, other tests say.
    patient = ("supervisor.link_timeout_s=20", "supervisor.telemetry_timeout_s=10")
    matrix = replace(matrix, overrides=patient)
    assert fly_matrix(matrix, out) in (0, 1)  # whether the limits are kept is the machine's luck
    (row,) = rows(out)
    assert row["autopilot"] == "simulated ardupilot"
    assert "--simulated ardupilot" in str(row["command"])
    flown = out / "sitl" / str(row["folder"])
    for name in ("report.html", "score.json", "setpoints.csv", "autopilot.csv", "autopilot.txt"):
        assert (flown / name).stat().st_size > 0 or name == "autopilot.txt"
    page = (out / "sitl" / "report.html").read_text()
    assert f'href="{row["folder"]}/report.html"' in page
    lines = (flown / "autopilot.csv").read_text().splitlines()[1:]
    assert min(float(line.split(",")[5]) for line in lines) < -5.0  # its own vehicle flew
    report = (flown / "report.html").read_text()
    assert "autopilot.csv" in report
    assert "2 times real time" in report


class DiesInTheAir(SimulatedProgram):
    """Kills itself at 5 m."""

    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        whole = super().start(folder, setup)
        module = whole.command[2]
        code = (
            f"import os, signal, sys, {module} as program\n"
            "class Mortal(program.SimAutopilot):\n"
            "    def step(self, now_s):\n"
            "        super().step(now_s)\n"
            "        if self.state.position_m[2] < -5: os.kill(os.getpid(), signal.SIGKILL)\n"
            "program.SimAutopilot = Mortal\n"
            "program.main(sys.argv[1:])"
        )
        return ProgramStart([whole.command[0], "-c", code, *whole.command[3:]], {})


@pytest.mark.slow
def test_the_death_of_a_program_in_the_air_ends_the_flight_with_all_its_files(
    matrix: SitlMatrix, tmp_path: Path
) -> None:
    out = tmp_path / "runs"
    mortal = replace(matrix, programs=(DiesInTheAir("px4"),), vision=VisionSource.PIXELS)
    assert fly_matrix(replace(mortal, video=False), out) == 4
    (row,) = rows(out)
    assert row["exit_code"] == 4
    assert "program ended: simulated px4 died by SIGKILL" in str(row["end"])
    flown = out / "sitl" / str(row["folder"])
    recorded = open_flight(flown)
    assert recorded.log.controls
    assert not recorded.remarks
    assert "died by SIGKILL" in (flown / "report.html").read_text()


@pytest.mark.slow
def test_the_death_of_the_only_program_before_it_flew_is_one_line_and_leaves_nothing(
    matrix: SitlMatrix, tmp_path: Path
) -> None:
    out = tmp_path / "runs"
    broken = replace(matrix, programs=(Broken("ardupilot"),))
    with pytest.raises(
        ConnectionFailedError, match=r"ended with code 7 before it flew.*out of memory"
    ):
        fly_matrix(broken, out)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("repeat", [1, 2])
def test_a_network_that_is_missing_is_one_error_and_leaves_nothing(
    matrix: SitlMatrix, tmp_path: Path, repeat: int
) -> None:
    out = tmp_path / "runs"
    sees = replace(matrix, vision=VisionSource.PIXELS, video=False, repeat=repeat)
    with pytest.raises(ModelError, match=r"nothere\.onnx: no such network"):
        fly_matrix(replace(sees, overrides=("tracker=nothere.onnx",)), out)
    assert not out.exists()


@pytest.mark.slow
def test_of_several_flights_one_that_fails_is_a_row_of_the_report(
    matrix: SitlMatrix, tmp_path: Path
) -> None:
    out = tmp_path / "runs"
    broken = replace(matrix, programs=(Broken("ardupilot"),), repeat=2)
    assert fly_matrix(broken, out) == 1
    assert [row["seed"] for row in rows(out)] == [3, 4]
    assert all(str(row["end"]).startswith("not flown: ") for row in rows(out))
    assert "0 of 2 flights passed" in (out / "sitl" / "report.html").read_text()


def test_random_flights_are_the_campaigns_and_the_same_on_each_program(matrix: SitlMatrix) -> None:
    both = (SimulatedProgram("px4"), SimulatedProgram("ardupilot"))
    drawn = list(replace(matrix, scenarios=(), programs=both, random=4, seed=11).flights())
    first, second = drawn[:4], drawn[4:]
    assert [(one.scenario, one.seed, one.scene) for one in first] == [
        (one.scenario, one.seed, one.scene) for one in second
    ]
    assert len({one.seed for one in first}) == 4
    assert all(any(key.startswith("wind.mean_m_s=") for key in one.scene) for one in first)
    again = list(replace(matrix, scenarios=(), programs=both, random=6, seed=11).flights())
    assert [one.seed for one in again[:4]] == [one.seed for one in first]


def test_what_does_not_go_together_is_refused_before_anything_flies(
    matrix: SitlMatrix, tmp_path: Path
) -> None:
    already = replace(matrix, programs=(None,), connect="udpin:127.0.0.1:0", speedup=1.0)
    params = tmp_path / "mine.params"
    params.write_text("GUID_TIMEOUT 1\n")
    (own,) = replace(matrix, parameter_file=params, speedup=2.0).flights()
    assert f"--speedup 2 --params {params}" in own.command
    flown = {one.scenario for one in replace(matrix, scenarios=("all",)).flights()}
    assert flown > {"winding", "demo"}
    assert "gimbal" not in flown
    for changed, said in (
        (replace(matrix, link="dronekit"), "--link dronekit: choose"),
        (replace(matrix, speedup=2.0, link="mavsdk"), "--speedup: mavsdk has its own time"),
        (replace(already, speedup=2.0), "--speedup: an autopilot that runs already"),
        (replace(already, parameter_file=Path("x")), "--params: an autopilot that runs already"),
        (replace(matrix, scenarios=("gimbal",)), "the scenario gimbal needs a gimbal"),
        (replace(matrix, scenarios=("none",)), "there is no scenario 'none'"),
        (replace(matrix, random=3), "name scenarios, or give --random"),
        (replace(matrix, scenarios=()), "name scenarios, or give --random"),
    ):
        with pytest.raises(SettingsError, match=said):
            fly_matrix(changed, tmp_path / "runs")
    assert not (tmp_path / "runs").exists()
