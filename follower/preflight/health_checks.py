"""Checks of what the autopilot says about itself."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from follower.preflight.finding import Finding, failed, passed, unknown, warned
from follower.preflight.snapshot import Snapshot

_NAMES = {
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO: "gyroscope",
    mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL: "accelerometer",
    mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG: "compass",
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE: "barometer",
    mavlink.MAV_SYS_STATUS_SENSOR_GPS: "GPS",
    mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS: "motor outputs",
    mavlink.MAV_SYS_STATUS_AHRS: "attitude estimate",
}
_OTHERS = {
    mavlink.MAV_SYS_STATUS_PREARM_CHECK: "pre-arm checks",
    mavlink.MAV_SYS_STATUS_SENSOR_BATTERY: "battery",
    mavlink.MAV_SYS_STATUS_LOGGING: "logging",
    mavlink.MAV_SYS_STATUS_GEOFENCE: "geofence",
}
_RC = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
_ESTIMATES = {
    mavlink.ESTIMATOR_ATTITUDE: "attitude",
    mavlink.ESTIMATOR_VELOCITY_HORIZ: "horizontal velocity",
    mavlink.ESTIMATOR_VELOCITY_VERT: "vertical velocity",
}
_POSITION = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
_CONSTANT = mavlink.ESTIMATOR_CONST_POS_MODE
_DOUBTFUL, _REJECTED = 0.8, 1.0
_RESERVE = 0.15
_FEW_SATELLITES, _POOR_HDOP = 8, 2.5
_FIX_3D = 3
_STALE_S = 5.0
_RC_FRESH_S = 1.0


def sensors(s: Snapshot) -> Finding:
    """SYS_STATUS calls all sensors that flight needs healthy."""
    told = s.health.sensors
    if told is None:
        return unknown("SYS_STATUS did not come")
    bad = _named(told.unhealthy, _NAMES)
    if bad:
        return failed(
            f"unhealthy: {bad}", "see the ground station's messages; calibrate or mend it"
        )
    doubtful = _named(told.unhealthy, _OTHERS)
    if doubtful:
        return warned(f"not well: {doubtful}", "see the ground station's messages")
    return passed("all healthy")


def remote_control(s: Snapshot) -> Finding:
    """A receiver is there, with which the pilot takes over."""
    told = s.health.sensors
    if told is None:
        return unknown("SYS_STATUS did not come")
    if not told.enabled & _RC:
        return warned("no RC receiver is in use", "have another way to change the mode at hand")
    if told.unhealthy & _RC:
        return warned("the RC receiver hears nothing", "switch on the transmitter")
    return passed("healthy")


def battery(s: Snapshot) -> Finding:
    """The battery is not low."""
    told = s.health.sensors
    if told is None:
        return unknown("SYS_STATUS did not come")
    share = told.battery_share
    if share is None:
        return warned("the autopilot does not know its battery", "set up the battery monitor")
    text, least = f"{share:.0%}", s.settings.health.battery_to_start
    if share < least:
        return failed(f"{text}, following does not begin below {least:.0%}", "charge it")
    return warned(text, "charge it") if share < least + _RESERVE else passed(text)


def gps(s: Snapshot) -> Finding:
    """GPS knows where it is, or the estimator does without it."""
    told = s.health.gps
    if told is None or s.now_s - told.time_s > _STALE_S:
        return _without_gps(s, "GPS_RAW_INT does not come")
    wanted = s.settings.health.gps_fix or _FIX_3D
    if told.fix_type < wanted:
        return _without_gps(s, f"no position yet (fix type {told.fix_type})")
    count = "?" if told.satellites is None else told.satellites
    text = f"{count} satellites, HDOP {'?' if told.hdop is None else f'{told.hdop:.1f}'}"
    few = told.satellites is not None and told.satellites < _FEW_SATELLITES
    poor = told.hdop is not None and told.hdop > _POOR_HDOP
    return warned(text, "wait, or move away from walls") if few or poor else passed(text)


def _without_gps(s: Snapshot, why: str) -> Finding:
    estimator = s.health.estimator
    placed = estimator is not None and estimator.flags & _POSITION
    if placed and s.settings.health.gps_fix is None:
        return warned(f"{why}, but the estimator has a position", "check that it means to")
    todo = "wait under open sky; to fly by optical flow or another source set health.gps_fix: null"
    return failed(why, todo)


def estimator(s: Snapshot) -> Finding:
    """The estimator has attitude, velocity and position, and its measurements agree."""
    told = s.health.estimator
    if told is None or s.now_s - told.time_s > _STALE_S:
        return unknown("the estimator's report does not come")
    lacking = [name for bit, name in _ESTIMATES.items() if not told.flags & bit]
    lacking += [] if told.flags & _POSITION and not told.flags & _CONSTANT else ["position"]
    if lacking:
        return failed(f"no {', no '.join(lacking)}", "wait for GPS and for the estimator to settle")
    if told.gps_glitch:
        return failed("it sees GPS jump", "move away from walls and interference")
    worst, ratio = max(told.ratios.items(), key=lambda item: item[1])
    text = f"worst test ratio {ratio:.2f} ({worst})"
    if ratio >= _REJECTED:
        return failed(f"{text}: rejected", "calibrate that sensor, move away from metal, wait")
    return warned(text, "calibrate that sensor, or wait") if ratio > _DOUBTFUL else passed(text)


def position(s: Snapshot) -> Finding:
    """A fresh local position and velocity come."""
    age_s = s.vehicle.position_age_s(s.now_s)
    if s.vehicle.position is None:
        return failed("LOCAL_POSITION_NED does not come", "the estimator has no position yet: wait")
    if age_s > s.settings.supervisor.telemetry_timeout_s:
        return failed(
            f"{age_s:.1f} s old", "the estimator has lost its position, or the link is slow"
        )
    return passed(f"{s.vehicle.position.height_m:z.1f} m above its origin")


def mode(s: Snapshot) -> Finding:
    """Nothing would begin by itself: the pilot's mode does not allow following yet."""
    where = "in the air" if s.vehicle.landed is False else "on the ground"
    armed = "armed" if s.vehicle.armed else "disarmed"
    text = f"{s.vehicle.mode or 'mode unknown'}, {armed}, {where}"
    if s.settings.autonomy == "full" or not s.vehicle.obeys_setpoints:
        return passed(text)
    todo = f"leave {s.vehicle.mode}; go back into it when following is to begin"
    return failed(text, todo) if s.vehicle.armed else warned(text, todo)


