"""got10k-toolkit and vot-toolkit read our results and say our figures; VOT's runs our tracker.

They run in processes of their own, and nothing asks the network.
"""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from rich.console import Console

from follower.apps.evaluate.run import EvaluationPlan, evaluate

needs_got10k = pytest.mark.skipif(find_spec("got10k") is None, reason="got10k is not installed")
needs_vot = pytest.mark.skipif(find_spec("vot") is None, reason="vot-toolkit is not installed")
pytestmark = pytest.mark.slow

GOT10K = """
import json, sys, warnings
from got10k.experiments import ExperimentDTB70, ExperimentGOT10k, ExperimentOTB, ExperimentUAV123
root, folder, kind, name = sys.argv[1:]
kinds = {
    "otb": lambda: ExperimentOTB(root, "tb50", report_dir=folder),
    "uav123": lambda: ExperimentUAV123(root, report_dir=folder),
    "dtb70": lambda: ExperimentDTB70(root, report_dir=folder),
    "got10k": lambda: ExperimentGOT10k(root, report_dir=folder),
}
experiment = kinds[kind]()
experiment.result_dir = folder + "/got10k"
experiment.plot_curves = lambda *_: None
print(json.dumps(experiment.report([name])[name]["overall"]))
"""
VOT = """
import json, sys
from vot.analysis import AnalysisProcessor
from vot.experiment import run_experiment
from vot.utilities import ThreadPoolExecutor
from vot.workspace import Workspace
workspace = Workspace.load(sys.argv[1])
results = workspace.storage.substorage("results")
(tracker,) = workspace.registry.resolve(sys.argv[2], storage=results)
found = {}
with ThreadPoolExecutor(1) as pool, AnalysisProcessor(pool, {}) as processor:
    for experiment in workspace.stack:
        if sys.argv[3:] == ["run"]:
            run_experiment(experiment, tracker, workspace.dataset)
        for analysis in experiment.analyses:
            grid = processor.run(analysis, experiment, [tracker], workspace.dataset)
            found[experiment.identifier] = grid[0, 0]
print(json.dumps(found))
"""
EXPERIMENTS = {
    "unsupervised": {
        "type": "unsupervised",
        "repetitions": 2,
        "analyses": [{"type": "average_accuracy"}],
    }
}


def said(code: str, *arguments: str | Path) -> Any:
    """Run a program of a toolkit's user, and return the JSON of its last line."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-500:]
    return json.loads(done.stdout.splitlines()[-1])


def film(folder: Path, frames: int, seed: int, name: str = "{:04}.jpg") -> list[str]:
    """Write images of a patch that wanders, partly beyond the edges; return its boxes."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    scene = cv2.GaussianBlur(rng.integers(60, 120, (120, 160, 3)).astype(np.uint8), (0, 0), 3)
    size = 24
    patch = cv2.resize(rng.integers(0, 255, (6, 6, 3)).astype(np.uint8), (size, size))
    x, y, step, lines = 60.0, 40.0, 4.0, []
    for index in range(frames):
        left, top = round(x), round(y)
        image = cv2.copyMakeBorder(scene, 200, 200, 200, 200, cv2.BORDER_REFLECT)
        image[200 + top : 200 + top + size, 200 + left : 200 + left + size] = patch
        cv2.imwrite(str(folder / name.format(index + 1)), image[200:320, 200:360])
        lines.append(f"{left + 0.25 * (index % 3)},{top},{size + 0.5 * (index % 2)},{size}")
        step = -step if abs(x + step - 70) > 80 else step
        x, y = x + step * (1 + 0.5 * rng.random()), 0.7 * y + 12 + rng.normal(0, 3)
    return lines


def measured(data: Path, out: Path, *trackers: str) -> tuple[Path, dict[str, dict[str, Any]]]:
    """Evaluate trackers, and return the folder and what we say of the toolkits' figures."""
    assert evaluate(EvaluationPlan((data,), trackers, out=out), Console(quiet=True)) == 0
    (folder,) = out.iterdir()
    stored = json.loads((folder / "results.json").read_text())
    return folder, {row["tracker"]: row for row in stored["toolkits"]}


def agrees(ours: dict[str, Any], theirs: dict[str, Any], **names: str) -> None:
    for mine, its in names.items():
        assert ours[mine] == pytest.approx(theirs[its], abs=1e-6), (mine, its)


