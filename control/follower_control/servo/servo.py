"""The law that turns an estimate of the target into a velocity setpoint."""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

from follower_control.common.small_matrix import clip
from follower_control.servo.lateral import LateralControl, OverheadControl
from follower_control.servo.output_blend import OutputBlend, StickOffset, fastest_closing_m_s
from follower_control.servo.pid import Pid
from follower_control.servo.pursuit_state import PursuitState, Reference, ServoErrors
from follower_control.servo.settings import FollowMode, ServoSettings, added_mode
from follower_control.target.estimate import (
    OLD_S,
    TargetEstimate,
    centred_share,
    heading_at,
    level_rate,
    offset,
    offset_rate,
)
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import VehicleState, heading_velocity

TURN_LAG_S = 0.6
"""By how much a velocity in the heading frame lags a turning nose: both autopilots, measured."""

IN_VAIN_S = 3.0
"""After how long a velocity that was sent and is not reached is not counted on any more."""

_MOST_SHORT = 0.2
"""Of the velocity sent: by so much more at most is asked for where the vehicle stays behind."""

_STEEPEST_RAD = math.radians(60)
_AROUND = (FollowMode.SIDE, FollowMode.ORBIT)


@dataclass(frozen=True, slots=True)
class ServoStep:
    """What one update of the servo works with.

    Attributes:
        errors: how far the pursuit is from what is wanted.
        estimate: the target, predicted to now.
        yaw_rad: our heading, in the estimate's frame.
        allowed: what the envelope allowed of the last setpoint.
        interval_s: since the last update.
        flown: our own velocity, None without fresh telemetry of it.
    """

    errors: ServoErrors
    estimate: TargetEstimate
    yaw_rad: float
    allowed: VelocitySetpoint
    interval_s: float
    flown: VelocitySetpoint | None


