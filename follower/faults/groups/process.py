"""Signals to the follower's process."""

from __future__ import annotations

import signal
from typing import Any

from follower.faults.fault import Action, Fault, Kind, Outcome


def _process(name: str, number: int, must: str, outcome: Outcome, **limits: Any) -> Fault:
    action = Action(Kind.PROCESS_SIGNALLED, float(number))
    return Fault(name, "process", must, outcome, (action,), lockstep=False, **limits)


PROCESS = (
    _process(
        "process-interrupted",
        signal.SIGINT,
        "Ctrl-C: hold on the wire within 0.3 s, at rest within 7 s, then the process ends.",
        Outcome.LETS_GO,
        hold_within_s=0.3,
        rest_within_s=7.0,
        excursion_m=13.0,
    ),
    _process(
        "process-terminated",
        signal.SIGTERM,
        "SIGTERM: hold on the wire within 0.3 s, at rest within 7 s, then the process ends.",
        Outcome.LETS_GO,
        hold_within_s=0.3,
        rest_within_s=7.0,
        excursion_m=13.0,
    ),
    _process(
        "process-killed",
        signal.SIGKILL,
        "SIGKILL: no set-point later than 0.1 s; the autopilot's own time-out acts: PX4 flies home "
        "1.3 s later, ArduCopter flies on for GUID_TIMEOUT (3 s) and stops: no motion after 9 s.",
        Outcome.PILOT_HAS_IT,
    ),
)
