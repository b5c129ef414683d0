"""The rules of the house: floors, names, and what a flight does not import."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from program import python

ROOT = Path(__file__).parent.parent
SOURCES = {
    "follower_vision": ROOT / "vision" / "follower_vision",
    "follower_control": ROOT / "control" / "follower_control",
    "follower_sim": ROOT / "sim" / "follower_sim",
    "follower": ROOT / "follower",
}
FLOORS = list(SOURCES)
FLIGHT = (
    "follower.flight.control.stage, follower.flight.control.loop, follower.flight.threads, "
    "follower.flight.vision.tracker_factory, "
    "follower.links.pymavlink_link, follower.links.connections, follower.links.open"
)


@pytest.mark.slow
def test_import_control_is_python_control_also_from_the_repositorys_root() -> None:
    code = "import control; print(control.tf([1], [1, 1]).poles()[0].real, control.__file__)"
    pole, place = python(code).split(maxsplit=1)
    assert float(pole) == -1.0
    assert Path(place).parent != ROOT / "control"


def imported(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
    return names


@pytest.mark.slow
def test_a_flight_imports_neither_torch_nor_python_control_nor_the_simulator() -> None:
    code = f"import sys, {FLIGHT}; print(*sorted(m.split('.')[0] for m in sys.modules))"
    modules = set(python(code).split())
    assert modules.isdisjoint({"torch", "control", "follower_sim", "mavsdk"})


@pytest.mark.slow
def test_command_line_and_real_flight_load_no_plots_no_analysis_and_no_simulated_world() -> None:
    loaded = "follower.apps.main, follower.apps.fly.session, follower.apps.preflight.sign_test"
    modules = set(python(f"import sys, {loaded}; print(*sys.modules)").split())
    assert modules.isdisjoint({"torch", "control", "matplotlib", "mavsdk"})
    assert modules.isdisjoint({"dask", "distributed", "optuna", "pyarrow"})
    assert modules.isdisjoint({"aiortc", "aioice", "fastapi", "starlette", "uvicorn", "websockets"})
    assert modules.isdisjoint({"prometheus_client", "foxglove", "rerun", "rclpy", "rosbags"})
    assert modules.isdisjoint({"pandas", "supervision", "got10k", "vot", "MAVProxy"})
    assert modules.isdisjoint({"follower_sim.world.world", "follower_sim.autopilot.autopilot"})


@pytest.mark.slow
def test_the_command_line_is_there_before_what_a_flight_needs() -> None:
    """Counted by what is imported, not by the clock: SciPy alone takes longer than all of this."""
    modules = set(python("import sys, follower.apps.main; print(*sys.modules)").split())
    assert modules.isdisjoint({"scipy", "filterpy", "av", "mcap", "follower.flight.threads"})
    said = python(
        "import sys\nfrom follower.__main__ import main\nsys.argv[1:] = ['--version']\n"
        "try:\n    main()\nfinally:\n    print(*sys.modules)"
    )
    version, modules = said.split("\n", 1)
    assert re.fullmatch(r"follower [\d.]+", version)
    assert set(modules.split()).isdisjoint({"typer", "pydantic", "cv2", "onnxruntime"})


@pytest.mark.slow
def test_what_only_campaigns_need_is_imported_by_campaigns_alone() -> None:
    for folder in SOURCES.values():
        for path in folder.rglob("*.py"):
            tops = {name.split(".")[0] for name in imported(path)}
            assert tops.isdisjoint({"dask", "distributed", "optuna", "pyarrow"}), path


def test_control_goes_through_no_blas_and_no_lapack() -> None:
    """They, and NumPy's transcendental functions, choose their code by the processor."""
    path = control_path()
    names = {file.stem for file in path}
    assert {"estimator", "world_filter", "servo", "envelope", "observation", "guidance"} <= names
    for file in path:
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            where = f"{file}:{getattr(node, 'lineno', 0)}"
            assert not isinstance(node, ast.MatMult), f"{file} multiplies by @"
            if isinstance(node, ast.Attribute):
                assert node.attr not in BY_PROCESSOR, f"{where} uses {node.attr}"
                numpys = isinstance(node.value, ast.Name) and node.value.id == "np"
                assert not (numpys and node.attr in IN_MATH), f"{where}: np.{node.attr}, not math's"
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("numpy"):
                assert node.module == "numpy.typing", f"{where} imports from {node.module}"


BY_PROCESSOR = {
    *("dot", "vdot", "inner", "matmul", "tensordot", "einsum", "linalg", "inv", "solve", "pinv"),
    *("lstsq", "eigh", "eigvalsh", "polyfit", "convolve", "correlate", "cov", "corrcoef", "fft"),
}
IN_MATH = {
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "hypot", "sinc", "tanh"),
    *("exp", "expm1", "log", "log1p", "power", "cbrt"),
}
GEOMETRY = {
    *(f"follower_vision.geometry.{name}" for name in ("box", "camera_model", "line_of_sight")),
    "follower_vision.trackers.target_tracker",
}
"""What control uses of vision."""


def control_path() -> set[Path]:
    """The files of all that a control step goes through, and of what else those import."""
    found: set[Path] = set()
    waiting = [
        "follower.flight.control.stage",
        "follower.tuning.excite.stage",
        "follower_control.servo.position_fix",
    ]
    while waiting:
        name = waiting.pop()
        package, _, rest = name.partition(".")
        file = SOURCES.get(package, ROOT).joinpath(*rest.split(".")).with_suffix(".py")
        seen = package == "follower_vision" and name not in GEOMETRY
        if package in SOURCES and not seen and file.is_file() and file not in found:
            found.add(file)
            waiting += imported(file)
    return found


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
    for wanted in ("follower/apps/main.py", "follower/_configs/scenarios/demo.yaml"):
        assert wanted in listing
    for package in FLOORS:
        assert f"{package}/py.typed" in listing
    assert " control/" not in listing


def packages() -> list[Path]:
    return sorted(path.parent for root in SOURCES.values() for path in root.rglob("__init__.py"))


@pytest.mark.parametrize("package", packages(), ids=lambda path: str(path.relative_to(ROOT)))
def test_a_package_says_what_lives_there_what_it_uses_and_where_to_start(package: Path) -> None:
    said = (ast.get_docstring(ast.parse((package / "__init__.py").read_text("utf-8"))) or "").split(
        "\n"
    )
    assert said[0].endswith(".")
    assert said[2].startswith("Uses: ")
    assert said[3].startswith("Start at: ")
    named = re.findall(r"`([\w.]+)`", said[3])
    assert named
    for name in named:
        assert defines(package, name.split(".")), f"{package}: {name} is not there"


def defines(place: Path, names: list[str]) -> bool:
    """Whether a folder has this module, or a module in it defines this name."""
    if not names:
        return True
    if (place / names[0]).is_dir():
        return defines(place / names[0], names[1:])
    file = (place / names[0]).with_suffix(".py")
    if not file.is_file():
        return holds(ast.parse((place / "__init__.py").read_text("utf-8")), names)
    return holds(ast.parse(file.read_text("utf-8")), names[1:])


def holds(node: ast.AST, names: list[str]) -> bool:
    if not names:
        return True
    for child in ast.iter_child_nodes(node):
        targets = (
            child.targets if isinstance(child, ast.Assign) else [getattr(child, "target", None)]
        )
        named = {getattr(child, "name", None), *(getattr(target, "id", None) for target in targets)}
        if names[0] in named:
            return holds(child, names[1:])
    return False
