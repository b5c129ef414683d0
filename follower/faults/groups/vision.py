"""What can happen to the vision loop."""

from __future__ import annotations

from follower.faults.fault import Action, Kind
from follower.faults.groups.promise import comes_back, lets_go

VISION = (
    lets_go(
        "vision-dies",
        "vision",
        "Hold on the wire within 0.7 s, at rest within 7 s, let go 3 s later.",
        Action(Kind.VISION_DIES),
    ),
    lets_go(
        "vision-hangs",
        "vision",
        "Hold on the wire within 0.7 s, at rest within 7 s, let go 3 s later.",
        Action(Kind.VISION_HANGS),
    ),
    comes_back(
        "vision-hangs-1s",
        "vision",
        "Hold on the wire within 0.7 s; follows again within 3 s of the first new answer.",
        Action(Kind.VISION_HANGS),
        for_s=1.0,
    ),
    lets_go(
        "vision-2hz",
        "vision",
        "Answers of 0.5 s and more are too old: hold on the wire within 1.2 s, at rest within 7 s.",
        Action(Kind.VISION_SLOW, 0.5),
        hold_within_s=1.2,
    ),
)
