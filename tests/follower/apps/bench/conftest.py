"""Figures made by hand: a bench of a board that never was."""

from collections.abc import Callable
from typing import Any

import pytest

from follower.apps.bench.result import BenchResult, BenchRow

MakeRow = Callable[..., BenchRow]
MakeResult = Callable[..., BenchResult]


def row_of(tracker: str, detector: str | None, width: int, rate_hz: float, **more: Any) -> BenchRow:
    figures: dict[str, Any] = {
        "height": width * 9 // 16,
        "frames": 60,
        "step_ms": 1e3 / rate_hz,
        "on_target": 1.0,
        "late_ms": 0.1,
        "late_p99_ms": 0.5,
        "late_max_ms": 2.0,
        "period_off_p99_ms": 0.6,
        "control_ms": 0.3,
        "delay_ms": 40.0,
        "sent": 1.0,
        "cores": 1.5,
    }
    named = {"tracker": tracker, "detector": detector, "width": width, "rate_hz": rate_hz}
    return BenchRow(**{**figures, **named, **more})


def result_of(*rows: BenchRow, name: str = "board", **more: Any) -> BenchResult:
    computer = {"processor": "a processor", "cores": 4, "memory_mb": 8000, "used_mb": 400}
    return BenchResult(**{**computer, "name": name, "rows": rows, **more})


@pytest.fixture
def row() -> MakeRow:
    """Return what makes a row: tracker, detector, width, rate, and any other figure by name."""
    return row_of


@pytest.fixture
def result() -> MakeResult:
    """Return what makes a result of rows."""
    return result_of
