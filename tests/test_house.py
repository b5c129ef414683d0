"""The rules of the house: floors, names, and what a flight does not import."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = {
    "follower_vision": ROOT / "vision" / "follower_vision",
    "follower_control": ROOT / "control" / "follower_control",
    "follower_sim": ROOT / "sim" / "follower_sim",
    "follower": ROOT / "follower",
}
FLOORS = list(SOURCES)
FLIGHT = (
    "follower.control_stage, follower.control_loop, follower.realtime, follower.tracking, "
    "follower.links.mavlink, follower.links.connection, follower.links.opening"
)


def python(code: str) -> str:
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    return result.stdout.strip()


def test_import_control_is_python_control_also_from_the_repositorys_root() -> None:
    code = "import control; print(control.tf([1], [1, 1]).poles()[0].real, control.__file__)"
    pole, place = python(code).split(maxsplit=1)
    assert float(pole) == -1.0
    assert Path(place).parent != ROOT / "control"


@pytest.mark.parametrize("package", FLOORS)
def test_a_package_imports_only_from_the_floors_below(package: str) -> None:
    above = set(FLOORS[FLOORS.index(package) + 1 :])
    for path in SOURCES[package].rglob("*.py"):
        for name in imported(path):
            assert name.split(".")[0] not in above, f"{path} imports {name}"


def imported(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
    return names


def test_a_flight_imports_neither_torch_nor_python_control_nor_the_simulator() -> None:
    code = f"import sys, {FLIGHT}; print(*sorted(m.split('.')[0] for m in sys.modules))"
    modules = set(python(code).split())
    assert modules.isdisjoint({"torch", "control", "follower_sim", "mavsdk"})


def test_the_command_line_and_a_real_flight_load_neither_plots_nor_analysis() -> None:
    code = "import sys, follower.cli, follower.fly.fly; print(*sys.modules)"
    modules = set(python(code).split())
    assert modules.isdisjoint({"torch", "control", "matplotlib", "mavsdk"})
    assert modules.isdisjoint({"dask", "distributed", "optuna", "pyarrow"})
    assert modules.isdisjoint({"aiortc", "aioice", "fastapi", "starlette", "uvicorn", "websockets"})


def test_nothing_of_ours_imports_matplotlib_outside_reports() -> None:
    for package, folder in SOURCES.items():
        for path in folder.rglob("*.py"):
            if (ROOT / "follower" / "report") in path.parents:
                continue
            tops = {name.split(".")[0] for name in imported(path)}
            assert "matplotlib" not in tops, f"{package}: {path}"


def test_torch_and_onnx_are_for_training_alone() -> None:
    training = ROOT / "follower" / "training"
    for package, folder in SOURCES.items():
        for path in folder.rglob("*.py"):
            tops = {name.split(".")[0] for name in imported(path)}
            within = training in path.parents
            assert within or tops.isdisjoint({"torch", "onnx"}), f"{package}: {path}"


def test_python_control_and_scipy_are_for_tuning_alone() -> None:
    tuning = (
        ROOT / "control" / "follower_control" / "tuning",
        ROOT / "follower" / "tune",
        ROOT / "follower" / "identify",
    )
    for folder in SOURCES.values():
        for path in folder.rglob("*.py"):
            if not any(one in path.parents for one in tuning):
                tops = {name.split(".")[0] for name in imported(path)}
                assert tops.isdisjoint({"control", "scipy"}), path


def test_web_servers_are_for_the_cockpits_process_alone() -> None:
    """What a flight imports of the cockpit imports none of them."""
    served = ("app", "conversation", "crowd", "guard", "patient_response", "server", "webrtc")
    for folder in SOURCES.values():
        for path in folder.rglob("*.py"):
            tops = {name.split(".")[0] for name in imported(path)}
            within = path.parent == ROOT / "follower" / "cockpit" and path.stem in served
            web = {"aiortc", "aioice", "fastapi", "starlette", "uvicorn", "websockets"}
            assert within or tops.isdisjoint(web), path


def test_no_ground_truth_is_imported_by_what_sees_or_steers() -> None:
    for name in ("vision_stage", "control_stage", "control_loop", "tracking", "selecting"):
        tops = {module.split(".")[0] for module in imported(ROOT / "follower" / f"{name}.py")}
        assert "follower_sim" not in tops


def test_the_stand_in_for_vision_is_known_to_the_simulators_side_alone() -> None:
    allowed = {"simulation_report.py", "simulated_flight.py", "campaign.py"}
    for package in ("follower_vision", "follower_control", "follower"):
        for path in SOURCES[package].rglob("*.py"):
            if "follower_sim.stand_in" in imported(path):
                assert path.name in allowed, path


def test_what_only_campaigns_need_is_imported_by_campaigns_alone() -> None:
    for folder in SOURCES.values():
        for path in folder.rglob("*.py"):
            tops = {name.split(".")[0] for name in imported(path)}
            assert tops.isdisjoint({"dask", "distributed", "optuna", "pyarrow"}), path


def test_the_source_says_no_wall_clock_time() -> None:
    wall = re.compile(r"\btime\.time\(\)|\bdatetime\.now\(")
    for folder in SOURCES.values():
        for path in folder.rglob("*.py"):
            assert not wall.search(path.read_text("utf-8")), path


@pytest.mark.slow
def test_the_wheel_holds_the_four_packages_and_the_configs(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", str(tmp_path)]
    subprocess.run([*command, str(ROOT)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    listing = python(f"import zipfile; print(*zipfile.ZipFile({str(wheel)!r}).namelist())")
    for wanted in ("follower/cli.py", "follower/_configs/scenarios/demo.yaml"):
        assert wanted in listing
    for package in FLOORS:
        assert f"{package}/py.typed" in listing
    assert " control/" not in listing
