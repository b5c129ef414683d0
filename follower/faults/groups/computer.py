"""What can happen to the computer."""

from __future__ import annotations

from follower.faults.fault import Action, Kind
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
    ),
    carries_on(
        "cpu-starved",
        "computer",
        "Control steps up to 0.3 s late, vision at 5 Hz: stays in the envelope, follows again "
        "within 3 s.",
        Action(Kind.CONTROL_STARVED, 0.3),
        Action(Kind.VISION_SLOW, 0.2),
        back_within_s=3.0,
    ),
    carries_on(
        "disk-full",
        "computer",
        "Nothing can be written: follows on; the recording says what is missing.",
        Action(Kind.DISK_FULL),
    ),
)
