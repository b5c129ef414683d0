"""Writes results.csv, results.json, toolkits' files and the tables in the terminal."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import JustifyMethod
from rich.markup import escape
from rich.table import Table

from follower.apps.evaluate.scores import (
    COMPARED,
    AttributeRow,
    Difference,
    Evaluation,
    MeanRow,
    ResultRow,
    ScoredRun,
    ToolkitRow,
)
from follower_vision.disk import write_whole
from follower_vision.evaluation.metrics import StateAccuracy, median_s, share_soon

HEAD = ("tracker", "start", "auc", "success@0.5", "precision@20", "norm. prec.", "fps", "cpu ms")
STATES_HEAD = (
    "tracking at iou 0", "tracking while absent", "right but doubted",
    "returns", "return median s", "return under 0.5 s",
    "losses", "loss median s", "loss under 0.5 s",
)  # fmt: skip
_NAMES = dict(zip(COMPARED, HEAD[2:5], strict=True))
DIFFERENCES_HEAD = ("tracker", "against", "start", "figure", "difference", "95 % interval", "p")
TOOLKITS_HEAD = (
    "tracker", "OTB success", "OTB precision", "OTB success rate",
    "GOT-10k AO", "GOT-10k SR 0.5", "VOT accuracy",
)  # fmt: skip
NEVER = "never"
_LEAST_P = 0.001
"""A smaller p is shown as below this."""
_SHORT = ("AUC", "S@0.5", "P@20", "NP", "fps", "CPU ms")
"""The rest of HEAD, as the terminal shows it."""
_SHORT_STATES = {
    "TRACKING\nat IoU 0": 0, "while\nabsent": 1, "right but\ndoubted": 2,
    "return\nmedian s": 4, "loss\nmedian s": 7,
}  # fmt: skip
"""Which of STATES_HEAD the terminal shows, under another name."""

Figure = float | int | str | None


def figures(one: ResultRow | ScoredRun) -> list[float | None]:
    """Return AUC, success, precision, normalised precision, frames a second, processor ms."""
    score, normalised = one.score, one.curves.normalised_precision
    shares = (score.auc, score.success, score.precision, normalised)
    return [*shares, one.frames_s, one.processor_ms]


def texts(one: ResultRow | ScoredRun) -> list[str]:
    """Return the figures as shown."""
    *shares, rate, milliseconds = figures(one)
    shown = [f"{share:.3f}" for share in shares]
    return [
        *shown,
        "" if rate is None else f"{rate:.0f}",
        "" if milliseconds is None else f"{milliseconds:.1f}",
    ]


def interval_text(low: float, high: float, sign: str = "") -> str:
    """Return an interval as shown, without signs or, with "+", with them."""
    return f"[{low:{sign}.3f}, {high:{sign}.3f}]"


def difference_texts(one: Difference) -> list[str]:
    """Return a difference as shown, in the columns of DIFFERENCES_HEAD."""
    paired = one.paired
    return [
        *(one.tracker, one.reference, one.kind, _NAMES[one.figure]),
        *(f"{paired.mean:+.3f}", interval_text(paired.low, paired.high, "+"), _p_text(paired.p)),
    ]


def _p_text(p: float) -> str:
    return f"{p:.3f}" if p >= _LEAST_P else f"< {_LEAST_P}"


def toolkit_texts(row: ToolkitRow) -> list[str]:
    """Return a tracker's figures as shown, in the columns of TOOLKITS_HEAD."""
    one = row.score
    values = (one.otb_success, one.otb_precision, one.otb_rate, one.got10k_ao, one.got10k_sr)
    accuracy = "–" if one.vot_accuracy is None else f"{one.vot_accuracy:.3f}"
    return [row.tracker, *(f"{value:.3f}" for value in values), accuracy]


def states_figures(states: StateAccuracy | None) -> list[Figure]:
    """Return the figures of STATES_HEAD; None where nothing is known, "never" for ever."""
    if states is None:
        return [None] * len(STATES_HEAD)
    shares = states.false_tracking, states.absent_tracking, states.doubted
    return [*shares, *_delays(states.returns_s), *_delays(states.losses_s)]


def _delays(times_s: Sequence[float]) -> list[Figure]:
    median = median_s(times_s)
    shown = NEVER if median is not None and math.isinf(median) else median
    return [len(times_s), shown, share_soon(times_s)]