OTB_FIGURES = {
    "otb_success": "success_score",
    "otb_precision": "precision_score",
    "otb_rate": "success_rate",
}


def otb(root: Path) -> None:
    for name, seed in (("Car4", 1), ("Walking", 2)):
        lines = film(root / name / "img", 16, seed)
        (root / name / "groundtruth_rect.txt").write_text("\n".join(lines))


@needs_got10k
@pytest.mark.parametrize("kind", ["otb", "dtb70"])
def test_got10k_toolkit_says_our_figures_of_otb_and_dtb70(tmp_path: Path, kind: str) -> None:
    otb(tmp_path / "data")
    folder, ours = measured(tmp_path / "data", tmp_path / "runs", "correlation", "identity")
    if kind == "otb":  # it downloads the sequences that have no folder
        from got10k.datasets import OTB

        for name in OTB._OTB__tb50_seqs:  # type: ignore[attr-defined]
            (tmp_path / "data" / name).mkdir(exist_ok=True)
    for tracker in ("correlation", "identity"):
        theirs = said(GOT10K, tmp_path / "data", folder, kind, tracker)
        agrees(ours[tracker], theirs, **OTB_FIGURES)
    assert theirs["success_rate"] < 0.5 < ours["correlation"]["otb_rate"]


@needs_got10k
def test_got10k_toolkit_says_our_figures_of_uav123_with_absent_frames(tmp_path: Path) -> None:
    import got10k.datasets

    meta = Path(got10k.datasets.__file__).with_name("uav123.json")
    known = json.loads(meta.read_text())["UAV123"]
    name = min(known, key=lambda one: known[one]["end_frame"])
    first, last, root = known[name]["start_frame"], known[name]["end_frame"], tmp_path / "data"
    images = root / "data_seq" / "UAV123" / known[name]["folder_name"]
    lines = film(images, last, 3, "{:06}.jpg")[first - 1 :]
    lines[10:14] = ["NaN,NaN,NaN,NaN"] * 4
    (root / "anno" / "UAV123" / "att").mkdir(parents=True)
    (root / "anno" / "UAV123" / f"{name}.txt").write_text("\n".join(lines))
    for extra in ("readme", "configs"):  # it wants four entries
        (root / extra).mkdir()
    folder, ours = measured(root, tmp_path / "runs", "correlation")
    agrees(ours["correlation"], said(GOT10K, root, folder, "uav123", "correlation"), **OTB_FIGURES)


