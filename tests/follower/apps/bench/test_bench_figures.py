"""What a bench's figures mean: the advice, the file, boards side by side, a flight's warning."""

import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import pytest
import yaml
from program import python
from rich.console import Console

from follower.apps.bench import report
from follower.apps.bench.advice import advise
from follower.apps.bench.last import last_bench, more_than_held
from follower.apps.bench.report import board_rows, compared_rows, draw_board
from follower.apps.bench.result import BenchResult, BenchRow, read_bench
from follower.apps.bench.run import compare, plan
from follower.settings.settings import load_settings
from follower_control.common.strict_config import SettingsError

MakeRow = Callable[..., BenchRow]
MakeResult = Callable[..., BenchResult]
FUSED = ("nanotrack-v3", "yolox-nano")


def test_fusion_at_the_largest_size_that_holds_the_rate_with_the_margin_is_advised(
    row: MakeRow, result: MakeResult
) -> None:
    advice = advise(
        result(
            row(*FUSED, 640, 80.0),
            row(*FUSED, 1280, 37.5),  # 30 and a quarter of it, exactly
            row(*FUSED, 1920, 37.4),
            row("nanotrack-v3", None, 1920, 90.0),
        )
    )
    assert (advice.row.name, advice.row.size) == ("nanotrack-v3 + yolox-nano", "1280x720")
    assert advice.camera_hz == 30
    slower = advise(result(row(*FUSED, 640, 40.0), rate_hz=10.0))
    assert slower.lines[0].endswith("a camera of 10 frames/s, which leaves 300% to spare.")
    assert advice.lines[0] == (
        "Fusion (nanotrack-v3 with yolox-nano every 4th frame) at 1280x720 on cpu holds 38 "
        "frames/s here: use it with a camera of 30 frames/s, which leaves 25% to spare."
    )


def test_the_better_tracker_comes_before_the_larger_picture_and_any_detector_before_none(
    row: MakeRow, result: MakeResult
) -> None:
    rows = (
        row("re3", "follower-detector", 1920, 90.0),
        row("nanotrack-v3", "follower-detector", 640, 90.0),
        row("nanotrack-v3", "yolox-nano", 640, 60.0),
        row("nanotrack-v3", None, 1920, 90.0),
    )
    order = [advise(result(*rows[:last])).row for last in (4, 2, 1)]
    assert order == [rows[2], rows[1], rows[0]]
    assert advise(result(rows[0], rows[3])).row is rows[0]


def test_where_nothing_holds_the_rate_the_fastest_is_advised_with_a_rate_that_it_holds(
    row: MakeRow, result: MakeResult
) -> None:
    advice = advise(result(row(*FUSED, 640, 12.0), row("correlation", None, 640, 20.1)))
    assert advice.row.tracker == "correlation"
    assert advice.camera_hz == 16  # 20.1 / 1.25, whole
    assert advice.lines[0].startswith("Nothing measured holds 30 frames/s with 25% to spare.")
    assert "set the camera to 16 frames/s" in advice.lines[0]
    assert advise(result(row(*FUSED, 640, 0.2))).camera_hz == 1


def test_the_camera_that_is_asked_for_decides(row: MakeRow, result: MakeResult) -> None:
    rows = row(*FUSED, 640, 80.0), row(*FUSED, 1280, 40.0)
    sizes = {hz: advise(result(*rows, rate_hz=hz)).row.size for hz in (25.0, 30.0, 60.0)}
    assert sizes == {25.0: "1280x720", 30.0: "1280x720", 60.0: "640x360"}


def test_what_lost_the_target_or_was_not_recorded_or_had_a_camera_is_not_advised(
    row: MakeRow, result: MakeResult
) -> None:
    kept = row("correlation", None, 640, 50.0)
    others = (
        row(*FUSED, 640, 90.0, on_target=0.4),
        row(*FUSED, 640, 90.0, video=False),
        row(*FUSED, 640, 90.0, camera_hz=30.0),
    )
    assert advise(result(*others, kept)).row is kept
    assert "It lost the target" in " ".join(advise(result(others[0])).lines)