def states_texts(states: StateAccuracy | None) -> list[str]:
    """Return the figures as shown."""
    values = states_figures(states)
    shares = (0, 1, 2, 5, 8)
    return [_text(value, index in shares) for index, value in enumerate(values)]


def _text(value: Figure, share: bool) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{100 * value:.1f} %" if share else f"{value:.2f}"
    return str(value)


def stateless(rows: Sequence[ResultRow]) -> list[str]:
    """Return the names of the trackers that know no states."""
    return list(dict.fromkeys(row.tracker for row in rows if row.states is None))


def terminal_tables(rows: Sequence[MeanRow], differences: Sequence[Difference]) -> Iterable[Table]:
    """Yield the means, differences, and what the states are worth where a tracker has some."""
    yield _table((*HEAD[:2], *_SHORT), [(row.tracker, row.kind, *texts(row)) for row in rows])
    if differences:
        head = (f"against {differences[0].reference}", *DIFFERENCES_HEAD[2:])
        lines = [(one[0], *one[2:]) for one in map(difference_texts, differences)]
        yield _table(head, lines, names=3)
    said = [(row, states_texts(row.states)) for row in rows if row.states]
    if said:
        lines = [
            (row.tracker, row.kind, *(cells[place] for place in _SHORT_STATES.values()))
            for row, cells in said
        ]
        yield _table((*HEAD[:2], *_SHORT_STATES), lines)


def _table(head: Sequence[str], lines: Iterable[Sequence[str]], names: int = 2) -> Table:
    """Return a table whose figures are whole on any terminal; the names before them are folded."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for number, name in enumerate(head):
        is_name = number < names
        justify: JustifyMethod = "left" if is_name else "right"
        table.add_column(escape(name), justify=justify, overflow="fold", no_wrap=not is_name)
    for cells in lines:
        table.add_row(*map(escape, cells))
    return table


def write_csv(path: Path, runs: Sequence[ScoredRun]) -> Path:
    """Write a line a run.

    Raises:
        OSError: it cannot be written.
    """
    head = (HEAD[0], "sequence", *HEAD[1:], "frames", *STATES_HEAD)
    lines = [
        (one.tracker, one.sequence, one.kind, *figures(one), one.score.frames,
         *states_figures(one.states))
        for one in runs
    ]  # fmt: skip
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(lines)
    return write_whole(path, text.getvalue())


def write_json(path: Path, found: Evaluation) -> Path:
    """Write the means with curves and intervals, differences, and each run's figures.

    Raises:
        OSError: it cannot be written.
    """
    stored = {
        "means": [
            {**_entry(row), "intervals": _intervals(row), "curves": asdict(row.curves)}
            for row in found.means
        ],
        "differences": [_difference_entry(one) for one in found.differences],
        "toolkits": [{"tracker": row.tracker, **asdict(row.score)} for row in found.toolkits],
        "attributes": [_attribute_entry(row) for row in found.attributes],
        "runs": [{"sequence": one.sequence, **_entry(one)} for one in found.runs],
        "remarks": found.remarks,
    }
    return write_whole(path, json.dumps(stored, indent=1, allow_nan=False))


def _intervals(row: MeanRow) -> dict[str, tuple[float, float]]:
    return {_NAMES[figure]: bounds for figure, bounds in row.intervals.items()}


def _difference_entry(one: Difference) -> dict[str, object]:
    entry = {**asdict(one), **asdict(one.paired), "figure": _NAMES[one.figure]}
    del entry["paired"]
    return entry


def _attribute_entry(row: AttributeRow) -> dict[str, object]:
    score = row.score
    shares = zip(HEAD[2:5], (score.auc, score.success, score.precision), strict=True)
    names = {"attribute": row.attribute, "tracker": row.tracker, "sequences": row.sequences}
    return {**names, **dict(shares), "frames": score.frames}


def _entry(one: ResultRow | ScoredRun) -> dict[str, object]:
    entry = dict(zip(HEAD, (one.tracker, one.kind, *figures(one)), strict=True))
    said = dict(zip(STATES_HEAD, states_figures(one.states), strict=True))
    return {**entry, "states": None if one.states is None else said}


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
