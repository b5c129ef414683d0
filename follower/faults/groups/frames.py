"""What can happen to the pictures."""

from __future__ import annotations

from follower.faults.fault import Action, Kind
from follower.faults.groups.promise import carries_on, comes_back, lets_go

FRAMES = (
    lets_go(
        "frames-frozen",
        "frames",
        "The same picture with new times counts as unseen: at rest within 7 s, let go.",
        Action(Kind.FRAMES_FROZEN),
        hold_within_s=1.6,
    ),
    lets_go(
        "frames-black",
        "frames",
        "Coasts for 0.8 s at most, then holds: at rest within 7 s, let go after the search.",
        Action(Kind.FRAMES_BLACK),
        hold_within_s=1.6,
    ),
    comes_back(
        "frames-black-1s",
        "frames",
        "Coasts, holds, and follows again within 3 s of the first picture.",
        Action(Kind.FRAMES_BLACK),
        for_s=1.0,
        hold_within_s=None,
    ),
    lets_go(
        "frames-stop",
        "frames",
        "No frame for 0.5 s: hold on the wire within 0.7 s, at rest within 7 s.",
        Action(Kind.FRAMES_SILENT),
    ),
    carries_on(
        "frames-late-0.2s",
        "frames",
        "0.2 s later than usual is predicted over: follows on.",
        Action(Kind.FRAMES_LATE, 0.2),
    ),
    lets_go(
        "frames-late-1s",
        "frames",
        "Too old to steer by: hold on the wire within 0.7 s, at rest within 7 s.",
        Action(Kind.FRAMES_LATE, 1.0),
    ),
    carries_on(
        "frames-reordered",
        "frames",
        "Frames from the past are passed over: follows on.",
        Action(Kind.FRAMES_REORDERED),
    ),
)
