"""The follower in a process of its own, which is signalled or killed while it flies."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from follower.faults.evidence import Evidence, Motion, WireSetpoint, WireTap
from follower.faults.fault import Fault
from follower.faults.scene import scene, write_scene
from follower.faults.verdict import Figures, Verdict
from follower.faults.wire_rules import envelope_failures, left_mode, pilot_failures
from follower.links.connection import open_connection
from follower.scenario_start import start_state
from follower.settings import load_settings
from follower_sim.autopilot import SimAutopilot
from follower_sim.vehicle import STEP_S
from follower_vision.clock import MonotonicClock

_PATIENCE_S = 60.0
_FAST_M_S, _STEADY_S = 2.0, 3.0
_AFTERWARDS_S = 12.0
_STANDING_M_S = 0.5
_SILENT_WITHIN_S = 0.1
_STANDS_WITHIN_S = 9.0
_START = "from follower.cli import main; main()"


@dataclass(slots=True)
class _Flight:
    """What was seen of one process."""

    evidence: Evidence
    from_s: float = math.inf
    code: int | None = None
    ended_s: float = math.inf
    said: str = ""
    notes: list[str] = field(default_factory=list)


def fly_process(fault: Fault, flavour: str, link: str, connection: str) -> Verdict:
    """Fly the scene with the follower in another process, signal it, and judge what comes of it.

    Args:
        fault: one with a signal.
        flavour: "px4" or "ardupilot".
        link: "pymavlink" or "mavsdk".
        connection: what the process opens; the simulated autopilot, in this one, calls it.
    """
    from follower.simulate import other_end

    with tempfile.TemporaryDirectory() as folder:
        command = _command(Path(folder), link, connection)
        with closing(open_connection(other_end(connection))) as theirs:
            clock = MonotonicClock()
            tap = WireTap(theirs, clock)
            autopilot = SimAutopilot(flavour, tap, start_state(scene()))
            flight = _Flight(Evidence(flavour))
            process = subprocess.Popen(  # noqa: S603  ourselves
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
            try:
                _watch(process, autopilot, clock, fault, flight)
            finally:
                process.kill()
                flight.said = process.communicate()[0]
            flight.evidence.read(tap.heard, tap.sent)
    return _judged(fault, flight)


def _command(folder: Path, link: str, connection: str) -> list[str]:
    where = ["--out", str(folder), "--connect", connection]
    how = ["--autopilot", "external", "--link", link, "--no-video", "--no-record"]
    return [sys.executable, "-c", _START, "sim", str(write_scene(folder)), *where, *how]


def _watch(
    process: subprocess.Popen[str],
    autopilot: SimAutopilot,
    clock: MonotonicClock,
    fault: Fault,
    flight: _Flight,
) -> None:
    """Be the autopilot until some time after the signal."""
    fast_since_s = math.inf
    while not _is_over(flight, clock.now()):
        now_s = clock.now()
        autopilot.step(now_s)
        flight.evidence.watch(autopilot, now_s)
        moves = flight.evidence.motion[-1].speed_m_s > _FAST_M_S and autopilot.mode in _OURS
        fast_since_s = min(fast_since_s, now_s) if moves else math.inf
        if flight.from_s == math.inf and now_s - fast_since_s > _STEADY_S:
            flight.from_s = now_s
            os.kill(process.pid, fault.signal or signal.SIGKILL)
        if flight.code is None:
            flight.code = process.poll()
            flight.ended_s = now_s if flight.code is not None else math.inf
        clock.sleep_until(now_s + STEP_S)


_OURS = ("OFFBOARD", "GUIDED")


def _is_over(flight: _Flight, now_s: float) -> bool:
    """Whether there is nothing more to see: the report at the process's end takes its time."""
    if flight.from_s == math.inf:
        return now_s > _PATIENCE_S
    since_s = now_s - flight.from_s
    return since_s > (_PATIENCE_S if flight.code is None else _AFTERWARDS_S)


def _judged(fault: Fault, flight: _Flight) -> Verdict:
    after = [m for m in flight.evidence.motion if m.time_s >= flight.from_s]
    figures = Figures(setpoints=len(flight.evidence.setpoints))
    if after:
        rest_s = _rest_s(after)
        hold_s = _hold_s(flight.evidence.setpoints, flight.from_s)
        figures = Figures(
            hold_s=hold_s if fault.hold_within_s is not None else None,
            rest_s=rest_s,
            excursion_m=_excursion_m(after, rest_s),
            setpoints=len(flight.evidence.setpoints),
        )
    failures = tuple(_failures(fault, flight, figures))
    ended = f"ended with {flight.code} after {flight.ended_s - flight.from_s:.1f} s"
    return Verdict(fault.name, fault.must, failures, figures, ended)


def _failures(fault: Fault, flight: _Flight, figures: Figures) -> Iterator[str]:
    if flight.from_s == math.inf:
        yield f"it never flew fast enough to be signalled; it said: {flight.said[-300:]}"
        return
    limits = load_settings().envelope
    yield from envelope_failures(flight.evidence.setpoints, limits, limits.max_interval_s)
    yield from pilot_failures(flight.evidence, ())
    if flight.code is None:
        yield "the process did not end"
    if "Traceback" in flight.said:
        yield f"an error that nobody caught: {flight.said[-300:]}"
    if fault.signal == signal.SIGKILL:
        yield from _killed(flight, figures)
        return
    promised = (
        ("hold on the wire", figures.hold_s, fault.hold_within_s),
        ("at rest", figures.rest_s, fault.rest_within_s),
        ("excursion", figures.excursion_m, fault.excursion_m),
    )
    for what, value, most in promised:
        if most is not None and (value is None or value > most):
            yield f"{what}: {value}, not within {most}"


def _killed(flight: _Flight, figures: Figures) -> Iterator[str]:
    late = [s.time_s - flight.from_s for s in flight.evidence.setpoints]
    if max(late) > _SILENT_WITHIN_S:
        yield f"a set-point came {max(late):.2f} s after the process was killed"
    gone_home = any(left_s > flight.from_s for left_s in left_mode(flight.evidence.motion))
    stands = figures.rest_s is not None and figures.rest_s < _STANDS_WITHIN_S
    if not gone_home and not stands:
        yield "the vehicle flies on"


def _hold_s(setpoints: Sequence[WireSetpoint], from_s: float) -> float | None:
    """Return from when on the speed sent only falls; nothing else is known out here."""
    after = [s for s in setpoints if s.time_s >= from_s]
    if not after:
        return None
    last = max(range(len(after)), key=lambda number: (after[number].speed_m_s, number))
    return after[last].time_s - from_s


def _rest_s(after: Sequence[Motion]) -> float | None:
    moving = [m.time_s for m in after if m.speed_m_s > _STANDING_M_S]
    if moving and moving[-1] >= after[-1].time_s - 0.5:
        return None
    return moving[-1] - after[0].time_s if moving else 0.0


def _excursion_m(after: Sequence[Motion], rest_s: float | None) -> float | None:
    if rest_s is None:
        return None
    start = after[0]
    places = [m.position_m for m in after if m.time_s <= start.time_s + rest_s]
    return max((math.dist(start.position_m, place) for place in places), default=0.0)
