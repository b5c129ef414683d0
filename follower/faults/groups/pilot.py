"""What the pilot and the operator can do."""

from __future__ import annotations

from follower.faults.fault import Action, Fault, Kind, Outcome
from follower.faults.groups.promise import lets_go, pilot_has_it
from follower.supervisor import State

_BLACK = Action(Kind.FRAMES_BLACK)


def _switch(state: State, after_s: float = 0.1) -> Action:
    return Action(Kind.PILOT_SWITCHES, after_s=after_s, state=state)


_TAKES_OVER = "No setpoint later than 0.1 s after the heartbeat that says so"
PILOT = (
    pilot_has_it(
        "pilot-while-following",
        f"{_TAKES_OVER}; never follows by itself.",
        _switch(State.FOLLOWING),
    ),
    pilot_has_it("pilot-while-coasting", f"{_TAKES_OVER}.", _BLACK, _switch(State.COASTING)),
    pilot_has_it("pilot-while-searching", f"{_TAKES_OVER}.", _BLACK, _switch(State.SEARCHING)),
    pilot_has_it(
        "pilot-while-holding",
        f"{_TAKES_OVER}.",
        Action(Kind.FRAMES_SILENT),
        _switch(State.HOLDING),
    ),
    pilot_has_it(
        "pilot-while-released",
        f"{_TAKES_OVER}; it stays let go.",
        Action(Kind.STOP_REQUESTED),
        _switch(State.RELEASED),
    ),
    pilot_has_it(
        "pilot-returns",
        "The pilot leaves the mode and comes back 3 s later: it does not follow by itself.",
        _switch(State.FOLLOWING),
        Action(Kind.PILOT_RETURNS, after_s=3.0),
        for_s=8.0,
    ),
    Fault(
        "pilot-while-ready",
        "pilot",
        "While it waits for its mode the pilot flies in another one: nothing but zero is sent.",
        Outcome.NEVER_FOLLOWS,
        (Action(Kind.MODE_REFUSED), _switch(State.READY, after_s=2.0)),
        state=State.IDLE,
        in_state_s=0.0,
        flavours=("px4",),  # ArduCopter takes off in GUIDED and so is never kept waiting for it
    ),
    lets_go(
        "sticks-moved",
        "pilot",
        "The pilot moves a stick far: hold within 0.5 s, at rest within 7 s, let go.",
        Action(Kind.STICK_MOVED, 1900.0),
        hold_within_s=0.5,
    ),
    lets_go(
        "consent-withdrawn",
        "pilot",
        "The operator withdraws consent: hold at once, at rest within 7 s, let go.",
        Action(Kind.CONSENT_WITHDRAWN),
        hold_within_s=0.1,
    ),
    lets_go(
        "stop-requested",
        "pilot",
        "The operator says stop: hold at once, at rest within 7 s, let go.",
        Action(Kind.STOP_REQUESTED),
        hold_within_s=0.1,
    ),
)