@needs_got10k
def test_got10k_toolkit_says_our_average_overlap_of_covered_and_cut_targets(tmp_path: Path) -> None:
    names = []
    for number, frames in ((1, 16), (2, 30)):
        name = f"GOT-10k_Val_{number:06}"
        names.append(name)
        folder = tmp_path / "data" / "val" / name
        lines = film(folder, frames, number, "{:08}.jpg")
        (folder / "groundtruth.txt").write_text("\n".join(lines))
        absent = [0] * 8 + [1] * 3 + [0] * (frames - 11)
        cover = [8] * 7 + [2] + [0] * 3 + [8] * (frames - 11)
        for label, values in (("absence", absent), ("cover", cover), ("cut_by_image", absent)):
            (folder / f"{label}.label").write_text("\n".join(map(str, values)))
        (folder / "meta_info.ini").write_text("[METAINFO]\nresolution: (160, 120)\n")
    (tmp_path / "data" / "val" / "list.txt").write_text("\n".join(names))
    data = tmp_path / "data"
    folder, ours = measured(data, tmp_path / "runs", "correlation", "identity")
    for tracker in ("correlation", "identity"):
        theirs = said(GOT10K, data, folder, "got10k", tracker)
        agrees(ours[tracker], theirs, got10k_ao="ao", got10k_sr="sr")


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace of vot-toolkit with two sequences, with our tracker as a command."""
    root = tmp_path / "workspace"
    for name, frames in (("ball", 34), ("gymnast", 22)):
        folder = root / "sequences" / name
        lines = film(folder / "color", frames, frames, "{:08}.jpg")
        lines[6] = "nan,nan,nan,nan"
        (folder / "groundtruth.txt").write_text("\n".join(lines))
        (folder / "sequence").write_text(
            f"channels.color=color/%08d.jpg\nfps=30\nlength={frames}\nwidth=160\nheight=120\n"
        )
    (root / "sequences" / "list.txt").write_text("ball\ngymnast\n")
    stack = {"title": "two sequences", "experiments": EXPERIMENTS}
    (root / "stack.yaml").write_text(yaml.safe_dump(stack))
    (root / "config.yaml").write_text("stack: ./stack.yaml\nregistry: [./trackers.ini]\n")
    command = f"{sys.executable} -m follower trax correlation"
    section = f"[correlation]\nlabel = ours\nprotocol = trax\ncommand = {command}\n"
    (root / "trackers.ini").write_text(section)
    return root


@needs_vot
def test_vot_toolkit_says_our_accuracy_of_the_files_that_we_write(
    workspace: Path, tmp_path: Path
) -> None:
    folder, ours = measured(workspace / "sequences", tmp_path / "runs", "correlation")
    (workspace / "results").symlink_to(folder / "vot")
    (accuracy,) = said(VOT, workspace, "correlation")["unsupervised"]
    assert ours["correlation"]["vot_accuracy"] == pytest.approx(accuracy, abs=1e-6)
    assert 0.1 < accuracy < 1


@needs_vot
def test_vot_toolkit_runs_our_tracker_itself_several_times_in_one_process(
    workspace: Path, tmp_path: Path
) -> None:
    (accuracy,) = said(VOT, workspace, "correlation", "run")["unsupervised"]
    _, ours = measured(workspace / "sequences", tmp_path / "runs", "correlation")
    assert ours["correlation"]["vot_accuracy"] == pytest.approx(accuracy, abs=1e-6)
    ran = workspace / "results" / "correlation" / "unsupervised"
    for name in ("ball", "gymnast"):
        first, again = (ran / name / f"{name}_{number:03}.bin" for number in (1, 2))
        assert first.read_bytes() == again.read_bytes()


def trax(*requests: str) -> subprocess.CompletedProcess[str]:
    """Run the server on lines, as a client in any language would."""
    command = [sys.executable, "-m", "follower", "trax", "correlation"]
    text = "".join(f"{line}\n" for line in requests)
    return subprocess.run(
        command, input=text, capture_output=True, text=True, timeout=100, check=False
    )


def test_a_trax_client_chooses_again_and_again_and_quits(tmp_path: Path) -> None:
    boxes = film(tmp_path / "a film", 3, 1)
    images = [f'"file://{path}"' for path in sorted((tmp_path / "a film").iterdir())]
    done = trax(
        f'@@TRAX:initialize {images[0]} "{boxes[0]}"',
        f"@@TRAX:frame {images[1]}",
        "what else the program prints",
        f'@@TRAX:initialize {images[2]} "{boxes[2]}" "key=value"',
        "@@TRAX:quit",
        "@@TRAX:frame nothing",
    )
    assert (done.returncode, done.stderr) == (0, "")
    hello, *states = done.stdout.splitlines()
    assert hello.startswith("@@TRAX:hello trax.version=3 ")
    found = [np.array(line.split('"')[1].split(","), float) for line in states]
    truth = [np.array(line.split(","), float) for line in boxes]
    assert len(found) == 3
    assert found[0] == pytest.approx(truth[0])
    assert found[1] == pytest.approx(truth[1], abs=3)
    assert found[2] == pytest.approx(truth[2])
    assert all("confidence=" in line for line in states)


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        ("@@TRAX:frame {image}", "a frame before any target was chosen"),
        ("@@TRAX:initialize {image} 500,500,10,10", "lies outside the 160x120 image"),
        ("@@TRAX:initialize {image} 1,2,3", "no box in '1,2,3'"),
        ("@@TRAX:initialize {image}.gone 1,2,3,4", "cannot read the image"),
        ("@@TRAX:jump", "no request in '@@TRAX:jump'"),
        ('@@TRAX:frame "', "no message in"),
    ],
)
def test_what_a_client_asks_wrongly_ends_in_one_line_that_it_is_told_too(
    tmp_path: Path, request_: str, why: str
) -> None:
    film(tmp_path, 1, 1)
    done = trax(request_.format(image=tmp_path / "0001.jpg"))
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert last.startswith("follower: TraX: ")
    assert why in last
    assert "Traceback" not in done.stderr
    assert done.stdout.splitlines()[-1].startswith('@@TRAX:quit "trax.reason=')
