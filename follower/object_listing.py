"""`follower track --select list`: what a detector sees, to choose from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from follower.candidates import Candidate, numbered, write_candidates
from follower.print_line import print_line
from follower_vision.detection import Detector
from follower_vision.detection.scan import scan
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource, SourceError


def list_objects(
    source: FrameSource, detector: Detector, folder: Callable[[], Path], console: Console
) -> int:
    """Print and draw what is seen in the first frame in which anything is; return the exit code.

    Args:
        source: at its beginning.
        detector: any.
        folder: makes the folder for the picture.
        console: where to.

    Raises:
        SourceError: nothing is seen in any frame.
        OSError: the picture cannot be written.
    """
    frame, candidates = _first_seen(source, detector)
    picture = write_candidates(folder() / "candidates.png", frame.image, candidates)
    print_line(console, f"frame {frame.sequence}, {frame.width}x{frame.height} pixels")
    console.print(_table(candidates))
    first = candidates[0]
    lines = (
        f"follow one by --select {first.name} or --select {first.number}, "
        "or by --target with its box",
        f"  {picture}",
    )
    for line in lines:
        print_line(console, line)
    return 0


def _first_seen(source: FrameSource, detector: Detector) -> tuple[Frame, list[Candidate]]:
    count = 0
    while (frame := source.read()) is not None:
        candidates = numbered(scan(detector, frame.image), frame)
        if candidates:
            return frame, candidates
        count += 1
    reason = source.problem or "try another detector, or give --target x,y,w,h"
    raise SourceError(f"the detector sees nothing that it knows in {count} frames; {reason}")


def _table(candidates: Sequence[Candidate]) -> Table:
    table = Table(show_edge=False, pad_edge=False, header_style="dim")
    table.add_column("number", justify="right")
    table.add_column("name")
    table.add_column("score", justify="right")
    table.add_column("x,y,w,h")
    for one in candidates:
        box = ",".join(f"{value:.0f}" for value in one.box.xywh)
        table.add_row(str(one.number), one.name, f"{one.score:.2f}", box)
    return table
