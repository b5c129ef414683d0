"""What the vehicle does once it was let go, by `release.action`.

The operator withdraws consent; the vehicle is held, and the rest is the action's.
"""

from __future__ import annotations

from typing import Any

from follower.faults.fault import Action, Fault, Kind, Outcome
from follower.release import ReleaseAction

_OURS = (("px4", "OFFBOARD"), ("ardupilot", "GUIDED"))


def _release(
    name: str,
    action: ReleaseAction,
    must: str,
    ends_in: tuple[tuple[str, str], ...],
    *more: Action,
    **limits: Any,
) -> Fault:
    return Fault(
        name,
        "release",
        must,
        Outcome.ENDS_IN_MODE,
        (Action(Kind.CONSENT_WITHDRAWN), *more),
        hold_within_s=0.1,
        settings=(f"release.action={action}",),
        ends_in=ends_in,
        **{"for_s": 10.0, **limits},
    )


_NOBODY_ACTS = Action(Kind.OTHER_MODES_REFUSED)
"""Also the pilot that the simulation plays takes no other mode."""

RELEASE = (
    _release(
        "release-hold",
        ReleaseAction.HOLD,
        "Hold at once, at rest within 7 s; while nobody takes another mode, zeros go on.",
        _OURS,
        _NOBODY_ACTS,
        rest_within_s=7.0,
    ),
    _release(
        "release-loiter",
        ReleaseAction.LOITER,
        "Hold at once, then PX4's Hold or ArduCopter's BRAKE within 9 s; nothing is sent after it.",
        (("px4", "LOITER"), ("ardupilot", "BRAKE")),
        rest_within_s=7.0,
        silent_within_s=9.0,
    ),
    _release(
        "release-rtl",
        ReleaseAction.RTL,
        "Hold at once, then RTL within 9 s; nothing is sent after it.",
        (("px4", "RTL"), ("ardupilot", "RTL")),
        silent_within_s=9.0,
    ),
    _release(
        "release-land",
        ReleaseAction.LAND,
        "Hold at once, then LAND within 9 s; nothing is sent after it.",
        (("px4", "LAND"), ("ardupilot", "LAND")),
        silent_within_s=9.0,
    ),
    _release(
        "release-refused",
        ReleaseAction.LAND,
        "LAND is refused: hold at once, at rest within 7 s, zeros go on.",
        _OURS,
        _NOBODY_ACTS,
        rest_within_s=7.0,
    ),
    _release(
        "release-hand-back",
        ReleaseAction.HAND_BACK,
        "Hold at once; at rest, the stream ends within 11 s: PX4 flies home by its own failsafe, "
        "ArduCopter stays in GUIDED.",
        (("px4", "RTL"), ("ardupilot", "GUIDED")),
        for_s=14.0,
        silent_within_s=11.0,
    ),
)
