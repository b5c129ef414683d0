"""Ctrl-C while files are written: they are whole all the same."""

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import follower.simulation.report
import follower.simulation.run
from follower.apps.main import INTERRUPTED
from follower.recording.run_folder import write_boxes
from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate
from follower.ui.terminal.interrupt import StopOnInterrupt, stop_signals

SCENARIO = """
name: short
title: A car stands on a field.
duration_s: 2
ground: {kind: meadow}
targets:
  - {kind: car, colour: "#e0401c", path: {points: [[0, 0], [5, 0]]}}
camera: {width: 160, height: 120}
start: {at: [-20, 0]}
select: {colour: "#e0401c"}
"""


def pressing(work: Callable[..., Any]) -> Callable[..., Any]:
    """Do the work after Ctrl-C."""

    def pressed(*given: Any, **named: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return work(*given, **named)

    return pressed


def fly(folder: Path) -> int:
    path = folder / "short.yaml"
    path.write_text(SCENARIO, "utf-8")
    return simulate(SimulationOptions(str(path), lockstep=True, out=folder / "runs")).exit_code


@pytest.mark.slow
def test_ctrl_c_while_the_report_is_written_does_not_stop_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(follower.simulation.report, "write_boxes", pressing(write_boxes))
    assert fly(tmp_path) != INTERRUPTED
    folder = tmp_path / "runs" / "short"
    assert "</html>" in (folder / "report.html").read_text("utf-8")
    assert "passed" in json.loads((folder / "score.json").read_text("utf-8"))


@pytest.mark.slow
def test_ctrl_c_before_the_flight_is_no_flight_but_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = follower.simulation.run.SimulatedFlight
    monkeypatch.setattr(follower.simulation.run, "SimulatedFlight", pressing(make))
    assert fly(tmp_path) == INTERRUPTED
    report = (tmp_path / "runs" / "short" / "report.html").read_text("utf-8")
    assert "The user ended this flight." in report


def test_without_anything_to_stop_the_first_lets_pass_and_the_second_interrupts() -> None:
    with StopOnInterrupt() as interrupt:
        signal.raise_signal(signal.SIGINT)
        assert interrupt.interrupted
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


@contextmanager
def handled(number: signal.Signals, handler: Any) -> Iterator[None]:
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_whatever_would_kill_a_flight_ends_it_in_order(number: signal.Signals) -> None:
    """SIGHUP comes when a terminal is closed or its connection is lost."""
    stops: list[None] = []
    with handled(number, signal.default_int_handler):  # under nohup SIGHUP is ignored
        with StopOnInterrupt(lambda: stops.append(None)) as interrupt:
            signal.raise_signal(number)
            assert interrupt.interrupted
        assert len(stops) == 1
        with stop_signals(), pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)


def test_a_program_that_was_told_to_outlive_its_terminal_does() -> None:
    with handled(signal.SIGHUP, signal.SIG_IGN):
        with StopOnInterrupt() as interrupt, stop_signals():
            signal.raise_signal(signal.SIGHUP)
        assert not interrupt.interrupted
