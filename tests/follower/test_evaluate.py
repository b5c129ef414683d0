"""`follower evaluate` from folder to report."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from follower.evaluate import evaluation
from follower.evaluate.evaluation import EvaluateOptions, evaluate
from follower_control.strict_yaml import SettingsError


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


def test_correlation_beats_identity_and_everything_is_written(data: Path, tmp_path: Path) -> None:
    others = tmp_path / "others"
    others.mkdir()
    truth = (data / "patch" / "groundtruth.txt").read_text()
    (others / "patch.txt").write_text(truth)
    options = EvaluateOptions(
        (data,), ("identity", "correlation"), boxes=(f"oracle={others}",), tre=2, sre=True,
        out=tmp_path / "runs",
    )  # fmt: skip
    assert evaluate(options, quiet()) == 0
    folder = tmp_path / "runs" / "evaluate"
    stored = json.loads((folder / "results.json").read_text())
    success = {(m["tracker"], m["start"]): m["success@0.5"] for m in stored["means"]}
    assert success["oracle", "ope"] == 1.0
    assert success["correlation", "ope"] > 0.9 > 0.4 > success["identity", "ope"]
    assert {start for _, start in success} == {"ope", "tre", "sre"}
    assert len((folder / "results.csv").read_text().splitlines()) == 1 + 2 * (1 + 2 + 12) + 1
    page = (folder / "report.html").read_text()
    assert page.count("data:image/jpeg") == 4
    assert "http" not in page


def test_resuming_runs_only_what_is_missing(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = EvaluateOptions((data,), ("identity", "correlation"), out=tmp_path / "runs")
    evaluate(options, quiet())
    folder = tmp_path / "runs" / "evaluate"
    (folder / "boxes" / "identity" / "patch" / "ope-0.json").unlink()
    ran = []
    real = evaluation.run
    monkeypatch.setattr(evaluation, "run", lambda *given: ran.append(given[0].name) or real(*given))
    again = EvaluateOptions((data,), ("identity", "correlation"), resume=folder)
    assert evaluate(again, quiet()) == 0
    assert ran == ["identity"]


def test_an_interrupt_leaves_what_was_finished(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = evaluation.run

    def interrupted(contender, *given):
        if contender.name == "correlation":
            raise KeyboardInterrupt
        return real(contender, *given)

    monkeypatch.setattr(evaluation, "run", interrupted)
    options = EvaluateOptions((data,), ("identity", "correlation"), out=tmp_path / "runs")
    assert evaluate(options, quiet()) == 130
    done = list((tmp_path / "runs" / "evaluate" / "boxes").rglob("*.json"))
    assert [path.parent.parent.name for path in done] == ["identity"]


def test_an_unreadable_image_skips_its_sequence_by_name(data: Path, tmp_path: Path) -> None:
    (data / "patch" / "img" / "0005.png").write_bytes(b"no image")
    with pytest.raises(SettingsError, match="patch"):
        evaluate(EvaluateOptions((data,), ("identity",), out=tmp_path / "runs"), quiet())


@pytest.mark.parametrize(
    "arguments", [["missing"], [".", "--trackers", "nobody"], [".", "--boxes", "x"]]
)
def test_bad_input_ends_in_one_line_and_code_2(tmp_path: Path, arguments: list[str]) -> None:
    code = "from follower.cli import main; main()"
    command = [sys.executable, "-c", code, "evaluate", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stderr.startswith("follower: ")
