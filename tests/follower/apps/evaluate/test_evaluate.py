"""`follower evaluate` from folder to report."""

import csv
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from plugin_packages import TRACKER, installed
from real_data import DATA, needs_data
from rich.console import Console

from follower.apps.evaluate import run as evaluation
from follower.apps.evaluate.contender import Contender, EvaluationResult, RunStart
from follower.apps.evaluate.output_files import difference_texts, terminal_tables
from follower.apps.evaluate.run import EvaluationPlan, evaluate
from follower.apps.evaluate.scores import Difference, differences, rows, scored
from follower_control.common.strict_config import SettingsError
from follower_vision.evaluation.intervals import PairedDifference
from follower_vision.evaluation.one_pass import Sequence
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import TrackState

REFERENCE = Path(__file__).parents[5] / "shared" / "tools" / "ope_reference.py"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A textured patch that moves 3 px a frame to the right."""
    folder = tmp_path / "data" / "patch"
    (folder / "img").mkdir(parents=True)
    rng = np.random.default_rng(1)
    scene = cv2.GaussianBlur(rng.integers(60, 120, (120, 160, 3)).astype(np.uint8), (0, 0), 3)
    patch = cv2.resize(rng.integers(0, 255, (6, 6, 3)).astype(np.uint8), (24, 24))
    lines = []
    for index in range(16):
        image = scene.copy()
        image[40:64, 20 + 3 * index : 44 + 3 * index] = patch
        cv2.imwrite(str(folder / "img" / f"{index:04}.png"), image)
        lines.append(f"{20 + 3 * index},40,24,24")
    (folder / "groundtruth.txt").write_text("\n".join(lines))
    return folder.parent


def quiet() -> Console:
    return Console(quiet=True)


@pytest.mark.slow
def test_correlation_beats_identity_and_everything_is_written(data: Path, tmp_path: Path) -> None:
    others = tmp_path / "others"
    others.mkdir()
    truth = (data / "patch" / "groundtruth.txt").read_text()
    (others / "patch.txt").write_text(truth)
    assert (
        evaluate(
            EvaluationPlan(
                (data,),
                ("identity", "correlation"),
                boxes=(f"oracle={others}",),
                tre=2,
                sre=True,
                out=tmp_path / "runs",
            ),
            quiet(),
        )
        == 0
    )
    folder = tmp_path / "runs" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    success = {(m["tracker"], m["start"]): m["success@0.5"] for m in stored["means"]}
    assert success["oracle", "ope"] == 1.0
    assert success["correlation", "ope"] > 0.9 > 0.4 > success["identity", "ope"]
    assert {start for _, start in success} == {"ope", "tre", "sre"}
    assert len((folder / "results.csv").read_text().splitlines()) == 1 + 2 * (1 + 2 + 12) + 1
    page = (folder / "report.html").read_text()
    assert page.count("data:image/jpeg") == 1
    assert "missed by identity" in page
    assert "http" not in page


def reference() -> ModuleType:
    if not REFERENCE.is_file():
        pytest.skip("no reference scores in ../shared/tools")
    spec = importlib.util.spec_from_file_location("ope_reference", REFERENCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_is_written_agrees_with_the_independent_reference(data: Path, tmp_path: Path) -> None:
    score = reference().score
    lines = (data / "patch" / "groundtruth.txt").read_text().splitlines()
    lines[5] = "0,0,0,0"
    (data / "patch" / "groundtruth.txt").write_text("\n".join(lines))
    evaluate(EvaluationPlan((data,), ("correlation", "identity"), out=tmp_path / "r"), quiet())
    folder = tmp_path / "r" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    truth = [tuple(map(float, line.split(","))) for line in lines]
    for run in stored["runs"]:
        boxes = folder / "boxes" / run["tracker"] / "patch" / "ope-0.json"
        _, result = json.loads(boxes.read_text())
        expected = score([Box(**box).xywh for box in result["boxes"]], truth)
        assert run["auc"] == pytest.approx(expected["auc"], abs=1e-9)
        assert run["success@0.5"] == pytest.approx(expected["success"], abs=1e-9)
        assert run["precision@20"] == pytest.approx(expected["precision"], abs=1e-9)


def test_attributes_are_scored_over_their_frames(data: Path, tmp_path: Path) -> None:
    (data / "patch" / "fast_motion.tag").write_text("0\n" * 8 + "1\n" * 8)
    (data / "patch" / "attrs.txt").write_text("SV, nowhere")
    evaluate(EvaluationPlan((data,), ("identity",), out=tmp_path / "r"), quiet())
    folder = tmp_path / "r" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    found = {row["attribute"]: row for row in stored["attributes"]}
    assert set(found) == {"fast motion", "scale variation", "nowhere"}
    assert (found["fast motion"]["frames"], found["fast motion"]["sequences"]) == (8, 1)
    assert found["fast motion"]["success@0.5"] == 0
    assert found["scale variation"]["success@0.5"] == stored["runs"][0]["success@0.5"] > 0
    assert "fast motion (1)" in (folder / "report.html").read_text()


def test_states_are_told_of_trackers_that_have_some(data: Path, tmp_path: Path) -> None:
    console = Console(record=True, width=160, quiet=False, file=StringIO())
    evaluate(
        EvaluationPlan((data,), ("fusion:correlation+none", "correlation"), out=tmp_path / "r"),
        console,
    )
    folder = tmp_path / "r" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    states = {row["tracker"]: row["states"] for row in stored["means"]}
    assert states["correlation"] is None
    assert states["fusion:correlation+none"]["tracking at iou 0"] == 0
    assert "no states: correlation" in console.export_text()
    rows = list(csv.DictReader(StringIO((folder / "results.csv").read_text())))
    assert [row["tracking at iou 0"] for row in rows] == ["0.0", ""]
    assert "No states are known of correlation." in (folder / "report.html").read_text()


def test_a_sequence_weighs_the_same_however_many_starts_it_has() -> None:
    """One wrong run of a sequence, three right ones of another: wrong in half of the sequences."""
    there, far = Box(50, 50, 20, 20), Box(500, 50, 20, 20)
    runs = []
    for name, box, count in (("a", far, 1), ("b", there, 3)):
        sequence = Sequence(name, tuple(Path(f"{k}.png") for k in range(9)), (there,) * 9)
        states = (TrackState.TRACKING,) * 9
        result = EvaluationResult((there, *[box] * 8), states=states)
        start = RunStart("tre", 0, 0, there)
        runs += [scored("one", sequence, start, 30.0, result)] * count
    (row,) = rows(runs)
    assert (row.score.success, row.states.false_tracking) == (0.5, 0.5)


def test_tables_of_long_names_are_whole_on_eighty_columns() -> None:
    there, states = Box(50, 50, 20, 20), (TrackState.TRACKING,) * 9
    runs = []
    for name in ("fusion-paper:siamese-correlation+fastestdet", "fusion:nanotrack-v3+yolox-nano"):
        for place in ("a", "b"):
            truth = (there, None, *(there,) * 7)
            sequence = Sequence(place, tuple(Path(f"{k}.png") for k in range(9)), truth)
            result = EvaluationResult((there,) * 9, states, (0.0125,) * 9, 0.1)
            runs.append(scored(name, sequence, RunStart("ope", 0, 0, there), 30.0, result))
    console = Console(record=True, width=80, file=StringIO())
    for table in terminal_tables(rows(runs), differences(runs)):
        console.print(table)
    shown = console.export_text()
    assert "…" not in shown
    assert shown.count("0.952  1.000  1.000  1.000   80    12.5") == 2
    assert shown.count("+0.000  [+0.000, +0.000]  1.000") == 3
    assert shown.count("0.0 %  100.0 %      0.0 %      0.00") == 2


@pytest.mark.parametrize(
    ("first", "said"),
    [
        ("-400,-300,30,30", "skipped other: the box to start from, -400,-300,30,30, lies outside"),
        (
            "-10,-10,30,30",
            "other: the first box lies partly outside the image, and trackers started",
        ),
    ],
)
def test_a_first_box_outside_the_image_skips_and_partly_outside_is_clipped(
    data: Path, tmp_path: Path, first: str, said: str
) -> None:
    shutil.copytree(data / "patch", data / "other")
    lines = (data / "other" / "groundtruth.txt").read_text().splitlines()
    (data / "other" / "groundtruth.txt").write_text("\n".join([first, *lines[1:]]))
    console = Console(record=True, width=160, file=StringIO())
    names = ("correlation", "fusion:correlation+none")
    assert evaluate(EvaluationPlan((data,), names, out=tmp_path / "r"), console) == 0
    (line,) = [one for one in console.export_text().splitlines() if said in one]
    assert "Traceback" not in line
    results = json.loads((tmp_path / "r" / "evaluate" / "results.json").read_text())
    sequences = {run["sequence"] for run in results["runs"]}
    assert sequences == ({"patch"} if "skipped" in said else {"patch", "other"})


@pytest.mark.slow
@pytest.mark.parametrize("first", ["-23.8,40,24,24", "159.9,119.9,24,24", "-500,-500,1200,1200"])
def test_a_sliver_of_a_first_box_is_enough_or_skips_its_sequence_in_one_line(
    data: Path, tmp_path: Path, first: str
) -> None:
    shutil.copytree(data / "patch", data / "other")
    lines = (data / "other" / "groundtruth.txt").read_text().splitlines()
    (data / "other" / "groundtruth.txt").write_text("\n".join([first, *lines[1:]]))
    for number, (names, measured) in enumerate(
        [(("correlation", "re3", "fusion:correlation+none"), 2), (("mil",), 1)]
    ):
        console = Console(record=True, width=160, file=StringIO())
        out = tmp_path / str(number)
        assert evaluate(EvaluationPlan((data,), names, out=out), console) == 0
        results = json.loads((out / "evaluate" / "results.json").read_text())
        assert len(results["runs"]) == measured * len(names)
        (line,) = [one for one in console.export_text().splitlines() if "other: " in one]
        assert ("skipped other: mil cannot start there" in line) == (measured == 1)


def copies(data: Path, number: int) -> list[str]:
    """Make more sequences of the first one, each starting a frame later; return all names."""
    lines = (data / "patch" / "groundtruth.txt").read_text().splitlines()
    for index in range(1, number):
        folder = data / f"patch-{index}"
        shutil.copytree(data / "patch", folder)
        (folder / "groundtruth.txt").write_text("\n".join(lines[index:]))
        for path in sorted((folder / "img").iterdir())[:index]:
            path.unlink()
    return sorted(path.name for path in data.iterdir())


@pytest.mark.slow
def test_means_have_intervals_and_trackers_are_compared_in_pairs(
    data: Path, tmp_path: Path
) -> None:
    copies(data, 6)
    console = Console(record=True, width=160, file=StringIO())
    evaluate(EvaluationPlan((data,), ("identity", "correlation"), out=tmp_path / "r"), console)
    folder = tmp_path / "r" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    for mean in stored["means"]:
        low, high = mean["intervals"]["auc"]
        values = [run["auc"] for run in stored["runs"] if run["tracker"] == mean["tracker"]]
        assert min(values) - 1e-9 <= low <= mean["auc"] + 1e-9
        assert mean["auc"] - 1e-9 <= high <= max(values) + 1e-9
    found = {one["figure"]: one for one in stored["differences"]}
    assert set(found) == {"auc", "success@0.5", "precision@20"}
    one = found["auc"]
    assert (one["tracker"], one["reference"], one["sequences"]) == ("correlation", "identity", 6)
    means = {mean["tracker"]: mean["auc"] for mean in stored["means"]}
    assert one["mean"] == pytest.approx(means["correlation"] - means["identity"])
    assert 0 < one["low"] < one["mean"] < one["high"]
    assert one["p"] == pytest.approx(2 / 2**6, abs=0.006)
    page = (folder / "report.html").read_text()
    for shown in ("<h2>Differences</h2>", "95 % bootstrap intervals", f"{one['mean']:+.3f}"):
        assert shown in page
    assert f"{one['p']:.3f}" in console.export_text()


@pytest.mark.parametrize(
    ("p", "shown"),
    [(0.0, "< 0.001"), (0.0009, "< 0.001"), (0.001, "0.001"), (0.04, "0.040"), (1.0, "1.000")],
)
def test_a_small_p_is_no_zero(p: float, shown: str) -> None:
    one = Difference("a", "b", "ope", "auc", 9, PairedDifference(0.1, 0.05, 0.15, p))
    assert difference_texts(one)[-1] == shown


def test_a_single_sequence_has_no_interval_and_no_test(data: Path, tmp_path: Path) -> None:
    evaluate(EvaluationPlan((data,), ("identity", "correlation"), out=tmp_path / "r"), quiet())
    folder = tmp_path / "r" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    assert stored["differences"] == []
    assert [mean["intervals"] for mean in stored["means"]] == [{}, {}]
    assert "Differences" not in (folder / "report.html").read_text()


KILLED = """
import os, signal
from pathlib import Path