def test_the_advice_tells_what_the_video_costs_and_how_it_flew(
    row: MakeRow, result: MakeResult
) -> None:
    flown = row(*FUSED, 640, 30.0, camera_hz=30.0, late_p99_ms=7.25, delay_ms=41.0, throttled=0x4)
    rows = row(*FUSED, 640, 50.0), row(*FUSED, 640, 61.0, video=False), flown
    said = advise(result(*rows)).lines[1:]
    assert said[0].endswith("it reaches 61.")
    assert said[1] == (
        "With a camera of 30 frames/s: 30 tracked a second, 41 ms from capture to setpoint, 1.5 "
        "cores busy; 99 of 100 control steps began at most 7.2 ms late."
    )
    assert said[2].startswith("More than 5 ms")
    assert "slowed down" in said[3]
    calm = row(*FUSED, 640, 30.0, camera_hz=30.0, throttled=0x40000)  # before the bench
    slower = row(*FUSED, 640, 49.0, video=False)  # by chance
    assert len(advise(result(rows[0], slower, calm, load=0.1)).lines) == 2
    assert "load 1.5 a core" in advise(result(rows[0], load=1.5)).lines[1]


def test_the_settings_to_copy_are_settings(
    row: MakeRow, result: MakeResult, tmp_path: Path
) -> None:
    for best in (row(*FUSED, 640, 50.0), row("correlation", None, 640, 50.0)):
        text = advise(result(best)).to_yaml()
        (tmp_path / "advised.yaml").write_text(text)
        settings = load_settings(tmp_path / "advised.yaml")
        assert (settings.tracker, settings.detector) == (best.tracker, best.detector)
        assert settings.vision.device == "cpu"
        assert text.startswith("# The camera: 640x360, 30 frames/s.\n")


def test_each_tracker_flies_alone_and_in_fusion_and_networks_on_every_device() -> None:
    setups = plan(
        ["correlation", "nanotrack-v3"],
        ["follower-detector", "yolox-nano"],
        ["cpu", "cuda"],
        [(640, 480), (1280, 720)],
    )
    assert len(set(setups)) == len(setups)
    cuda = {setup.vision[:2] for setup in setups if setup.device == "cuda"}
    cpu = {setup.vision[:2] for setup in setups if setup.device == "cpu"}
    assert cpu == cuda | {("correlation", None)}
    assert cpu == {
        *(("nanotrack-v3", name) for name in ("yolox-nano", "follower-detector", None)),
        *(("correlation", name) for name in ("yolox-nano", None)),
    }
    assert {setup.vision for setup in setups if not setup.video} == {(*FUSED, "cpu")}
    assert setups[0].vision == (*FUSED, "cpu")
    assert all(
        {setup.size for setup in setups if setup.vision == seen} == {"640x480", "1280x720"}
        for seen in {setup.vision for setup in setups}
    )


def test_without_a_detector_there_are_trackers_alone() -> None:
    setups = plan(["correlation", "re3"], [], ["cpu"], [(640, 480)])
    assert [setup.name for setup in setups] == ["correlation", "correlation", "re3"]
    quick = plan(["re3", "correlation"], ["yolox-nano"], ["cpu"], [(640, 480)], quick=True)
    assert {(s.name, s.video) for s in quick} == {
        ("correlation + yolox-nano", True),
        ("correlation + yolox-nano", False),
        ("correlation", True),
    }


