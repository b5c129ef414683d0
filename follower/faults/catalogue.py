"""All faults by name. Times are in seconds, lengths in metres.

The limits hold for the flight of `follower faults`: a car at 3.5 m/s, followed at 14 m with the
supervisor's time-outs as they are set by default, but a search of 2 s.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Iterable
from typing import Any

from follower.faults.fault import Action, Fault, Kind, Outcome
from follower.supervisor import State

_HOLD_SOON: dict[str, Any] = {
    "hold_within_s": 0.7,
    "rest_within_s": 7.0,
    "excursion_m": 13.0,
}
"""What is noticed by a time-out of half a second. PX4 takes its time with the last half metre a
second, also in its own Hold."""


def _lets_go(name: str, group: str, must: str, *actions: Action, **more: Any) -> Fault:
    return Fault(name, group, must, Outcome.LETS_GO, actions, **{**_HOLD_SOON, **more})


def _carries_on(name: str, group: str, must: str, *actions: Action, **more: Any) -> Fault:
    return Fault(name, group, must, Outcome.CARRIES_ON, actions, **{"for_s": 4.0, **more})


def _comes_back(name: str, group: str, must: str, *actions: Action, **more: Any) -> Fault:
    limits = {"hold_within_s": 0.7, "back_within_s": 3.0, **more}
    return Fault(name, group, must, Outcome.COMES_BACK, actions, **limits)


def _pilot(name: str, must: str, *actions: Action, **more: Any) -> Fault:
    return Fault(name, "pilot", must, Outcome.PILOT_HAS_IT, actions, **more)


_VISION = (
    _lets_go(
        "vision-dies",
        "vision",
        "Hold on the wire within 0.7 s, at rest within 7 s, let go 3 s later.",
        Action(Kind.VISION_DIES),
    ),
    _lets_go(
        "vision-hangs",
        "vision",
        "Hold on the wire within 0.7 s, at rest within 7 s, let go 3 s later.",
        Action(Kind.VISION_HANGS),
    ),
    _comes_back(
        "vision-hangs-1s",
        "vision",
        "Hold on the wire within 0.7 s; follows again within 3 s of the first new answer.",
        Action(Kind.VISION_HANGS),
        for_s=1.0,
    ),
    _lets_go(
        "vision-2hz",
        "vision",
        "Answers of 0.5 s and more are too old: hold on the wire within 1.2 s, at rest within 7 s.",
        Action(Kind.VISION_SLOW, 0.5),
        hold_within_s=1.2,
    ),
)

_FRAMES = (
    _lets_go(
        "frames-frozen",
        "frames",
        "The same picture with new times counts as unseen: at rest within 7 s, let go.",
        Action(Kind.FRAMES_FROZEN),
        hold_within_s=1.6,
    ),
    _lets_go(
        "frames-black",
        "frames",
        "Coasts for 0.8 s at most, then holds: at rest within 7 s, let go after the search.",
        Action(Kind.FRAMES_BLACK),
        hold_within_s=1.6,
    ),
    _comes_back(
        "frames-black-1s",
        "frames",
        "Coasts, holds, and follows again within 3 s of the first picture.",
        Action(Kind.FRAMES_BLACK),
        for_s=1.0,
        hold_within_s=None,
    ),
    _lets_go(
        "frames-stop",
        "frames",
        "No frame for 0.5 s: hold on the wire within 0.7 s, at rest within 7 s.",
        Action(Kind.FRAMES_SILENT),
    ),
    _carries_on(
        "frames-late-0.2s",
        "frames",
        "0.2 s later than usual is predicted over: follows on.",
        Action(Kind.FRAMES_LATE, 0.2),
    ),
    _lets_go(
        "frames-late-1s",
        "frames",
        "Too old to steer by: hold on the wire within 0.7 s, at rest within 7 s.",
        Action(Kind.FRAMES_LATE, 1.0),
    ),
    _carries_on(
        "frames-reordered",
        "frames",
        "Frames from the past are passed over: follows on.",
        Action(Kind.FRAMES_REORDERED),
    ),
)

_TELEMETRY = (
    _lets_go(
        "attitude-frozen",
        "telemetry",
        "The same numbers with new times are stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.ATTITUDE_FROZEN),
    ),
    _lets_go(
        "position-frozen",
        "telemetry",
        "The same numbers with new times are stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.POSITION_FROZEN),
    ),
    _lets_go(
        "telemetry-stops",
        "telemetry",
        "Nothing but heartbeats: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.TELEMETRY_STOPPED),
    ),
    _lets_go(
        "telemetry-late-1s",
        "telemetry",
        "Attitudes of a second ago are stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.TELEMETRY_LATE, 1.0),
    ),
    _carries_on(
        "telemetry-late-0.1s",
        "telemetry",
        "0.1 s late: follows on.",
        Action(Kind.TELEMETRY_LATE, 0.1),
    ),
    _comes_back(
        "telemetry-late-0.3s",
        "telemetry",
        "Attitudes come later than the pictures that need them: holds within 1 s, follows again "
        "within 3 s of its end.",
        Action(Kind.TELEMETRY_LATE, 0.3),
        for_s=3.0,
        hold_within_s=1.0,
    ),
    _lets_go(
        "attitude-nan",
        "telemetry",
        "NaN is dropped and what was known grows stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.ATTITUDE_NAN),
    ),
    _lets_go(
        "position-nan",
        "telemetry",
        "NaN is dropped and what was known grows stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.POSITION_NAN),
    ),
    _carries_on(
        "position-jumps",
        "telemetry",
        "A position 30 m off for 2 s, inside the fence: follows on.",
        Action(Kind.POSITION_JUMPS, 30.0),
        for_s=2.0,
    ),
    _comes_back(
        "heading-jumps",
        "telemetry",
        "A heading 30 degrees off for 1 s: keeps its distance, follows again within 5 s.",
        Action(Kind.YAW_JUMPS, math.radians(30.0)),
        for_s=1.0,
        hold_within_s=None,
        back_within_s=5.0,
    ),
)

_LINK = (
    _carries_on(
        "link-down-0.2s",
        "link",
        "Shorter than any time-out: follows on.",
        Action(Kind.LINK_DOWN),
        for_s=0.2,
    ),
    _comes_back(
        "link-down-0.7s",
        "link",
        "Hold on the wire within 0.7 s; follows again within 3 s of its return.",
        Action(Kind.LINK_DOWN),
        for_s=0.7,
    ),
    _lets_go(
        "link-down-1s",
        "link",
        "Hold on the wire within 0.7 s; after a second alone the autopilot may have gone its own "
        "way, so it lets go.",
        Action(Kind.LINK_DOWN),
        for_s=1.2,
        rest_within_s=None,
        excursion_m=None,
    ),
    _lets_go(
        "link-down-5s",
        "link",
        "Hold on the wire within 0.7 s, let go; does not follow again when the link is back.",
        Action(Kind.LINK_DOWN),
        for_s=5.0,
        rest_within_s=None,
        excursion_m=None,
    ),
    _carries_on(
        "loss-5%", "link", "5 % of the packets lost: follows on.", Action(Kind.PACKETS_LOST, 0.05)
    ),
    _carries_on(
        "loss-30%",
        "link",
        "30 % of the packets lost: follows on.",
        Action(Kind.PACKETS_LOST, 0.3),
    ),
    _carries_on(
        "doubled",
        "link",
        "Every other packet twice: follows on.",
        Action(Kind.PACKETS_DOUBLED, 0.5),
    ),
    _carries_on(
        "reordered",
        "link",
        "Every fifth packet behind five others: follows on.",
        Action(Kind.PACKETS_REORDERED, 0.2),
    ),
    _carries_on(
        "garbage", "link", "Random bytes between the packets: follows on.", Action(Kind.GARBAGE)
    ),
    _carries_on(
        "strangers",
        "link",
        "Other systems' heartbeats, attitudes and positions change nothing.",
        Action(Kind.STRANGERS),
    ),
    _carries_on(
        "fuzzed",
        "link",
        "Packets with changed bytes fail their checksum: follows on.",
        Action(Kind.FUZZED),
    ),
    _carries_on(
        "unsigned",
        "link",
        "On a signed link, forged packets without a signature change nothing.",
        Action(Kind.FORGED_UNSIGNED),
        signed=True,
    ),
    _carries_on(
        "wrong-signature",
        "link",
        "On a signed link, forged packets with a wrong signature change nothing.",
        Action(Kind.FORGED_WRONG),
        signed=True,
    ),
    _carries_on(
        "replayed",
        "link",
        "On a signed link, packets of the last seconds sent again change nothing.",
        Action(Kind.REPLAYED),
        signed=True,
    ),
)

_AUTOPILOT = (
    _lets_go(
        "autopilot-restarts",
        "autopilot",
        "Silent for 2 s, then back with a new clock and no rates: hold within 0.7 s, let go.",
        Action(Kind.LINK_DOWN, for_s=2.0),
        Action(Kind.AUTOPILOT_RESTARTS),
        for_s=4.0,
    ),
    Fault(
        "mode-refused",
        "autopilot",
        "The autopilot refuses OFFBOARD or GUIDED: nothing but zero is ever sent. (ArduCopter then "
        "does not even take off.)",
        Outcome.NEVER_FOLLOWS,
        (Action(Kind.MODE_REFUSED),),
        state=State.IDLE,
        in_state_s=0.0,
    ),
    _pilot(
        "estimator-lost",
        "No position any more, a second later the autopilot's own failsafe: hold within 0.7 s, "
        "nothing is sent after it.",
        Action(Kind.POSITION_STOPPED),
        Action(Kind.ESTIMATOR_FAILSAFE, after_s=1.0),
        hold_within_s=0.7,
    ),
    _lets_go(
        "estimator-unwell",
        "autopilot",
        "The estimator rejects its measurements: hold within 1.5 s (the autopilot tells of it once "
        "a second), at rest within 8 s, let go.",
        Action(Kind.ESTIMATOR_UNWELL, 3.0),
        hold_within_s=1.5,
        rest_within_s=8.0,
        excursion_m=17.0,
    ),
    _lets_go(
        "battery-low",
        "autopilot",
        "Less battery than is asked for: hold within 1.5 s (it tells of it once a second), at rest "
        "within 8 s, let go.",
        Action(Kind.BATTERY_LOW, 10.0),
        hold_within_s=1.5,
        rest_within_s=8.0,
        excursion_m=17.0,
    ),
    _carries_on(
        "autopilot-clock-forward",
        "autopilot",
        "The autopilot's clock jumps 10 s ahead: follows on, or holds for less than 2 s.",
        Action(Kind.CLOCK_JUMPS, 10.0),
        for_s=6.0,
        back_within_s=2.0,
    ),
    _carries_on(
        "autopilot-clock-back",
        "autopilot",
        "The autopilot's clock jumps 10 s back: follows on, or holds for less than 2 s.",
        Action(Kind.CLOCK_JUMPS, -10.0),
        for_s=6.0,
        back_within_s=2.0,
    ),
)

_BLACK = Action(Kind.FRAMES_BLACK)


def _switch(state: State, after_s: float = 0.1) -> Action:
    return Action(Kind.PILOT_SWITCHES, after_s=after_s, state=state)


_TAKES_OVER = "No setpoint later than 0.1 s after the heartbeat that says so"
_PILOT = (
    _pilot(
        "pilot-while-following",
        f"{_TAKES_OVER}; never follows by itself.",
        _switch(State.FOLLOWING),
    ),
    _pilot("pilot-while-coasting", f"{_TAKES_OVER}.", _BLACK, _switch(State.COASTING)),
    _pilot("pilot-while-searching", f"{_TAKES_OVER}.", _BLACK, _switch(State.SEARCHING)),
    _pilot(
        "pilot-while-holding",
        f"{_TAKES_OVER}.",
        Action(Kind.FRAMES_SILENT),
        _switch(State.HOLDING),
    ),
    _pilot(
        "pilot-while-released",
        f"{_TAKES_OVER}; it stays let go.",
        Action(Kind.STOP_REQUESTED),
        _switch(State.RELEASED),
    ),
    _pilot(
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
    _lets_go(
        "sticks-moved",
        "pilot",
        "The pilot moves a stick far: hold within 0.5 s, at rest within 7 s, let go.",
        Action(Kind.STICK_MOVED, 1900.0),
        hold_within_s=0.5,
    ),
    _lets_go(
        "consent-withdrawn",
        "pilot",
        "The operator withdraws consent: hold at once, at rest within 7 s, let go.",
        Action(Kind.CONSENT_WITHDRAWN),
        hold_within_s=0.1,
    ),
    _lets_go(
        "stop-requested",
        "pilot",
        "The operator says stop: hold at once, at rest within 7 s, let go.",
        Action(Kind.STOP_REQUESTED),
        hold_within_s=0.1,
    ),
)

_COMPUTER = (
    _carries_on(
        "wall-clock-jumps",
        "computer",
        "The computer's time of day jumps an hour back and forth: nothing changes.",
        Action(Kind.WALL_CLOCK_JUMPS, 3600.0),
    ),
    _comes_back(
        "control-stalls-0.5s",
        "computer",
        "No control step for 0.5 s: the next one holds; follows again within 3 s.",
        Action(Kind.CONTROL_STALLS),
        for_s=0.5,
    ),
    _lets_go(
        "control-stalls-2s",
        "computer",
        "No control step for 2 s: the first step holds and lets go.",
        Action(Kind.CONTROL_STALLS),
        for_s=2.0,
        hold_within_s=2.2,
        rest_within_s=None,
        excursion_m=None,
        flavours=("ardupilot",),
    ),
    _lets_go(
        "control-stalls-into-failsafe",
        "computer",
        "No control step for 2 s, and the autopilot is in its own failsafe: lets go, and sends "
        "nothing that calls it back.",
        Action(Kind.CONTROL_STALLS),
        for_s=2.0,
        hold_within_s=None,
        rest_within_s=None,
        excursion_m=None,
        flavours=("px4",),
    ),
    _carries_on(
        "cpu-starved",
        "computer",
        "Control steps up to 0.3 s late, vision at 5 Hz: stays in the envelope, follows again "
        "within 3 s.",
        Action(Kind.CONTROL_STARVED, 0.3),
        Action(Kind.VISION_SLOW, 0.2),
        back_within_s=3.0,
    ),
    _carries_on(
        "disk-full",
        "computer",
        "Nothing can be written: follows on; the recording says what is missing.",
        Action(Kind.DISK_FULL),
    ),
)


def _process(name: str, number: int, must: str, outcome: Outcome, **limits: Any) -> Fault:
    action = Action(Kind.PROCESS_SIGNALLED, float(number))
    return Fault(name, "process", must, outcome, (action,), lockstep=False, **limits)


_PROCESS = (
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

CATALOGUE: tuple[Fault, ...] = (
    *_VISION,
    *_FRAMES,
    *_TELEMETRY,
    *_LINK,
    *_AUTOPILOT,
    *_PILOT,
    *_COMPUTER,
    *_PROCESS,
)


def fault_named(name: str) -> Fault:
    """Return a fault of the catalogue.

    Raises:
        ValueError: there is none of that name.
    """
    for fault in CATALOGUE:
        if fault.name == name:
            return fault
    raise ValueError(f"there is no fault {name!r}; `follower faults list` shows them")


def in_groups(faults: Iterable[Fault] = CATALOGUE) -> dict[str, list[Fault]]:
    """Return the faults by their groups, in the catalogue's order."""
    groups: dict[str, list[Fault]] = {}
    for fault in faults:
        groups.setdefault(fault.group, []).append(fault)
    return groups