class VisualServo:
    """Turns to the target, rises and sinks with it and holds its size in the image.

    What else it does depends on the mode, which may change in flight; see `FollowMode`.

    Args:
        settings: what is wanted, and the gains.
        mount_pitch_rad: the camera's pitch against the body, at which elevation the target is kept
            if the settings say nothing else.
        max_descent_m_s: how fast the vehicle may sink; the settings may allow less.

    Attributes:
        pursuit: the target's motion in the world, and the errors against what is wanted.
        mode: which way to follow.
        errors: the errors at the last update, None before the first.
    """

    def __init__(
        self,
        settings: ServoSettings,
        mount_pitch_rad: float = 0.0,
        max_descent_m_s: float = math.inf,
    ) -> None:
        self._settings = s = settings
        self._max_descent_m_s = max_descent_m_s
        self.mode = s.mode
        self._added_law = cache(lambda name: added_mode(name).guarded())
        self._mount_pitch = mount_pitch_rad
        self._reference = Reference(s.distance_m, self._wanted_elevation)
        self._azimuth_pid, self._elevation_pid = Pid(s.azimuth), Pid(s.elevation)
        self._range_pid = Pid(s.range)
        self.pursuit = PursuitState(s, self._reference)
        self._sideways = LateralControl(s)
        self._overhead = OverheadControl(s)
        self._fade = OutputBlend(s.range.bumpless_s)
        self._take(settings, settings)
        self.start()

    @property
    def _wanted_elevation(self) -> float:
        wanted = self._settings.elevation_deg
        return self._mount_pitch if wanted is None else math.radians(wanted)

    def _take(self, s: ServoSettings, before: ServoSettings) -> None:
        self._settings = s
        self._centred, self._off_axis = math.radians(s.centred_deg), math.radians(s.off_axis_deg)
        turn = math.radians(s.max_yaw_rate_deg_s)
        self._azimuth_pid.change(s.azimuth, -turn, turn)
        self._elevation_pid.change(s.elevation)
        back, forth = -s.max_backward_m_s / s.distance_m, s.max_forward_m_s / s.distance_m
        unit = s.distance_m / before.distance_m
        self._range_pid.change(s.range, back, forth, unit, self._range_share)
        self._fade.time_s = s.range.bumpless_s

    def change(self, settings: ServoSettings, max_descent_m_s: float = math.inf) -> None:
        """Go on by other settings, without a step in the setpoint; the mode stays as it is.

        What is wanted changes as smoothly as after a stick offset; the rest of what the
        new settings change in the setpoint fades in.
        """
        before = self._settings
        self._max_descent_m_s = max_descent_m_s
        self._take(settings, before)
        self._reference.change(settings.distance_m, self._wanted_elevation)
        self.pursuit.change(settings)
        self._sideways.change(settings)
        self._overhead.change(settings)
        if self._last_s is not None:
            self._fade.start(self._asked)

    def start(self, present: VelocitySetpoint = HOLD) -> None:
        """Begin a pursuit; the first setpoint continues from `present`, the last one flown.

        Without a `target_size_m`, the next estimate's size is the one that will be held.
        """
        self.errors: ServoErrors | None = None
        self._reference.start()
        self.pursuit.start()
        self.resume(present)

    def resume(self, present: VelocitySetpoint = HOLD) -> None:
        """Go on after a pause with what was wanted before; continues from `present`."""
        self._asked = present if present.is_finite else HOLD
        self._forward = self._wanted = self._asked.forward_m_s
        self._climb = -self._asked.down_m_s
        self._last_s: float | None = None
        self._too_fast_m_s: float | None = None
        self._in_vain_m_s = self._short_m_s = 0.0
        self._along = complex(1.0)
        self._fade.start()

    def change_mode(self, mode: FollowMode, present: VelocitySetpoint) -> None:
        """Follow another way from now on; continues from `present`, the last setpoint flown."""
        if mode is not self.mode:
            self.mode = mode
            self.resume(present)
            self._fade.start(self._asked)

    def set_offset(self, offset: StickOffset) -> None:
        """Shift what is wanted, smoothly, until another stick offset comes."""
        self._reference.set_offset(offset)

    def update(
        self, estimate: TargetEstimate, vehicle: VehicleState, allowed: VelocitySetpoint
    ) -> VelocitySetpoint:
        """Return the setpoint for the estimate's time.

        An estimate in the world's frame needs a fresh attitude: without one, the answer is to
        hold. After a pause of more than `OLD_S`, and when time ran backwards, the loops resume
        from `allowed`.

        Args:
            estimate: the target, predicted to now.
            vehicle: newest telemetry; without a position the target's speed is not fed
                forward.
            allowed: what the envelope allowed of the last setpoint.
        """
        estimate = self.pursuit.world_estimate(estimate, vehicle)
        yaw = heading_at(estimate, vehicle)
        if yaw is None:
            self.resume()
            return HOLD
        if self._last_s is not None and not 0 <= estimate.time_s - self._last_s <= OLD_S:
            self.resume(allowed)
        interval_s = 0.0 if self._last_s is None else estimate.time_s - self._last_s
        if self._last_s is None:
            self._begin(estimate, yaw)
        self._reference.step(interval_s)
        self.errors = self.pursuit.errors(estimate, yaw, self.mode, interval_s)
        if interval_s > 0:
            self._last_s = estimate.time_s
            known = vehicle.position_age_s(estimate.time_s) <= OLD_S
            flown = heading_velocity(vehicle) if known else None
            step = ServoStep(self.errors, estimate, yaw, allowed, interval_s, flown)
            steered = self._steered(step)
            self._asked = self._fade.update(steered, interval_s)
        return self._asked

    def _steered(self, step: ServoStep) -> VelocitySetpoint:
        law = self._LAWS.get(self.mode) or self._added_law(self.mode.value)
        return law(self, step)

    def _begin(self, estimate: TargetEstimate, yaw: float) -> None:
        self._last_s = estimate.time_s
        self.pursuit.hold_size(estimate)
        range_m, distance_m = self.pursuit.range_m(estimate), self._settings.distance_m
        present = complex(self._asked.forward_m_s, self._asked.right_m_s)
        ahead, rise = self._asked.forward_m_s, self._climb / range_m
        if self.mode in _AROUND:
            self._along = cmath.rect(1.0, cmath.phase(offset(estimate, range_m)) - yaw)
            present /= self._along
            ahead = present.real
            self._sideways.start(self.mode, present.imag)
            self._forward = self._wanted = ahead
        if self.mode is FollowMode.OVERHEAD:
            self._overhead.start(present * cmath.rect(1.0, yaw))
            ahead = -self._climb
        self._azimuth_pid.start(self._asked.yaw_rate_rad_s)
        self._elevation_pid.start(rise)
        self._range_pid.start(ahead / distance_m)

    def chase(self, step: ServoStep) -> VelocitySetpoint:
        """Turn to the target, keep its distance and height; go round it where the mode says so."""
        yaw_rate = self._turn(step)
        # In the axes that it was sent in: else their turning looks like a cut.
        allowed = complex(step.allowed.forward_m_s, step.allowed.right_m_s) / self._along
        # Chasing is along the nose; what goes round the target is along the line of sight.
        along = cmath.rect(1.0, step.errors.azimuth_rad) if self.mode in _AROUND else complex(1.0)
        flown_m_s = None
        if step.flown is not None:
            flown_m_s = (complex(step.flown.forward_m_s, step.flown.right_m_s) / along).real
        self._wanted = self._close_in(step, allowed.real, flown_m_s)
        self._forward = self._slow_enough(step)
        right = self._reference.side_m_s
        if self.mode in _AROUND:
            place, drift = (f(step.estimate, step.errors.range_m) for f in (offset, offset_rate))
            right = self._sideways.update(
                place, drift, self.pursuit.target, right, allowed.imag, step.interval_s
            )
            # The velocity comes later than the nose turns.
            turning = clip((drift / place).imag if place else 0.0, 1.0)
            along *= cmath.rect(1.0, turning * TURN_LAG_S)
        self._along = along
        off_nose = step.errors.azimuth_rad - self._reference.azimuth_rad
        centred = centred_share(off_nose, self._centred, self._off_axis)
        velocity = complex(self._forward * centred, right * centred) * along
        return VelocitySetpoint(
            forward_m_s=velocity.real,
            right_m_s=velocity.imag,
            down_m_s=self._sink(step),
            yaw_rate_rad_s=yaw_rate,
        )

    def watch(self, step: ServoStep) -> VelocitySetpoint:
        """Only turn to the target."""
        return VelocitySetpoint(yaw_rate_rad_s=self._turn(step))

    def stay_above(self, step: ServoStep) -> VelocitySetpoint:
        """Go with the target, keep the height above it, turn the nose if that is wanted."""
        heading = cmath.rect(1.0, step.yaw_rad)
        place = offset(step.estimate, step.errors.range_m)
        allowed = complex(step.allowed.forward_m_s, step.allowed.right_m_s) * heading
        velocity = self._overhead.update(
            place, step.errors.range_m, self.pursuit.target, allowed, step.interval_s
        )
        velocity /= heading
        # Closing in is sinking here.
        sink = self._close_in(step, step.allowed.down_m_s)
        if self._settings.hold_height:
            sink = 0.0
        self._forward = self._wanted = sink
        error = self._overhead.heading_error(self.pursuit.target, step.yaw_rad)
        saturation = self._asked.yaw_rate_rad_s - step.allowed.yaw_rate_rad_s
        return VelocitySetpoint(
            forward_m_s=velocity.real,
            right_m_s=velocity.imag,
            down_m_s=clip(sink, self._settings.max_vertical_m_s),
            yaw_rate_rad_s=self._azimuth_pid.update(
                error, -error, step.interval_s, saturation=saturation
            ),
        )

    _LAWS: ClassVar[dict[FollowMode, Callable[..., VelocitySetpoint]]] = {
        FollowMode.CHASE: chase,
        FollowMode.WATCH: watch,
        FollowMode.SIDE: chase,
        FollowMode.ORBIT: chase,
        FollowMode.OVERHEAD: stay_above,
    }
    """What each mode does with a step."""

    def _turn(self, step: ServoStep) -> float:
        """Yaw rate; the target's own angular rate is known only in the world's frame."""
        in_world = step.estimate.frame is BearingFrame.WORLD
        error = step.errors.azimuth_rad - self._reference.azimuth_rad
        return self._azimuth_pid.update(
            error,
            -step.errors.azimuth_rad,
            step.interval_s,
            feed_forward=step.estimate.azimuth_rate_rad_s if in_world else 0.0,
            saturation=self._asked.yaw_rate_rad_s - step.allowed.yaw_rate_rad_s,
        )

    def _sink(self, step: ServoStep) -> float:
        """Downward velocity: the loop's output is the climb over the range.

        Closing in on a target that lies below, it would sink in the image by itself. Fed forward
        is the climb that keeps its elevation: the horizontal closing speed times the elevation's
        tangent. Our own climbing is no part of that, or it would keep itself up.
        """
        if self._settings.hold_height:
            return 0.0
        slope = math.tan(clip(step.estimate.height_angle_rad, _STEEPEST_RAD))
        leaving = self._leaving(step)
        climb = step.errors.range_m * self._elevation_pid.update(
            step.errors.elevation_rad,
            -step.errors.elevation_rad,
            step.interval_s,
            feed_forward=-slope * leaving / step.errors.range_m,
            saturation=(self._climb + step.allowed.down_m_s) / step.errors.range_m,
        )
        self._climb = climb
        return -clip(climb, self._settings.max_vertical_m_s)

    def _leaving(self, step: ServoStep) -> float:
        """Return how fast the level distance will grow when the vehicle flies as was sent.

        It rises and sinks as late as it speeds up: by its present speed it would climb after a
        target to which it is on its way, and be too high there. What it does not come up to within
        some seconds it will not reach. What is sent after a distance by size is as uneven as that,
        so that there the present speed counts.
        """
        present = level_rate(step.estimate, step.errors.range_m)
        if not self.pursuit.is_by_ground or step.estimate.frame is not BearingFrame.WORLD:
            return present
        sent = complex(step.allowed.forward_m_s, step.allowed.right_m_s)
        closing = (sent * cmath.rect(1.0, -step.errors.azimuth_rad)).real
        behind = closing - (step.errors.target_speed_m_s - present)
        share = 1.0 - math.exp(-step.interval_s / IN_VAIN_S)
        self._in_vain_m_s += share * (behind - self._in_vain_m_s)
        return present - (behind - self._in_vain_m_s)

    def _close_in(
        self, step: ServoStep, allowed_m_s: float, flown_m_s: float | None = None
    ) -> float:
        """Velocity towards the target, before it is slowed for one off-axis."""
        distance = self._settings.distance_m
        speed_m_s = step.errors.target_speed_m_s
        if flown_m_s is not None:
            speed_m_s += self._shortfall(allowed_m_s, flown_m_s, step.interval_s)
        return distance * self._range_pid.update(
            step.errors.log_range,
            step.estimate.log_scale,
            step.interval_s,
            feed_forward=speed_m_s / distance,
            saturation=(self._wanted - allowed_m_s) / distance,
            gain=self._range_share,
        )

    def _shortfall(self, allowed_m_s: float, flown_m_s: float, interval_s: float) -> float:
        """Return by how much the vehicle stays slower than it was sent for seconds, m/s.

        PX4 flies a tenth slower than it is asked to for as long as its integral takes against drag
        and wind. Asking for so much more is what keeps up with a steady target; a limit keeps a
        vehicle that cannot fly any faster from being asked to.
        """
        share = 1.0 - math.exp(-interval_s / IN_VAIN_S)
        self._short_m_s += share * (allowed_m_s - flown_m_s - self._short_m_s)
        return min(max(self._short_m_s, 0.0), _MOST_SHORT * max(allowed_m_s, 0.0))

    def _slow_enough(self, step: ServoStep) -> float:
        """Return the wanted velocity towards the target, so slow that sinking keeps pace with it.

        What was flown faster than that at the start fades away.
        """
        s = self._settings
        if s.sink_share == 0 or s.hold_height or not self.pursuit.knows_motion:
            return self._wanted
        sink_m_s = s.sink_share * min(self._max_descent_m_s, s.max_vertical_m_s)
        fastest = max(step.errors.target_speed_m_s, 0.0) + fastest_closing_m_s(
            step.estimate.height_angle_rad, step.errors.elevation_rad, step.errors.range_m, sink_m_s
        )
        if self._too_fast_m_s is None:
            self._too_fast_m_s = max(self._wanted - fastest, 0.0)
        else:
            self._too_fast_m_s *= math.exp(-step.interval_s / s.range.bumpless_s)
        return min(self._wanted, fastest + self._too_fast_m_s)

    @property
    def _range_share(self) -> float:
        """The gain that keeps the range loop the same at the distance wanted now.

        The log of the range answers a velocity by one over the range.
        """
        if not self._settings.schedule_range:
            return 1.0
        return self._reference.distance_m / self._settings.distance_m
