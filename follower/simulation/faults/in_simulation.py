"""Faults in `follower sim`: what is set up before the flight, and said after it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from follower.faults.injector import FaultInjector
from follower.faults.judge import Case, judge
from follower.faults.planned import PlannedFault
from follower.faults.signing_peer import SigningPeer, write_key
from follower.faults.verdict import Figures, Verdict
from follower.recorder import LOCKSTEP_EPOCH_NS, epoch_now_ns
from follower.settings import Settings, load_settings
from follower.simulated_flight import SimulatedFlight
from follower_control.transport import Transport
from follower_vision.clock import Clock, SimulatedClock

Ends = tuple[Transport, Transport]

_NOT_JUDGED = "(Its own sentence is judged only where it comes alone and as long as listed.)"


@contextmanager
def as_faults_want(
    planned: Sequence[PlannedFault], settings: Settings, ends: Ends, clock: Clock
) -> Iterator[tuple[Settings, Ends]]:
    """Give settings and transports as the faults want them: theirs, and a signed link's."""
    overrides = [override for one in planned for override in one.fault.settings]
    if overrides:
        settings = load_settings(base=settings.model_dump(), overrides=overrides)
    if not any(one.fault.signed for one in planned):
        yield settings, ends
        return
    simulated = isinstance(clock, SimulatedClock)
    epoch_ns = LOCKSTEP_EPOCH_NS if simulated else epoch_now_ns(clock)
    with tempfile.TemporaryDirectory() as folder:
        link = settings.model_dump()["link"] | {"signing_key_file": str(write_key(Path(folder)))}
        signed = Settings.model_validate(settings.model_dump() | {"link": link})
        yield signed, (ends[0], SigningPeer(ends[1], clock, epoch_ns))


def verdicts(
    planned: Sequence[PlannedFault],
    flight: SimulatedFlight,
    injector: FaultInjector,
    error: str = "",
) -> list[Verdict]:
    """Judge a flight that is over, fault by fault.

    Where there are several, or one lasts as long as somebody chose, each is held against what
    always holds alone: its own sentence is about itself as it stands in the catalogue.
    """
    begun = {one: from_s for one, from_s, _ in injector.schedule.spans}
    cases = (
        Case(
            one,
            begun.get(one),
            begun.get(one, 0.0) + one.for_s,
            injector.evidence,
            flight.log.controls,
            flight.truth,
            flight.settings.envelope,
            len(planned) == 1 and one.for_s == one.fault.for_s,
            error,
            injector.realtime,
        )
        for one in planned
    )
    return [judge(case) for case in cases]


def said_of(verdict: Verdict) -> str:
    """Return a verdict in a line."""
    passed = "as it must be" if verdict.must else "what always holds was kept"
    came = passed if verdict.passed else "; ".join(verdict.failures)
    must = f"({verdict.must})" if verdict.must else _NOT_JUDGED
    return f"Fault {verdict.fault}: {came}. {must} {_measured(verdict.figures)}".rstrip()


def _measured(figures: Figures) -> str:
    named = (
        ("hold on the wire", figures.hold_s, "s"),
        ("at rest", figures.rest_s, "s"),
        ("excursion", figures.excursion_m, "m"),
        ("follows again", figures.back_s, "s"),
    )
    parts = [f"{name} {value:.2f} {unit}" for name, value, unit in named if value is not None]
    return f"Measured: {', '.join(parts)}." if parts else ""
