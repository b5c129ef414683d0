"""What can happen to the computer."""

from __future__ import annotations

from follower.faults.fault import Action, Fault, Kind, Outcome
from follower.faults.groups.promise import carries_on, comes_back, lets_go

COMPUTER = (
    carries_on(
        "wall-clock-jumps",
        "computer",
        "The computer's time of day jumps an hour back and forth: nothing changes.",
        Action(Kind.WALL_CLOCK_JUMPS, 3600.0),
    ),
    comes_back(
        "control-stalls-0.5s",
        "computer",
        "No control step for 0.5 s: the next one holds; follows again within 3 s.",
        Action(Kind.CONTROL_STALLS),
        for_s=0.5,
    ),
    lets_go(
        "control-stalls-2s",
        "computer",
        "No control step for 2 s: the first step holds and lets go.",
        Action(Kind.CONTROL_STALLS),
        for_s=2.0,
        hold_within_s=2.2,
        rest_within_s=None,
        excursion_m=None,
        flavours=("ardupilot",),
        links=("pymavlink",),
    ),
    lets_go(
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
        links=("pymavlink",),
    ),
    Fault(
        "control-stalls-into-hold",
        "computer",
        "No control step for 2 s: mavsdk's watchdog sends zero and has the autopilot hold (Hold, "
        "BRAKE), at rest within 7 s; the loop lets go, and sends nothing more.",
        Outcome.PILOT_HAS_IT,
        (Action(Kind.CONTROL_STALLS),),
        for_s=2.0,
        rest_within_s=7.0,
        excursion_m=13.0,
        lockstep=False,
        links=("mavsdk",),
    ),
    carries_on(
        "cpu-starved",
        "computer",
        "Control steps up to 0.3 s late, vision at 5 Hz: stays in the envelope, follows again "
        "within 3 s.",
        Action(Kind.CONTROL_STARVED, 0.3),
        Action(Kind.VISION_SLOW, 0.2),
        back_within_s=3.0,
        links=("pymavlink",),
    ),
    carries_on(
        "cpu-starved-0.2s",
        "computer",
        "Control steps up to 0.2 s late, vision at 5 Hz: mavsdk's watchdog sends zeros between "
        "and asks for no other mode; follows again within 3 s.",
        Action(Kind.CONTROL_STARVED, 0.2),
        Action(Kind.VISION_SLOW, 0.2),
        back_within_s=3.0,
        lockstep=False,
        links=("mavsdk",),
    ),
    carries_on(
        "disk-full",
        "computer",
        "Nothing can be written: follows on; the recording says what is missing.",
        Action(Kind.DISK_FULL),
    ),
)
