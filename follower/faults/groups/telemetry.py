"""What can happen to what the autopilot tells."""

from __future__ import annotations

import math

from follower.faults.fault import Action, Kind
from follower.faults.groups.promise import carries_on, comes_back, lets_go

TELEMETRY = (
    lets_go(
        "attitude-frozen",
        "telemetry",
        "The same numbers with new times are stale: hold within 0.3 s, at rest within 7 s.",
        Action(Kind.ATTITUDE_FROZEN),
        hold_within_s=0.3,
    ),
    lets_go(
        "position-frozen",
        "telemetry",
        "The same numbers with new times are stale: hold within 0.3 s, at rest within 7 s.",
        Action(Kind.POSITION_FROZEN),
        hold_within_s=0.3,
    ),
    lets_go(
        "telemetry-stops",
        "telemetry",
        "Nothing but heartbeats: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.TELEMETRY_STOPPED),
    ),
    lets_go(
        "telemetry-late-1s",
        "telemetry",
        "Attitudes of a second ago are stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.TELEMETRY_LATE, 1.0),
    ),
    carries_on(
        "telemetry-late-0.1s",
        "telemetry",
        "0.1 s late: follows on.",
        Action(Kind.TELEMETRY_LATE, 0.1),
    ),
    comes_back(
        "telemetry-late-0.3s",
        "telemetry",
        "Attitudes come later than the pictures that need them: holds within 1 s, follows again "
        "within 3 s of its end.",
        Action(Kind.TELEMETRY_LATE, 0.3),
        for_s=3.0,
        hold_within_s=1.0,
    ),
    lets_go(
        "attitude-nan",
        "telemetry",
        "NaN is dropped and what was known grows stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.ATTITUDE_NAN),
    ),
    lets_go(
        "position-nan",
        "telemetry",
        "NaN is dropped and what was known grows stale: hold within 0.7 s, at rest within 7 s.",
        Action(Kind.POSITION_NAN),
    ),
    carries_on(
        "position-jumps",
        "telemetry",
        "A position 30 m off for 2 s, inside the fence: follows on.",
        Action(Kind.POSITION_JUMPS, 30.0),
        for_s=2.0,
    ),
    comes_back(
        "heading-jumps",
        "telemetry",
        "A heading 30 degrees off for 1 s: keeps its distance, follows again within 5 s.",
        Action(Kind.YAW_JUMPS, math.radians(30.0)),
        for_s=1.0,
        hold_within_s=None,
        back_within_s=5.0,
    ),
)
