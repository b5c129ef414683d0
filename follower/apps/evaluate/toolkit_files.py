"""Writes boxes as got10k-toolkit and vot-toolkit read them."""

import re
from collections.abc import Iterable
from pathlib import Path

from follower.apps.evaluate.scores import ScoredRun
from follower_vision.disk import write_whole

_INITIALISATION = "1"
"""VOT's code for the frame in which the tracker was started."""


def toolkit_name(tracker: str) -> str:
    """Return a tracker's name with nothing but what vot-toolkit allows in one."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", tracker)


def write_toolkit_files(folder: Path, runs: Iterable[ScoredRun]) -> None:
    """Write the one-pass runs of our own trackers, in full precision.

    `got10k/TRACKER` has SEQUENCE.txt and SEQUENCE/SEQUENCE_001.txt, x, y, w, h in pixels a line,
    with their times; `vot/TRACKER/unsupervised` is what vot-toolkit keeps below `results`.

    Raises:
        OSError: a file cannot be written.
    """
    for one in runs:
        if one.kind != "ope" or not one.result.frame_s:
            continue
        name, sequence = toolkit_name(one.tracker), one.sequence
        boxes = [
            ",".join(repr(float(value)) for value in box.xywh) if box else "nan,nan,nan,nan"
            for box in one.result.boxes
        ]
        times = [f"{time_s:.8f}" for time_s in one.result.frame_s]
        got10k, vot = folder / "got10k" / name, folder / "vot" / name / "unsupervised" / sequence
        _write(got10k / f"{sequence}.txt", boxes)
        _write(got10k / "times" / f"{sequence}_time.txt", times)
        _write(got10k / sequence / f"{sequence}_001.txt", boxes)
        _write(got10k / sequence / f"{sequence}_time.txt", times)
        _write(vot / f"{sequence}_001.txt", [_INITIALISATION, *boxes[1:]])
        _write(vot / f"{sequence}_001_time.value", times)


def _write(path: Path, lines: list[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, "\n".join(lines) + "\n")
