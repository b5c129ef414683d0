"""Flights without pixels: flown, labelled, repeatable, and refused where pixels are needed."""

import json
from pathlib import Path

import pytest

from follower.simulation.options import SimulationOptions, VisionSource, check_without_pixels
from follower.simulation.run import simulate
from follower_control.common.strict_config import SettingsError
from follower_sim.noisy_tracker import LABEL
from follower_sim.scenario.scenario_file import load_scenario

SHORT = ("duration_s=16", "targets.0.path.shape.from_s=10")


def options(out: Path, **more: object) -> SimulationOptions:
    return SimulationOptions(
        "pursue-quadrotor",
        seed=5,
        lockstep=True,
        out=out,
        video=False,
        vision=VisionSource.TRUTH,
        scene=SHORT,
        **more,  # type: ignore[arg-type]
    )


@pytest.mark.slow
def test_a_flight_without_pixels_is_labelled_and_the_same_each_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        simulate(options(tmp_path))
    said = capsys.readouterr().out
    assert LABEL.lower() in said.lower()
    first, again = tmp_path / "pursue-quadrotor", tmp_path / "pursue-quadrotor-2"
    score = json.loads((first / "score.json").read_text("utf-8"))
    assert score["run"]["vision"] == "truth+noise"
    assert score["score"]["time_to_acquire_s"] is not None
    page = (first / "report.html").read_text("utf-8")
    assert LABEL in page
    assert "--vision truth+noise" in page
    assert "--scene duration_s=16" in page
    for name in ("score.json", "boxes.csv", "setpoints.csv"):
        assert (first / name).read_bytes() == (again / name).read_bytes()
    assert "truth+noise" in (first / "boxes.csv").read_text("utf-8")
    assert not (first / "flight.mcap").exists()


def test_a_seed_is_no_negative_number() -> None:
    with pytest.raises(SettingsError, match="--seed -1: a seed is 0 or more"):
        simulate(SimulationOptions("demo", seed=-1, lockstep=True))


def test_what_cannot_begin_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("follower.ui.terminal.console.find_spec", lambda _: None)
    with pytest.raises(SettingsError, match="--cockpit needs aiortc"):
        simulate(options(tmp_path / "runs", cockpit=True))
    assert not (tmp_path / "runs").exists()


def test_faults_of_the_picture_need_pixels(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="--fault frames-black@12:1 needs a flight with pixels"):
        simulate(options(tmp_path, faults=("frames-black@12:1",)))
    with pytest.raises(SettingsError, match="frames-blck"):
        simulate(options(tmp_path, faults=("frames-blck@12:1",)))
    scenario = load_scenario(
        Path(__file__).parents[3] / "configs" / "scenarios" / "pursue-car.yaml",
        ("faults=[{kind: frozen, from_s: 3}]",),
    )
    with pytest.raises(SettingsError, match="the scenario's fault 'frozen' needs"):
        check_without_pixels(scenario)


def test_another_sight_is_named() -> None:
    with pytest.raises(SettingsError, match=r"--vision eyes: choose pixels or truth\+noise"):
        VisionSource.of("eyes")


def test_a_mistyped_key_of_the_scenario_is_named(tmp_path: Path) -> None:
    wrong = SimulationOptions("pursue-car", lockstep=True, out=tmp_path, scene=("wind.mean=3",))
    with pytest.raises(SettingsError, match=r"--scene wind.mean=3: unknown key 'wind.mean'"):
        simulate(wrong)
