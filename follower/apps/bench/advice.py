"""What a bench's figures mean for the settings. Pure functions of the figures."""

from dataclasses import dataclass
from typing import Any

import yaml

from follower.apps.bench.result import BenchResult, BenchRow
from follower_vision.models.table import MODELS, Purpose

MARGIN = 0.25
"""What the advised settings have to spare, for a warm board and a scene that costs more."""
_BEST_TRACKERS = (
    *("nanotrack-v3", "nanotrack-v2", "nano", "nanotrack-v1", "siamese-correlation"),
    *("correlation", "siamese", "re3", "csrt", "boosting", "medianflow", "tld", "mil"),
    *("kcf", "mosse"),
)
"""By their success with a detector, else alone: docs/reference/trackers.md."""
_DETECTORS = [model for model in MODELS if model.purpose is Purpose.DETECTOR]
_BEST_DETECTORS = [
    model.name for model in sorted(_DETECTORS, key=lambda one: (one.embedded, not one.usual))
]
"""The one that Fusion's model was fitted with first, our own, for generated scenes, last."""
_LATE_MS = 5.0
_TOO_LATE = f"More than {_LATE_MS:g} ms is much: what else runs?"
_BUSY = 0.3
_THROTTLED = 0xF


def tracker_rank(name: str) -> int:
    """Return a tracker's place by accuracy, 0 the best."""
    return _place(name, _BEST_TRACKERS)


def detector_rank(name: str | None) -> int:
    """Return a detector's place among those to take, 0 the first; without one the last."""
    return len(_BEST_DETECTORS) + 1 if name is None else _place(name, _BEST_DETECTORS)


def _place(name: str, names: tuple[str, ...] | list[str]) -> int:
    return names.index(name) if name in names else len(names)


@dataclass(frozen=True, slots=True)
class Advice:
    """What to fly with.

    Attributes:
        row: the set-up that is advised.
        camera_hz: frames a second that the camera is to give.
        lines: the same in plain words, and what else the figures say.
    """

    row: BenchRow
    camera_hz: float
    lines: tuple[str, ...]

    def to_yaml(self) -> str:
        """Return the settings to copy."""
        row = self.row
        settings: dict[str, Any] = {"tracker": row.tracker, "detector": row.detector}
        settings["vision"] = {"device": row.device}
        camera = f"# The camera: {row.size}, {self.camera_hz:g} frames/s.\n"
        return camera + yaml.safe_dump(settings, sort_keys=False)


def advise(result: BenchResult) -> Advice:
    """Choose among what was measured with the video recorded and frames that never run out.

    Of the set-ups that hold the camera's rate with a margin: Fusion before a tracker alone, then
    the better tracker, the better detector, the larger picture. If none does, the fastest, and a
    camera's rate that it holds. What lost the target is not advised, unless everything did.

    Args:
        result: the figures, and the camera's rate.
    """
    free = [row for row in result.rows if row.camera_hz is None]
    recorded = [row for row in free if row.video] or free or list(result.rows)
    rows = [row for row in recorded if not row.lost] or recorded
    wanted_hz = result.rate_hz * (1 + MARGIN)
    holding = [row for row in rows if row.rate_hz >= wanted_hz]
    best = max(holding or rows, key=_preference if holding else lambda row: row.rate_hz)
    camera_hz = result.rate_hz if holding else max(1.0, best.rate_hz / (1 + MARGIN) // 1)
    head = f"{_said(best, result.validate_every)} holds {best.rate_hz:.0f} frames/s here"
    if holding:
        first = (
            f"{head}: use it with a camera of {camera_hz:g} frames/s, which leaves "
            f"{best.rate_hz / camera_hz - 1:.0%} to spare."
        )
    else:
        first = (
            f"Nothing measured holds {result.rate_hz:g} frames/s with {MARGIN:.0%} to spare. "
            f"{head}, the most of all: set the camera to {camera_hz:g} frames/s."
        )
    return Advice(best, camera_hz, (first, *_remarks(result, best)))


def _preference(row: BenchRow) -> tuple[float, ...]:
    ranks = -tracker_rank(row.tracker), -detector_rank(row.detector)
    return row.detector is not None, *ranks, row.width * row.height, row.rate_hz


def _said(row: BenchRow, validate_every: int) -> str:
    """Return a set-up in words, e.g. "Fusion (re3 with yolox-nano every 4th frame) at 640x480"."""
    if row.detector is None:
        what = f"The tracker {row.tracker}, without a detector,"
    else:
        every = _nth(validate_every)
        what = f"Fusion ({row.tracker} with {row.detector} {every})"
    return f"{what} at {row.size} on {row.device}"


def _nth(number: int) -> str:
    ends = {1: "every frame", 2: "every 2nd frame", 3: "every 3rd frame"}
    return ends.get(number, f"every {number}th frame")


def _remarks(result: BenchResult, best: BenchRow) -> list[str]:
    """Return what else somebody who flies has to know."""
    lines = []
    same = [row for row in result.rows if (row.vision, row.size) == (best.vision, best.size)]
    for row in same:
        if not row.video and row.rate_hz > best.rate_hz:
            lines.append(
                "Without the video in the recording (recorder.video: none) it reaches "
                f"{row.rate_hz:.0f}."
            )
        if row.camera_hz is not None:
            lines.append(_flown(row))
            lines += [_TOO_LATE] if row.late_p99_ms > _LATE_MS else []
    if result.load is not None and result.load > _BUSY:
        lines.append(
            f"Other programs ran (load {result.load:.1f} a core before it began): these are not "
            "the board's own figures."
        )
    if best.lost:
        lines.append("It lost the target: the figures are not those of following.")
    if any((row.throttled or 0) & _THROTTLED for row in result.rows):
        lines.append("The board was slowed down meanwhile, by heat or a weak supply: see to it.")
    return lines


def _flown(row: BenchRow) -> str:
    """Return in words what came of a camera with a rate."""
    return (
        f"With a camera of {row.camera_hz:g} frames/s: {row.rate_hz:.0f} tracked a second, "
        f"{row.delay_ms:.0f} ms from capture to setpoint, {row.cores:.1f} cores busy; 99 of 100 "
        f"control steps began at most {row.late_p99_ms:.1f} ms late."
    )
