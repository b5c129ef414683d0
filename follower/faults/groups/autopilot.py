"""What the autopilot can do, and what it can tell of itself."""

from __future__ import annotations

from follower.faults.fault import Action, Fault, Kind, Outcome
from follower.faults.groups.promise import carries_on, lets_go, pilot_has_it
from follower.supervisor import State

AUTOPILOT = (
    lets_go(
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
    pilot_has_it(
        "estimator-lost",
        "No position any more, a second later the autopilot's own failsafe: hold within 0.7 s, "
        "nothing is sent after it.",
        Action(Kind.POSITION_STOPPED),
        Action(Kind.ESTIMATOR_FAILSAFE, after_s=1.0),
        hold_within_s=0.7,
    ),
    lets_go(
        "estimator-unwell",
        "autopilot",
        "The estimator rejects its measurements: hold within 1.5 s (the autopilot tells of it once "
        "a second), at rest within 8 s, let go.",
        Action(Kind.ESTIMATOR_UNWELL, 3.0),
        hold_within_s=1.5,
        rest_within_s=8.0,
        excursion_m=17.0,
    ),
    lets_go(
        "battery-low",
        "autopilot",
        "Less battery than is asked for: hold within 1.5 s (it tells of it once a second), at rest "
        "within 8 s, let go.",
        Action(Kind.BATTERY_LOW, 10.0),
        hold_within_s=1.5,
        rest_within_s=8.0,
        excursion_m=17.0,
    ),
    carries_on(
        "autopilot-clock-forward",
        "autopilot",
        "The autopilot's clock jumps 10 s ahead: follows on, or holds for less than 2 s.",
        Action(Kind.CLOCK_JUMPS, 10.0),
        for_s=6.0,
        back_within_s=2.0,
    ),
    carries_on(
        "autopilot-clock-back",
        "autopilot",
        "The autopilot's clock jumps 10 s back: follows on, or holds for less than 2 s.",
        Action(Kind.CLOCK_JUMPS, -10.0),
        for_s=6.0,
        back_within_s=2.0,
    ),
    carries_on(
        "autopilot-clock-slow",
        "autopilot",
        "The autopilot's clock loses 2 % for 10 s, as a simulated one may: follows on.",
        Action(Kind.CLOCK_SLOW, 0.02),
        for_s=10.0,
    ),
    carries_on(
        "autopilot-clock-stutters",
        "autopilot",
        "The autopilot's clock stands for 0.4 s: follows on, or holds for less than 2 s.",
        Action(Kind.CLOCK_JUMPS, -0.4),
        for_s=6.0,
        back_within_s=2.0,
    ),
)
