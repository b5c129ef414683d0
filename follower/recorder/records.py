"""Messages that exist in a recording alone: parts of what flows, cut to be plotted."""

from __future__ import annotations

from dataclasses import dataclass

from follower.setting_change import SettingChange
from follower.supervisor import Reason, State
from follower_control.servo_settings import Mode
from follower_control.setpoint import VelocitySetpoint


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame that vision took.

    Attributes:
        sequence: the source's number of the frame; a gap means frames that vision did not take.
        captured_s: when it was exposed.
        received_s: when vision took it.
        width: of the image.
        height: of the image.
        video_index: which picture of video.mkv it is, counted from 0; none if it was left out.
    """

    sequence: int
    captured_s: float
    received_s: float
    width: int
    height: int
    video_index: int | None = None


@dataclass(frozen=True, slots=True)
class SetpointRecord:
    """What was asked of the vehicle.

    Attributes:
        asked: by the servo.
        allowed: by the envelope.
        limits: what made the difference.
        sent: whether `allowed` went to the autopilot.
    """

    asked: VelocitySetpoint
    allowed: VelocitySetpoint
    limits: tuple[str, ...]
    sent: bool


@dataclass(frozen=True, slots=True)
class StepRecord:
    """The end of a control step: all that belongs to it has been written before it.

    Attributes:
        time_s: when the step ran.
        late_s: how far behind its schedule it began.
        busy_s: how long it took by the computer's own clock.
        state: the supervisor's decision.
        reason: and why.
        track_sequence: frame number of the newest track; none before the first.
        track_captured_s: and that frame's capture time.
        mode_asked: the way of following that was asked for at this step; none if none was.
        changes: the settings that were changed in flight from this step on.
    """

    time_s: float
    late_s: float
    busy_s: float
    state: State
    reason: Reason
    track_sequence: int | None = None
    track_captured_s: float | None = None
    mode_asked: Mode | None = None
    changes: tuple[SettingChange, ...] = ()