class Deadly(Follows):
    name = "deadly"
    starts = 0
    def start(self, image, box):
        Deadly.starts += 1
        super().start(image, box)
    def update(self, image):
        if Deadly.starts == 3 and not Path(os.environ["SURVIVES"]).exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return super().update(image)

def make(find_file, device):
    return Deadly()
"""


@pytest.mark.slow
def test_an_evaluation_that_was_killed_goes_on_where_it_was(data: Path, tmp_path: Path) -> None:
    names = copies(data, 5)
    survives = tmp_path / "survives"
    with installed(tmp_path / "site") as site:
        site.add("deadly-tracker", "trackers", "deadly", TRACKER + KILLED)
    paths = [str(site.folder), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "SURVIVES": str(survives)}

    def run(*options: str) -> subprocess.CompletedProcess[str]:
        arguments = [str(data), "--trackers", "correlation,deadly", *options]
        command = [sys.executable, "-m", "follower", "evaluate", *arguments]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=200, check=False
        )

    killed = run("--out", str(tmp_path / "runs"))
    folder = tmp_path / "runs" / "evaluate"
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert f"--resume {folder}" in killed.stdout.replace("\n", "")
    done = {path: path.stat().st_mtime_ns for path in (folder / "boxes").rglob("*.json")}
    assert len(done) == len(names) + 2
    assert not (folder / "results.json").exists()
    survives.touch()
    resumed = run("--resume", str(folder))
    assert resumed.returncode == 0, resumed.stderr
    assert {path: path.stat().st_mtime_ns for path in done} == done
    whole = run("--out", str(tmp_path / "whole"))
    assert whole.returncode == 0, whole.stderr
    ours, theirs = (
        json.loads((one / "results.json").read_text())
        for one in (folder, tmp_path / "whole" / "evaluate")
    )
    assert len(ours["runs"]) == 2 * len(names)
    for part in ("differences", "toolkits", "attributes"):
        assert ours[part] == theirs[part]
    for one in ("auc", "success@0.5", "precision@20"):
        assert [run[one] for run in ours["runs"]] == [run[one] for run in theirs["runs"]]


def test_a_tracker_is_told_the_data_sets_own_frame_rate(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (data / "patch" / "sequence").write_text("fps=12\n")
    rates = []
    real = evaluation.run
    monkeypatch.setattr(evaluation, "run", lambda *given: rates.append(given[3]) or real(*given))
    evaluate(EvaluationPlan((data,), ("identity",), out=tmp_path / "r"), quiet())
    assert rates == [12.0]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("correlation", ("", "correlation", "")),
        ("fusion:correlation+none", ("fusion", "correlation", "none")),
        ("fusion", ("fusion", "nanotrack-v3", "yolox-nano")),
        ("fusion-paper", ("fusion-paper", "nanotrack-v3", "yolox-nano")),
        ("fusion+fastestdet", ("fusion", "nanotrack-v3", "fastestdet")),
        ("fusion-paper:mil+fastestdet", ("fusion-paper", "mil", "fastestdet")),
    ],
)
def test_a_name_says_kind_motion_tracker_and_detector(
    name: str, expected: tuple[str, str, str]
) -> None:
    contender = Contender(name, "yolox-nano")
    assert (contender.kind, contender.motion, contender.detector) == expected


@needs_data("weights", "sequences")
@pytest.mark.slow
def test_fusion_is_measured_with_its_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOLLOWER_MODELS", str(DATA / "weights"))
    sequence = DATA / "sequences" / "uav123_wakeboard7"
    assert (
        evaluate(
            EvaluationPlan((sequence,), ("fusion", "fusion-paper"), out=tmp_path / "r"), quiet()
        )
        == 0
    )
    stored = json.loads((tmp_path / "r/evaluate/results.json").read_text())
    runs = {run["tracker"]: run for run in stored["runs"]}
    assert set(runs) == {"fusion", "fusion-paper"}
    assert all(0 <= run["states"]["tracking at iou 0"] <= 1 for run in runs.values())
    assert runs["fusion"]["success@0.5"] > 0.5


@pytest.mark.parametrize(
    "name", ["nobody", "fusion:nobody", "csrt+x", "correlation:mil", "fusion-paper+none", ""]
)
def test_a_name_that_nobody_knows_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match="--trackers"):
        Contender(name, "yolox-nano")


@pytest.mark.slow
@pytest.mark.parametrize("file", ["patch.txt", "patch/patch_001.txt"])
def test_another_programs_boxes_are_found(data: Path, tmp_path: Path, file: str) -> None:
    boxes = tmp_path / "others" / file
    boxes.parent.mkdir(parents=True)
    boxes.write_text((data / "patch" / "groundtruth.txt").read_text())
    assert (
        evaluate(
            EvaluationPlan(
                (data,), (), boxes=(f"oracle={tmp_path / 'others'}",), out=tmp_path / "runs"
            ),
            quiet(),
        )
        == 0
    )
    (row,) = csv.DictReader((tmp_path / "runs/evaluate/results.csv").read_text().splitlines())
    assert (row["tracker"], row["success@0.5"], row["fps"]) == ("oracle", "1.0", "")


def test_a_name_with_brackets_is_shown_as_it_is(data: Path, tmp_path: Path) -> None:
    console = Console(record=True, width=160, file=StringIO())
    (tmp_path / "patch.txt").write_text((data / "patch" / "groundtruth.txt").read_text())
    plan = EvaluationPlan((data,), (), boxes=(f"[/v2]={tmp_path}",), out=tmp_path / "r")
    assert evaluate(plan, console) == 0
    assert "[/v2]" in console.export_text()


def test_a_name_that_would_be_a_formula_is_drawn_as_it_is(data: Path, tmp_path: Path) -> None:
    for name in copies(data, 3):
        (tmp_path / f"{name}.txt").write_text((data / name / "groundtruth.txt").read_text())
    boxes = (rf"$\frac$={tmp_path}", f"$v_2$={tmp_path}")
    assert evaluate(EvaluationPlan((data,), (), boxes=boxes, out=tmp_path / "r"), quiet()) == 0
    page = (tmp_path / "r/evaluate/report.html").read_text()
    drawn = re.findall(r"<text[^>]*>(?:\d[.]\d+ )?([^<]*[$][^<]*)</text>", page)
    axis = r"AUC minus that of $\frac$, with 95 % intervals"
    assert set(drawn) == {r"$\frac$", "$v_2$", axis}


@pytest.mark.slow
def test_two_processes_measure_what_one_does(data: Path, tmp_path: Path) -> None:
    names = copies(data, 3)
    measured = []
    for workers in (0, 2):
        out = tmp_path / str(workers)
        trackers = ("identity", "correlation")
        assert evaluate(EvaluationPlan((data,), trackers, out=out, workers=workers), quiet()) == 0
        results = json.loads((out / "evaluate" / "results.json").read_text())
        whole = [(run["tracker"], run["sequence"], run["auc"]) for run in results["runs"]]
        stored = [
            (path.relative_to(out), json.loads(path.read_text())[1]["boxes"])
            for path in sorted((out / "evaluate" / "boxes").rglob("*.json"))
        ]
        measured.append((whole, stored))
    assert len(measured[0][0]) == 2 * len(names)
    assert measured[0] == measured[1]


def test_a_folder_of_something_else_is_not_gone_on_with(data: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    report.write_text("of a flight", "utf-8")
    with pytest.raises(SettingsError, match="no evaluation was begun there"):
        evaluate(EvaluationPlan((data,), ("identity",), resume=tmp_path), quiet())
    assert report.read_text("utf-8") == "of a flight"


def test_an_interrupt_leaves_what_was_finished(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = evaluation.run

    def interrupted(contender, *given):
        if contender.name == "correlation":
            raise KeyboardInterrupt
        return real(contender, *given)

    monkeypatch.setattr(evaluation, "run", interrupted)
    assert (
        evaluate(
            EvaluationPlan((data,), ("identity", "correlation"), out=tmp_path / "runs"), quiet()
        )
        == 130
    )
    done = list((tmp_path / "runs" / "evaluate" / "boxes").rglob("*.json"))
    assert [path.parent.parent.name for path in done] == ["identity"]


def test_an_unreadable_image_skips_its_sequence_by_name(data: Path, tmp_path: Path) -> None:
    (data / "patch" / "img" / "0005.png").write_bytes(b"no image")
    with pytest.raises(SettingsError, match="patch"):
        evaluate(EvaluationPlan((data,), ("identity",), out=tmp_path / "runs"), quiet())


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", [["missing"], [".", "--trackers", "nobody"], [".", "--boxes", "x"]]
)
def test_bad_input_ends_in_one_line_and_code_2(
    run_command: Callable[..., Any], arguments: list[str]
) -> None:
    done = run_command("evaluate", *arguments)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    assert done.err.startswith("follower: ")


def test_a_name_is_one_trackers(data: Path, tmp_path: Path) -> None:
    """Two of one name would be averaged."""
    boxes = f"identity={data}"
    with pytest.raises(SettingsError, match="there is a tracker identity already"):
        evaluate(EvaluationPlan((data,), ("identity",), boxes=(boxes,), out=tmp_path))
