"""Compare the correlation tracker with OpenCV's CSRT: accuracy and time, side by side.

    python benchmarks/csrt.py SEQUENCES [--environment FOLDER] [--threads N] [--only NAME ...]

SEQUENCES is a folder of folders with `img/` and `groundtruth.txt`. CSRT lives in
opencv-contrib-python-headless, which cannot share an environment with opencv-python-headless: the
first run makes one for it (python -m venv, pip install) in FOLDER, by default in the user's cache.

Both trackers run in a process of their own, one after the other on every sequence, so that a
machine that is busy for a while slows both. Each starts from the first true box and is never
helped. `ms` is the median time of an update within a sequence by the clock, `cpu ms` in the
processor (all threads), reading the image left out; the last line has the means over the sequences.
On a busy machine believe the processor's. N is OpenCV's number of threads, 0 for its own choice;
numpy's linear algebra has one.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

import command_line

from follower_vision.evaluation.datasets import load_dataset
from follower_vision.evaluation.metrics import OpeScore, mean_score, ope_score
from follower_vision.evaluation.one_pass import Sequence
from follower_vision.geometry.box import Box
from follower_vision.sources.frame_source import ClosesItself

WORKER = Path(__file__).with_name("csrt_worker.py")
PACKAGE = "opencv-contrib-python-headless>=5.0,<6"


@dataclass(frozen=True)
class Result:
    """One tracker over one sequence: score, median time of an update by clock and processor."""

    score: OpeScore
    milliseconds: float
    processor_ms: float


class Worker(ClosesItself):
    """A tracker in a process of its own."""

    def __init__(self, python: Path, tracker: str, threads: int) -> None:
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [python, WORKER, tracker, str(threads)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )

    def close(self) -> None:
        """End the process."""
        self._process.communicate()

    def run(self, sequence: Sequence) -> Result:
        """Track through one sequence.

        Raises:
            RuntimeError: the worker ended; what it had to say is on the standard error.
        """
        request = {"images": [str(path) for path in sequence.images], "box": sequence.initial.xywh}
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a tracker's process ended on {sequence.name}")
        answer = json.loads(line)
        boxes = [_box(xywh) for xywh in answer["boxes"]]
        milliseconds = statistics.median(answer["update_s"]) * 1e3
        processor_ms = statistics.median(answer["processor_s"]) * 1e3
        return Result(ope_score(boxes, sequence.truth), milliseconds, processor_ms)


def _box(xywh: list[float] | None) -> Box | None:
    if xywh is None or min(xywh[2:]) <= 0:
        return None
    return Box.from_xywh(*xywh)


def csrt_python(folder: Path) -> Path:
    """Return the interpreter of an environment that has CSRT, made in `folder` where missing."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    ready = folder / "ready"
    if not ready.exists():
        print(f"making an environment for CSRT in {folder}", flush=True)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", PACKAGE], check=True)
        ready.touch()
    return python


def _cache() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "drone-target-follower" / "csrt"


def _row(name: str, ours: Result, theirs: Result) -> str:
    cells = [
        f"{result.score.success:8.3f} {result.score.precision:6.3f} {result.score.auc:6.3f} "
        f"{result.milliseconds:6.2f} {result.processor_ms:6.2f}"
        for result in (ours, theirs)
    ]
    ratio = ours.milliseconds / theirs.milliseconds
    processor_ratio = ours.processor_ms / theirs.processor_ms
    return f"{name:22} {' |'.join(cells)} | {ratio:5.2f} {processor_ratio:5.2f}"


def _mean(results: list[Result]) -> Result:
    return Result(
        mean_score([result.score for result in results]),
        statistics.mean(result.milliseconds for result in results),
        statistics.mean(result.processor_ms for result in results),
    )


def compare(sequences: list[Sequence], python: Path, threads: int) -> None:
    """Run both trackers over all sequences and print a table."""
    print(f"{'':22} {'correlation':^36} |{'CSRT':^36} | ours / CSRT")
    titles = f"{'success':>8} {'prec.':>6} {'auc':>6} {'ms':>6} {'cpu ms':>6}"
    print(f"{'sequence':22} {titles} |{titles} | {'ms':>5} {'cpu':>5}", flush=True)
    ours, theirs = [], []
    with (
        Worker(Path(sys.executable), "correlation", threads) as correlation,
        Worker(python, "csrt", threads) as csrt,
    ):
        for sequence in sequences:
            ours.append(correlation.run(sequence))
            theirs.append(csrt.run(sequence))
            print(_row(sequence.name, ours[-1], theirs[-1]), flush=True)
    print(_row("mean", _mean(ours), _mean(theirs)))


def main() -> None:
    """Read the command line and compare."""
    parser = command_line.parser(__doc__)
    parser.add_argument("sequences", type=Path)
    parser.add_argument("--environment", type=Path, default=_cache())
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[], help="names of sequences")
    arguments = parser.parse_args()
    folders = sorted(path.parent for path in arguments.sequences.glob("*/groundtruth.txt"))
    if arguments.only:
        folders = [folder for folder in folders if folder.name in arguments.only]
    if not folders:
        parser.error(f"no sequence in {arguments.sequences}")
    sequences = [one for folder in folders for one in load_dataset(folder)[0]]
    compare(sequences, csrt_python(arguments.environment), arguments.threads)


if __name__ == "__main__":
    command_line.run(main)