def test_a_result_comes_back_from_its_file(
    row: MakeRow, result: MakeResult, tmp_path: Path
) -> None:
    one = result(row(*FUSED, 640, 51.23456789), remarks=("no time",), note="somebody")
    (tmp_path / "bench.json").write_text(one.to_json())
    assert read_bench(tmp_path / "bench.json") == one


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("no JSON", "Invalid JSON"),
        ("[]", "should be an object"),
        ('{"kind": "follower bench"}', "name: Field required"),
        ('{"name": "x", "rows": []}', "Field required"),
    ],
)
def test_another_file_is_one_clear_line(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(SettingsError, match=why) as refused:
        read_bench(path)
    assert str(refused.value).startswith(f"{path}: no file that `follower bench` has written (")
    assert "\n" not in str(refused.value)


def test_figures_that_are_none_are_refused(
    row: MakeRow, result: MakeResult, tmp_path: Path
) -> None:
    data = json.loads(result(row(*FUSED, 640, 50.0)).to_json())
    data["rows"][0]["rate_hz"] = 0
    (tmp_path / "bench.json").write_text(json.dumps(data))
    with pytest.raises(SettingsError, match=r"rows\.0\.rate_hz: Input should be greater than 0"):
        read_bench(tmp_path / "bench.json")


def test_the_table_has_a_line_for_all_that_sees_and_a_star_where_the_target_was_lost(
    row: MakeRow, result: MakeResult
) -> None:
    head, rows = board_rows(
        result(
            row(*FUSED, 1280, 40.0, late_p99_ms=3.0),
            row(*FUSED, 640, 80.4, late_p99_ms=4.0),
            row(*FUSED, 640, 90.0, video=False),
            row("mil", None, 640, 9.0, on_target=0.1, device="cuda"),
        )
    )
    assert head == ("frames/s", "640x360", "1280x720", "late ms", "cores")
    assert rows == [
        ("nanotrack-v3 + yolox-nano", "80", "40", "4.0", "1.5"),
        ("nanotrack-v3 + yolox-nano, no video", "90", "–", "0.5", "1.5"),
        ("mil, cuda", "9 *", "–", "0.5", "1.5"),
    ]


def test_boards_stand_side_by_side_and_what_one_lacks_is_a_dash(
    row: MakeRow, result: MakeResult, tmp_path: Path
) -> None:
    one = result(row(*FUSED, 640, 80.0), row("re3", None, 640, 200.0), name="one")
    two = result(row(*FUSED, 640, 30.0), row(*FUSED, 1280, 20.0), name="two", note="by somebody")
    assert compared_rows([one, two]) == (
        ("frames/s", "size", "one", "two"),
        [
            ("nanotrack-v3 + yolox-nano", "640x360", "80", "30"),
            ("re3", "640x360", "200", "–"),
            ("nanotrack-v3 + yolox-nano", "1280x720", "–", "20"),
        ],
    )
    files = [tmp_path / "a.json", tmp_path / "b.json"]
    for file, board in zip(files, (one, two), strict=True):
        file.write_text(board.to_json())
    console = Console(file=StringIO(), width=200)
    assert compare(files, tmp_path / "out", console) == 0
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert "two (by somebody): Nothing measured holds 30 frames/s" in said
    picture = cv2.imread(str(tmp_path / "out" / "compared.png"))
    assert picture.shape[1] > 800
    assert picture.std() > 5


@pytest.mark.parametrize(
    ("names", "shown"),
    [(("board", "board"), ("board", "board (2)")), (("[/a]", "Pi [fan]"), ("[/a]", "Pi [fan]"))],
)
def test_each_board_is_shown_by_a_name_of_its_own(
    row: MakeRow,
    result: MakeResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    names: tuple[str, str],
    shown: tuple[str, str],
) -> None:
    files, drawn = [tmp_path / "a.json", tmp_path / "b.json"], []
    for file, name in zip(files, names, strict=True):
        file.write_text(result(row(*FUSED, 640, 80.0), name=name).to_json())
    monkeypatch.setattr(report, "_plot", lambda _axes, panel, _names: drawn.extend(panel.series))
    console = Console(file=StringIO(), width=200)
    assert compare(files, tmp_path, console) == 0
    head = console.file.getvalue().splitlines()[0]  # type: ignore[attr-defined]
    assert [name for name in shown if name in head] == list(shown)
    assert drawn == list(shown)


def test_the_picture_of_one_board_is_drawn(
    row: MakeRow, result: MakeResult, tmp_path: Path
) -> None:
    board = result(row(*FUSED, 640, 80.0), row(*FUSED, 1280, 40.0))
    picture = cv2.imread(str(draw_board(board, 37.5, tmp_path / "bench.png")))
    assert picture.shape[1] > 800
    assert picture.std() > 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--compare",), "give two or more files"),
        (("--compare", "gone.json", "gone.json"), "gone.json: cannot be read: No such file"),
        (("a.json",), "a.json: files are for --compare"),
    ],
)
def test_the_command_says_in_one_line_what_is_wrong(
    run_command: Callable[..., Any], arguments: tuple[str, ...], message: str
) -> None:
    ended = run_command("bench", *arguments)
    assert ended.code == 2
    assert message in ended.err
    assert ended.err.count("\n") == 1