def landed_state(s: Snapshot) -> Finding:
    """The autopilot says whether it stands on the ground."""
    if s.vehicle.landed is None:
        return warned(
            "the autopilot does not say whether it is on the ground",
            "be in the air before taking OFFBOARD or GUIDED: following may begin at once",
        )
    return passed("on the ground" if s.vehicle.landed else "in the air")


def consent(s: Snapshot) -> Finding:
    """The second consent, if the settings ask for one, can be given and was not given yet."""
    c = s.settings.consent
    if c.kind != "rc":
        return passed({"mode": "the pilot's mode alone"}.get(c.kind, f"by {c.kind}"))
    rc = s.vehicle.fresh_rc(s.now_s, c.rc_timeout_s)
    pulse = None if rc is None else rc.pulse_us(c.rc_channel)
    if pulse is None:
        return failed(
            f"channel {c.rc_channel} of the remote control is not heard",
            "switch on the transmitter, or set consent.rc_channel",
        )
    text = f"channel {c.rc_channel} is at {pulse} µs, on beyond {c.rc_threshold_us}"
    if (pulse >= c.rc_threshold_us) is not c.rc_reversed:
        return warned(text, "switch it off: it counts once it was turned on")
    return passed(text)


def sticks(s: Snapshot) -> Finding:
    """The pilot's sticks are heard, if they are to do anything while we follow."""
    wanted = s.settings.sticks
    if not wanted.nudge and wanted.takeover is None:
        return passed("the settings give them no effect")
    rc = s.vehicle.fresh_rc(s.now_s, _RC_FRESH_S)
    channels = (
        wanted.roll_channel,
        wanted.pitch_channel,
        wanted.throttle_channel,
        wanted.yaw_channel,
    )
    if rc is not None and all(rc.pulse_us(channel) is not None for channel in channels):
        return passed("heard")
    todo = "switch on the transmitter, and have the autopilot send RC_CHANNELS"
    if wanted.nudge:
        return failed("RC_CHANNELS do not come, and sticks.nudge is set", todo)
    return warned("RC_CHANNELS do not come: a stick moved far will not take over", todo)


def _named(mask: int, names: dict[int, str]) -> str:
    return ", ".join(name for bit, name in names.items() if mask & bit)
