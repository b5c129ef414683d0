"""What of a flight the ground station is told, read while it goes on."""

from __future__ import annotations

from dataclasses import dataclass

from follower.flightlog import ControlRecord, FlightLog
from follower.links.link import Link
from follower.operator_requests import OperatorRequests
from follower_control.target_fix import TargetFix, target_fix
from follower_vision.track import Track

_STALE_S = 1.0


@dataclass(frozen=True, slots=True)
class FlightView:
    """Reads what the stages have left in the log; may be used by any thread.

    Attributes:
        log: grows on other threads meanwhile.
        link: the one to the autopilot.
        requests: what operators want goes there.
        size: width and height of the frames.
    """

    log: FlightLog
    link: Link
    requests: OperatorRequests
    size: tuple[int, int]

    def track(self, now_s: float) -> Track | None:
        """Return vision's newest answer unless it is old."""
        record = self.log.tracks[-1] if self.log.tracks else None
        if record is None or now_s - record.captured_s > _STALE_S:
            return None
        return record.track

    def step(self, now_s: float) -> ControlRecord | None:
        """Return the newest control step unless it is old."""
        record = self.log.controls[-1] if self.log.controls else None
        return None if record is None or now_s - record.time_s > _STALE_S else record

    def fix(self, now_s: float) -> TargetFix | None:
        """Return where the target is in the world, None if that is not known now."""
        step = self.step(now_s)
        if step is None or step.estimate is None:
            return None
        return target_fix(step.estimate, step.vehicle, self.requests.settings.servo)