def settings(*overrides: str) -> Any:
    return load_settings(overrides=("tracker=nanotrack-v3", "detector=yolox-nano", *overrides))


@pytest.fixture
def kept(row: MakeRow, result: MakeResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A last bench: 50 frames/s at 640x360, 20 at 1280x720; 90 with our own detector."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = last_bench()
    path.parent.mkdir()
    own = row("nanotrack-v3", "follower-detector", 640, 90.0)
    board = result(row(*FUSED, 640, 50.0), row(*FUSED, 1280, 20.0), own)
    path.write_text(board.to_json())
    return path


def test_a_flight_that_asks_for_more_than_was_held_is_told_so(kept: Path) -> None:
    assert more_than_held(settings(), (1280, 720), 30.0, kept) == (
        "Vision will leave frames out: nanotrack-v3 and yolox-nano held 20 frames/s at 1280x720 in "
        "this computer's last bench, and the camera gives 30 at 1280x720; `follower bench` advises."
    )
    assert "at 640x360" in (more_than_held(settings(), (800, 600), 60.0, kept) or "")
    embedded = settings("detector=embedded")
    assert "held 90" in (more_than_held(embedded, (640, 480), 100.0, kept) or "")


@pytest.mark.parametrize(
    ("overrides", "size", "rate_hz"),
    [
        ((), (1280, 720), 20.0),  # just what was held
        ((), (800, 600), 50.0),  # more pixels than what held 50; less than what held 20
        ((), (320, 240), 300.0),  # smaller than anything measured
        (("tracker=re3",), (1280, 720), 300.0),
        (("detector=null",), (1280, 720), 300.0),
        (("vision.device=cuda",), (1280, 720), 300.0),
        (("recorder.video=none",), (1280, 720), 300.0),
        (("fusion.algorithm=paper",), (1280, 720), 300.0),
    ],
)
def test_what_the_bench_does_not_tell_is_not_said(
    kept: Path, overrides: tuple[str, ...], size: tuple[int, int], rate_hz: float
) -> None:
    assert more_than_held(settings(*overrides), size, rate_hz, kept) is None


def test_no_bench_or_something_else_in_its_place_is_silence(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    assert more_than_held(settings(), (1280, 720), 300.0, path) is None
    for text in ("", "[1]", "{}", '{"rows": 3}', '{"rows": [{}]}', '{"rows": [null]}'):
        path.write_text(text)
        assert more_than_held(settings(), (1280, 720), 300.0, path) is None


@pytest.mark.slow
def test_a_flight_imports_nothing_else_of_the_bench() -> None:
    modules = python("import sys, follower.apps.fly.session; print(*sys.modules)").split()
    loaded = {name for name in modules if name.startswith("follower.apps.bench.")}
    assert loaded == {"follower.apps.bench.last"}


def test_the_measured_boards_that_come_along_can_be_compared() -> None:
    boards = sorted((Path(__file__).parents[4] / "benchmarks" / "boards").glob("*.json"))
    assert boards
    for board in boards:
        assert read_bench(board).note, board
        assert yaml.safe_load(advise(read_bench(board)).to_yaml())["tracker"]
