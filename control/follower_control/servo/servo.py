"""The law that turns an estimate of the target into a velocity setpoint."""

from __future__ import annotations

import cmath
import math

from follower_control.clip import clip
from follower_control.closing_in import fastest_closing_m_s
from follower_control.estimate import TargetEstimate
from follower_control.fade import Fade
from follower_control.nudge import Nudge
from follower_control.outlook import Outlook
from follower_control.overhead import Overhead
from follower_control.pid import Pid
from follower_control.pursuit_sight import PursuitSight
from follower_control.reference import Reference
from follower_control.relative_motion import (
    OLD_S,
    centred_share,
    heading_at,
    level_rate,
    offset,
    offset_rate,
)
from follower_control.servo_errors import ServoErrors
from follower_control.servo_settings import Mode, ServoSettings
from follower_control.setpoint import HOLD, VelocitySetpoint
from follower_control.sideways import Sideways
from follower_control.sighting import SightFrame
from follower_control.vehicle import VehicleState
from follower_vision.camera import Vector

TURN_LAG_S = 0.6
"""By how much a velocity in the heading frame lags a turning nose: both autopilots, measured."""

_IN_VAIN_S = 3.0
"""After how long a velocity that was sent and is not reached is not counted on any more."""

_STEEPEST_RAD = math.radians(60)
_AROUND = (Mode.SIDE, Mode.ORBIT)


