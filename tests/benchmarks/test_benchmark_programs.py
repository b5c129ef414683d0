"""The benchmarks as programs: each says what it is for, and what it cannot use."""

import ast
import importlib
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from follower.training.fusion.settings import FusionSetup
from follower_vision.trackers.motion_tracker import IdentityTracker

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
PROGRAMS = [path for path in BENCHMARKS.rglob("*.py") if "__main__" in path.read_text("utf-8")]


def ended(program: Path, *words: str, monkeypatch: pytest.MonkeyPatch) -> object:
    """Run a program in this process; return its exit code."""
    monkeypatch.setattr(sys, "argv", [str(program), *words])
    monkeypatch.syspath_prepend(str(program.parent))
    with pytest.raises(SystemExit) as ending:
        runpy.run_path(str(program), run_name="__main__")
    return ending.value.code


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.stem)
def test_help_says_what_a_benchmark_is_for(
    program: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if "rclpy" in program.read_text("utf-8"):
        pytest.importorskip("rclpy")
    assert ended(program, "--help", monkeypatch=monkeypatch) == 0
    about = ast.get_docstring(ast.parse(program.read_text("utf-8"))) or ""
    assert about.splitlines()[0] in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "words", "reason"),
    [
        ("hidden_car", ("--scenario", "none"), "hidden_car: there is no scenario 'none'"),
        ("fusion_speed", ("none",), "No such file or directory: 'none/sequences'"),
        ("re3_departures", ("none.onnx", "none"), "none: there is no such folder"),
        ("mode_pictures", ("none",), "none: there is no such folder; a flight is a folder"),
        ("estimator", ("--first", "1000"), "standard has no run 1000"),
        ("control_jitter", ("0",), "invalid positive value: '0'"),
        ("limit", ("--jobs", "0"), "invalid count value: '0'"),
        ("many_flights", ("--queued", "0"), "invalid count value: '0'"),
    ],
)
def test_what_a_benchmark_cannot_use_is_said_in_one_line(
    name: str,
    words: tuple[str, ...],
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert ended(BENCHMARKS / f"{name}.py", *words, monkeypatch=monkeypatch) == 2
    assert reason in capsys.readouterr().err.splitlines()[-1]


class SearchingTracker(IdentityTracker):
    """Takes a second for each thing that it does; an update is a search and more."""

    def __init__(self, now: list[float]) -> None:
        super().__init__()
        self._now = now

    def search(self, *_: object) -> None:
        self._now[0] += 1.0

    def learn(self, *_: object) -> None:
        self._now[0] += 1.0

    def update(self, *_: object) -> None:
        self.search()
        self._now[0] += 1.0


def test_fusions_speed_knows_all_that_fusion_has_its_motion_tracker_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    speed, now = importlib.import_module("fusion_speed"), [0.0]
    monkeypatch.setattr(speed.time, "thread_time", lambda: now[0])
    spent = speed.Spent()
    tracker = speed.timed(SearchingTracker(now), spent)
    for name, in_all_s in (("search", 1.0), ("learn", 2.0), ("update", 4.0)):
        getattr(tracker, name)(None, None)
        assert spent.motion_s == in_all_s


@pytest.mark.parametrize(
    ("name", "setup"),
    [
        ("fusion:correlation+none", ("correlation", None)),
        ("fusion:correlation", ("correlation", "yolox-nano")),
        ("fusion+fastestdet", ("nanotrack-v3", "fastestdet")),
    ],
)
def test_fusion_out_of_fold_has_the_detector_that_its_name_says(
    name: str, setup: tuple[str, str | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    crossed = importlib.import_module("fusion_cv")
    options = SimpleNamespace(detector="yolox-nano", models=Path("models"))
    assert crossed._out_of_fold(name, options).keywords["setup"] == FusionSetup(*setup)