class VisualServo:
    """Turns to the target, rises and sinks with it and holds its size in the image.

    What else it does depends on the mode, which may change in flight; see `Mode`.

    Args:
        settings: what is wanted, and the gains.
        mount_pitch_rad: the camera's pitch against the body, at which elevation the target is kept
            if the settings say nothing else.
        max_descent_m_s: how fast the vehicle may sink; the settings may allow less.
    """

    def __init__(
        self,
        settings: ServoSettings,
        mount_pitch_rad: float = 0.0,
        max_descent_m_s: float = math.inf,
    ) -> None:
        self._settings = s = settings
        self._max_descent_m_s = max_descent_m_s
        self._mode = s.mode
        self._mount_pitch = mount_pitch_rad
        self._reference = Reference(s.distance_m, self._wanted_elevation)
        self._azimuth_pid, self._elevation_pid = Pid(s.azimuth), Pid(s.elevation)
        self._range_pid = Pid(s.range)
        self._sight = PursuitSight(s, self._reference)
        self._sideways = Sideways(s)
        self._overhead = Overhead(s)
        self._fade = Fade(s.range.bumpless_s)
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

        What is wanted goes over to the new wish as smoothly as after a nudge; the rest of what the
        new settings change in the setpoint fades in.
        """
        before = self._settings
        self._max_descent_m_s = max_descent_m_s
        self._take(settings, before)
        self._reference.change(settings.distance_m, self._wanted_elevation)
        self._sight.change(settings)
        self._sideways.change(settings)
        self._overhead.change(settings)
        if self._last_s is not None:
            self._fade.start(self._asked)

    def start(self, present: VelocitySetpoint = HOLD) -> None:
        """Begin a pursuit; the first setpoint continues from `present`, the last one flown.

        Without a `target_size_m`, the next estimate's size is the one that will be held.
        """
        self._errors: ServoErrors | None = None
        self._reference.start()
        self._sight.start()
        self.resume(present)

    def resume(self, present: VelocitySetpoint = HOLD) -> None:
        """Go on after a pause with what was wanted before; continues from `present`."""
        self._asked = present if present.is_finite else HOLD
        self._forward = self._wanted = self._asked.forward_m_s
        self._climb = -self._asked.down_m_s
        self._last_s: float | None = None
        self._too_fast_m_s: float | None = None
        self._in_vain_m_s = 0.0
        self._fade.start()

    @property
    def mode(self) -> Mode:
        """Which way to follow."""
        return self._mode

    def change_mode(self, mode: Mode, present: VelocitySetpoint) -> None:
        """Follow another way from now on; continues from `present`, the last setpoint flown."""
        if mode is not self._mode:
            self._mode = mode
            self.resume(present)
            self._fade.start(self._asked)

    def nudge(self, nudge: Nudge) -> None:
        """Shift what is wanted, smoothly, until another nudge comes."""
        self._reference.nudge(nudge)

    @property
    def errors(self) -> ServoErrors | None:
        """What the last update saw, None before the first."""
        return self._errors

    def whereabouts(self, estimate: TargetEstimate, vehicle: VehicleState) -> TargetEstimate:
        """Return what is known of the target by its motion in the world, without steering by it."""
        return self._sight.seen(estimate, vehicle)

    def might_be(self, vehicle: VehicleState, now_s: float) -> Vector | None:
        """Return azimuths from north under which an unseen target may be by now, if known."""
        return self._sight.might_be(vehicle, now_s)

    def outlook(self, time_s: float) -> Outlook | None:
        """Return where the target can have been then, seen from us; None if it is not known."""
        return self._sight.outlook(time_s)

    def earlier_outlooks(self, time_s: float) -> list[Outlook]:
        """Return the same by what was believed in the last seconds, the latest first."""
        return self._sight.earlier_outlooks(time_s)

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
            allowed: what the envelope let through of the last setpoint.
        """
        estimate = self._sight.seen(estimate, vehicle)
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
        self._errors = self._sight.errors(estimate, yaw, self._mode, interval_s)
        if interval_s > 0:
            self._last_s = estimate.time_s
            steered = self._steer(self._errors, estimate, yaw, allowed, interval_s)
            self._asked = self._fade.update(steered, interval_s)
        return self._asked

    def _begin(self, estimate: TargetEstimate, yaw: float) -> None:
        self._last_s = estimate.time_s
        self._sight.hold_size(estimate)
        range_m, distance_m = self._sight.range_m(estimate), self._settings.distance_m
        present = complex(self._asked.forward_m_s, self._asked.right_m_s)
        ahead, rise = self._asked.forward_m_s, self._climb / range_m
        if self._mode in _AROUND:
            azimuth = cmath.phase(offset(estimate, range_m)) - yaw
            ahead = (present * cmath.rect(1.0, -azimuth)).real
            self._sideways.start(self._mode, (present * cmath.rect(1.0, -azimuth)).imag)
            self._forward = self._wanted = ahead
        if self._mode is Mode.OVERHEAD:
            self._overhead.start(present * cmath.rect(1.0, yaw))
            ahead = -self._climb
        self._azimuth_pid.start(self._asked.yaw_rate_rad_s)
        self._elevation_pid.start(rise)
        self._range_pid.start(ahead / distance_m)

    def _steer(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        yaw: float,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> VelocitySetpoint:
        if self._mode is Mode.OVERHEAD:
            return self._stay_above(errors, estimate, yaw, allowed, interval_s)
        yaw_rate = self._turn(errors, estimate, allowed, interval_s)
        if self._mode is Mode.WATCH:
            return VelocitySetpoint(yaw_rate_rad_s=yaw_rate)
        # Chasing is along the nose; what goes round the target is along the line of sight.
        along = cmath.rect(1.0, errors.azimuth_rad) if self._mode in _AROUND else complex(1.0)
        let_through = complex(allowed.forward_m_s, allowed.right_m_s) / along
        self._wanted = self._close_in(errors, estimate, let_through.real, interval_s)
        self._forward = self._slow_enough(errors, estimate, interval_s)
        right = self._reference.side_m_s
        if self._mode in _AROUND:
            place, drift = (f(estimate, errors.range_m) for f in (offset, offset_rate))
            right = self._sideways.update(
                place, drift, self._sight.target, right, let_through.imag, interval_s
            )
            # The velocity comes later than the nose turns.
            turning = clip((drift / place).imag if place else 0.0, 1.0)
            along *= cmath.rect(1.0, turning * TURN_LAG_S)
        off_nose = errors.azimuth_rad - self._reference.azimuth_rad
        centred = centred_share(off_nose, self._centred, self._off_axis)
        velocity = complex(self._forward * centred, right * centred) * along
        return VelocitySetpoint(
            forward_m_s=velocity.real,
            right_m_s=velocity.imag,
            down_m_s=self._sink(errors, estimate, allowed, interval_s),
            yaw_rate_rad_s=yaw_rate,
        )

    def _stay_above(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        yaw: float,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> VelocitySetpoint:
        """Go with the target, keep the height above it, turn the nose if that is wanted."""
        heading = cmath.rect(1.0, yaw)
        place = offset(estimate, errors.range_m)
        let_through = complex(allowed.forward_m_s, allowed.right_m_s) * heading
        velocity = self._overhead.update(
            place, errors.range_m, self._sight.target, let_through, interval_s
        )
        velocity /= heading
        # Closing in is sinking here.
        sink = self._close_in(errors, estimate, allowed.down_m_s, interval_s)
        self._forward = self._wanted = sink
        error = self._overhead.heading_error(self._sight.target, yaw)
        cut = self._asked.yaw_rate_rad_s - allowed.yaw_rate_rad_s
        return VelocitySetpoint(
            forward_m_s=velocity.real,
            right_m_s=velocity.imag,
            down_m_s=clip(sink, self._settings.max_vertical_m_s),
            yaw_rate_rad_s=self._azimuth_pid.update(error, -error, interval_s, cut=cut),
        )

    def _turn(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> float:
        """Yaw rate; the target's own angular rate is known only in the world's frame."""
        in_world = estimate.frame is SightFrame.WORLD
        error = errors.azimuth_rad - self._reference.azimuth_rad
        return self._azimuth_pid.update(
            error,
            -errors.azimuth_rad,
            interval_s,
            feed_forward=estimate.azimuth_rate_rad_s if in_world else 0.0,
            cut=self._asked.yaw_rate_rad_s - allowed.yaw_rate_rad_s,
        )

    def _sink(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> float:
        """Downward velocity: the loop's output is the climb over the range.

        Closing in on a target that lies below, it would sink in the image by itself. Fed forward
        is the climb that keeps its elevation: the horizontal closing speed times the elevation's
        tangent. Our own climbing is no part of that, or it would keep itself up.
        """
        if self._settings.hold_height:
            return 0.0
        slope = math.tan(clip(estimate.height_angle_rad, _STEEPEST_RAD))
        leaving = self._leaving(errors, estimate, allowed, interval_s)
        climb = errors.range_m * self._elevation_pid.update(
            errors.elevation_rad,
            -errors.elevation_rad,
            interval_s,
            feed_forward=-slope * leaving / errors.range_m,
            cut=(self._climb + allowed.down_m_s) / errors.range_m,
        )
        self._climb = climb
        return -clip(climb, self._settings.max_vertical_m_s)

    def _leaving(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> float:
        """Return how fast the level distance will grow when the vehicle flies as was sent.

        It rises and sinks as late as it speeds up: by its present speed it would climb after a
        target to which it is on its way, and be too high there. What it does not come up to within
        some seconds it will not reach. What is sent after a distance by size is as uneven as that,
        so that there the present speed counts.
        """
        now = level_rate(estimate, errors.range_m)
        if not self._sight.is_by_ground or estimate.frame is not SightFrame.WORLD:
            return now
        sent = complex(allowed.forward_m_s, allowed.right_m_s)
        closing = (sent * cmath.rect(1.0, -errors.azimuth_rad)).real
        behind = closing - (errors.target_speed_m_s - now)
        share = 1.0 - math.exp(-interval_s / _IN_VAIN_S)
        self._in_vain_m_s += share * (behind - self._in_vain_m_s)
        return now - (behind - self._in_vain_m_s)

    def _close_in(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed_m_s: float,
        interval_s: float,
    ) -> float:
        """Velocity towards the target, before it is slowed for one off-axis."""
        distance = self._settings.distance_m
        return distance * self._range_pid.update(
            errors.log_range,
            estimate.log_scale,
            interval_s,
            feed_forward=errors.target_speed_m_s / distance,
            cut=(self._wanted - allowed_m_s) / distance,
            gain=self._range_share,
        )

    def _slow_enough(
        self, errors: ServoErrors, estimate: TargetEstimate, interval_s: float
    ) -> float:
        """Return the wanted velocity towards the target, so slow that sinking keeps pace with it.

        What was flown faster than that at the start fades away.
        """
        s = self._settings
        if s.sink_share == 0 or s.hold_height or not self._sight.knows_motion:
            return self._wanted
        sink_m_s = s.sink_share * min(self._max_descent_m_s, s.max_vertical_m_s)
        fastest = max(errors.target_speed_m_s, 0.0) + fastest_closing_m_s(
            estimate.height_angle_rad, errors.elevation_rad, errors.range_m, sink_m_s
        )
        if self._too_fast_m_s is None:
            self._too_fast_m_s = max(self._wanted - fastest, 0.0)
        else:
            self._too_fast_m_s *= math.exp(-interval_s / s.range.bumpless_s)
        return min(self._wanted, fastest + self._too_fast_m_s)

    @property
    def _range_share(self) -> float:
        """The gain that keeps the range loop the same at the distance wanted now.

        The log of the range answers a velocity by one over the range.
        """
        if not self._settings.schedule_range:
            return 1.0
        return self._reference.distance_m / self._settings.distance_m
