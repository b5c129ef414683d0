"""Checks of the link and of what the autopilot reports about itself."""

from pymavlink.dialects.v20 import common as mavlink

from follower.apps.preflight.check import (
    CheckGroup,
    PreflightFinding,
    Snapshot,
    failed,
    graded,
    passed,
    unknown,
    warned,
)
from follower_control.envelope.envelope import Envelope
from follower_control.envelope.flight_context import FlightContext

LINK, AUTOPILOT = CheckGroup[Snapshot]("Link"), CheckGroup[Snapshot]("Autopilot")
_HEARTBEAT_S = 3.0
_TESTED = {"px4": (1, 18), "ardupilot": (4, 6)}
_OLDEST = {"px4": (1, 14), "ardupilot": (4, 2)}
_COPTERS = {
    "quadrotor", "hexarotor", "octorotor", "tricopter", "coaxial", "helicopter", "dodecarotor",
    "decarotor",
}  # fmt: skip
_LATE_S, _TOO_LATE_S = 0.2, 0.5
_OFF_S, _TOO_OFF_S = 0.05, 0.15
_OLD_S = 0.15
_LOSS, _TOO_MUCH_LOSS = 0.02, 0.1
_LEAST_HZ = {"ATTITUDE": 10.0, "LOCAL_POSITION_NED": 5.0}
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


@LINK.check("vehicle", "one vehicle is heard, and its heartbeat is younger than 3 s")
def _vehicle(s: Snapshot) -> PreflightFinding:
    if s.link.problem:
        return failed(s.link.problem, "set link.vehicle_id to the one to follow with")
    age_s = s.vehicle.heartbeat_age_s(s.now_s)
    if s.link.vehicle_id is None:
        return failed(
            f"no heartbeat was heard ({s.link.line()})",
            "is the autopilot on, does it send MAVLink to the address given by --connect, and "
            "for a serial port, is the baud rate its own?",
        )
    if age_s > _HEARTBEAT_S:
        return failed(
            f"system {s.link.vehicle_id}: no heartbeat for {age_s:.0f} s",
            "look after the cable, the radio and the autopilot's power",
        )
    return passed(f"system {s.link.vehicle_id}, {s.link.autopilot}, by {s.link.kind}")


@LINK.check("type", "it is a multicopter or helicopter")
def _vehicle_type(s: Snapshot) -> PreflightFinding:
    kind = s.health.vehicle_type
    if kind is None:
        return unknown("the vehicle has not said what it is")
    entry = mavlink.enums["MAV_TYPE"].get(kind)
    name = str(kind) if entry is None else entry.name
    short = name.removeprefix("MAV_TYPE_").lower()
    if short in _COPTERS:
        return passed(short)
    return failed(
        f"{name} cannot fly body velocities as a multicopter does",
        "fly a multicopter; a VTOL is not supported",
    )


@LINK.check("firmware", "PX4 1.14 to 1.18 or ArduCopter 4.2 to 4.6", needed=False)
def _firmware(s: Snapshot) -> PreflightFinding:
    version, kind = s.health.firmware, s.link.autopilot
    if version is None or kind not in _TESTED:
        return unknown("the autopilot has not reported its version")
    text = f"{kind} {'.'.join(map(str, version))}"
    if version[:2] < _OLDEST[kind]:
        oldest = ".".join(map(str, _OLDEST[kind]))
        return warned(
            f"{text} is older than {oldest}", "update it: its behaviour is not known here"
        )
    if version[:2] > _TESTED[kind]:
        tested = ".".join(map(str, _TESTED[kind]))
        return warned(f"{text} is newer than {tested}, which was measured", "try it in SITL first")
    return passed(text)


@LINK.check("attitude-rate", "ATTITUDE at 40 % of the rate asked for; never below 10 Hz")
def _attitude_rate(s: Snapshot) -> PreflightFinding:
    return _rate(s, "ATTITUDE", "link.attitude_rate_hz")


@LINK.check("position-rate", "LOCAL_POSITION_NED at 40 % of the rate asked for; never below 5 Hz")
def _position_rate(s: Snapshot) -> PreflightFinding:
    return _rate(s, "LOCAL_POSITION_NED", "link.position_rate_hz")


def _rate(s: Snapshot, name: str, setting: str) -> PreflightFinding:
    rate = next((rate for rate in s.link.rates if rate.name == name), None)
    if rate is None:
        return unknown(f"{name} was not counted")
    text = f"{rate.measured_hz:.0f} Hz, asked for {rate.wanted_hz:.0f}"
    if not rate.measured_hz:
        text = f"{name} does not come at all"
    todo = f"a faster link, or fewer streams to other programs, or a lower {setting}"
    usable = rate.measured_hz >= _LEAST_HZ[name]
    return graded(text, todo, good=rate.is_enough, usable=usable)


@LINK.check("round-trip", "TIMESYNC is answered within 0.2 s; never later than 0.5 s")
def _round_trip(s: Snapshot) -> PreflightFinding:
    seconds = s.link.round_trip_s
    if seconds is None:
        return unknown("TIMESYNC is not answered", "allow MAVLink 2 in both directions")
    text = f"{1e3 * seconds:.0f} ms there and back"
    todo = "use a cable between companion and autopilot, or a faster baud rate"
    return graded(text, todo, good=seconds <= _LATE_S, usable=seconds <= _TOO_LATE_S)


@LINK.check(
    "clocks",
    "the autopilot's times are known on our clock to 50 ms; never worse than 150 ms",
)
def _clocks(s: Snapshot) -> PreflightFinding:
    error_s = s.link.clock_error_s
    if error_s is None:
        return unknown("the clocks were not compared", "TIMESYNC has to be answered")
    text = f"known to {1e3 * error_s:.0f} ms"
    if s.link.clock_restarts > 1:
        return warned(f"{text}; the autopilot's clock jumped", "wait until it has started")
    todo = "a link with shorter and steadier delays"
    return graded(text, todo, good=error_s <= _OFF_S, usable=error_s <= _TOO_OFF_S)


@LINK.check(
    "attitude-age",
    "attitudes are at most 150 ms old; never older than supervisor.telemetry_timeout_s; their"
    " numbers change",
)
def _attitude_age(s: Snapshot) -> PreflightFinding:
    if s.attitude_repeats:
        return failed(
            "the attitude repeats itself to the last bit",
            "the autopilot's estimator stands still: restart the autopilot",
        )
    age_s, limit_s = s.attitude_age_s, s.settings.supervisor.telemetry_timeout_s
    if age_s == float("inf"):
        return failed("no attitude came", "look at the rates above")
    text = f"at most {1e3 * age_s:.0f} ms old, after TIMESYNC"
    todo = "ask for a higher link.attitude_rate_hz, or use a faster link"
    return graded(text, todo, good=age_s <= _OLD_S, usable=age_s < limit_s)


@LINK.check("packet-loss", "at most 2 % of the packets are lost; never more than 10 %")
def _packet_loss(s: Snapshot) -> PreflightFinding:
    if not s.link.of_vehicle:
        return unknown("no packets came")
    share = s.link.lost_share
    text = f"{share:.1%} of {s.link.of_vehicle + s.link.lost} packets lost"
    todo = "a better antenna or a cable, a slower stream, or a faster baud rate"
    return graded(text, todo, good=share <= _LOSS, usable=share <= _TOO_MUCH_LOSS)


@AUTOPILOT.check(
    "sensors",
    "SYS_STATUS calls gyroscope, accelerometer, compass, barometer, GPS and attitude healthy",
)
def _sensors(s: Snapshot) -> PreflightFinding:
    report = s.health.sensors
    if report is None:
        return unknown("SYS_STATUS did not come")
    bad = _named(report.unhealthy, _NAMES)
    if bad:
        return failed(
            f"unhealthy: {bad}", "see the ground station's messages; calibrate or mend it"
        )
    doubtful = _named(report.unhealthy, _OTHERS)
    if doubtful:
        return warned(f"not well: {doubtful}", "see the ground station's messages")
    return passed("all healthy")


@AUTOPILOT.check("remote-control", "SYS_STATUS has a healthy RC receiver", needed=False)
def _remote_control(s: Snapshot) -> PreflightFinding:
    report = s.health.sensors
    if report is None:
        return unknown("SYS_STATUS did not come")
    if not report.enabled & _RC:
        return warned("no RC receiver is in use", "have another way to change the mode at hand")
    if report.unhealthy & _RC:
        return warned("the RC receiver receives nothing", "switch on the transmitter")
    return passed("healthy")


@AUTOPILOT.check("battery", "above health.battery_to_start by 15 %; never below it")
def _battery(s: Snapshot) -> PreflightFinding:
    report = s.health.sensors
    if report is None:
        return unknown("SYS_STATUS did not come")
    share = report.battery_share
    if share is None:
        return warned("the autopilot does not know its battery", "set up the battery monitor")
    text, least = f"{share:.0%}", s.settings.health.battery_to_start
    if share < least:
        return failed(f"{text}, following does not begin below {least:.0%}", "charge it")
    return warned(text, "charge it") if share < least + _RESERVE else passed(text)


@AUTOPILOT.check(
    "gps",
    "a fix of health.gps_fix, 8 satellites, HDOP 2.5; with health.gps_fix null an estimator "
    "that has a position without it",
)
def _gps(s: Snapshot) -> PreflightFinding:
    report = s.health.gps
    if report is None or s.now_s - report.time_s > _STALE_S:
        return _without_gps(s, "GPS_RAW_INT does not come")
    wanted = s.settings.health.gps_fix or _FIX_3D
    if report.fix_type < wanted:
        return _without_gps(s, f"no position yet (fix type {report.fix_type})")
    count = "?" if report.satellites is None else report.satellites
    text = f"{count} satellites, HDOP {'?' if report.hdop is None else f'{report.hdop:.1f}'}"
    few = report.satellites is not None and report.satellites < _FEW_SATELLITES
    poor = report.hdop is not None and report.hdop > _POOR_HDOP
    return warned(text, "wait, or move away from walls") if few or poor else passed(text)


def _without_gps(s: Snapshot, why: str) -> PreflightFinding:
    estimator = s.health.estimator
    placed = estimator is not None and estimator.flags & _POSITION
    if placed and s.settings.health.gps_fix is None:
        return warned(f"{why}, but the estimator has a position", "check that it means to")
    todo = "wait under open sky; to fly by optical flow or another source set health.gps_fix: null"
    return failed(why, todo)


@AUTOPILOT.check(
    "estimator",
    "attitude, velocity and position are estimated, no test ratio above 0.8; never above 1",
)
def _estimator(s: Snapshot) -> PreflightFinding:
    report = s.health.estimator
    if report is None or s.now_s - report.time_s > _STALE_S:
        return unknown("the estimator's report does not come")
    lacking = [name for bit, name in _ESTIMATES.items() if not report.flags & bit]
    lacking += [] if report.flags & _POSITION and not report.flags & _CONSTANT else ["position"]
    if lacking:
        return failed(f"no {', no '.join(lacking)}", "wait for GPS and for the estimator to settle")
    if report.gps_glitch:
        return failed("it sees GPS jump", "move away from walls and interference")
    worst, ratio = max(report.ratios.items(), key=lambda item: item[1])
    text = f"worst test ratio {ratio:.2f} ({worst})"
    if ratio >= _REJECTED:
        return failed(f"{text}: rejected", "calibrate that sensor, move away from metal, wait")
    return warned(text, "calibrate that sensor, or wait") if ratio > _DOUBTFUL else passed(text)


@AUTOPILOT.check("position", "a local position that is fresh, inside the fence")
def _position(s: Snapshot) -> PreflightFinding:
    age_s = s.vehicle.position_age_s(s.now_s)
    if s.vehicle.position is None:
        return failed("LOCAL_POSITION_NED does not come", "the estimator has no position yet: wait")
    if age_s > s.settings.supervisor.telemetry_timeout_s:
        return failed(
            f"{age_s:.1f} s old", "the estimator has lost its position, or the link is slow"
        )
    height = f"{s.vehicle.position.height_m:z.1f} m above home"
    if Envelope(s.settings.envelope).is_outside(FlightContext.of(s.vehicle, s.now_s)):
        north_m, east_m = s.vehicle.position.from_home_m
        return failed(
            f"{height}, outside the fence: {north_m:z.0f} m north and {east_m:z.0f} m east of home",
            "check envelope.fence_m, or fence_deg: latitude comes first",
        )
    return passed(height)


@AUTOPILOT.check("mode", "not OFFBOARD or GUIDED yet: following begins when the pilot says so")
def _mode(s: Snapshot) -> PreflightFinding:
    where = {None: "", True: ", on the ground", False: ", in the air"}[s.vehicle.landed]
    armed = "armed" if s.vehicle.armed else "disarmed"
    text = f"{s.vehicle.mode or 'mode unknown'}, {armed}{where}"
    if s.settings.autonomy == "full" or not s.vehicle.obeys_setpoints:
        return passed(text)
    todo = f"leave {s.vehicle.mode}; go back into it when following is to begin"
    return failed(text, todo) if s.vehicle.armed else warned(text, todo)


@AUTOPILOT.check(
    "landed-state",
    "EXTENDED_SYS_STATE says whether it stands on the ground",
    needed=False,
)
def _landed_state(s: Snapshot) -> PreflightFinding:
    if s.vehicle.landed is None:
        return warned(
            "the autopilot does not say whether it is on the ground",
            "be in the air before taking OFFBOARD or GUIDED: following may begin at once",
        )
    return passed("on the ground" if s.vehicle.landed else "in the air")


@AUTOPILOT.check(
    "consent",
    "with consent.kind rc the switch's channel is heard, and the switch is off",
)
def _consent(s: Snapshot) -> PreflightFinding:
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


@AUTOPILOT.check("sticks", "RC_CHANNELS come, if the settings have sticks nudge or take over")
def _sticks(s: Snapshot) -> PreflightFinding:
    wanted = s.settings.sticks
    if not wanted.nudge and wanted.takeover is None:
        return passed("the settings give them no effect")
    rc = s.vehicle.fresh_rc(s.now_s, _RC_FRESH_S)
    if rc is not None and all(rc.pulse_us(channel) is not None for channel in wanted.channels):
        return passed("heard")
    todo = "switch on the transmitter, and have the autopilot send RC_CHANNELS"
    if wanted.nudge:
        return failed("RC_CHANNELS do not come, and sticks.nudge is set", todo)
    return warned("RC_CHANNELS do not come: a stick moved far will not take over", todo)


def _named(mask: int, names: dict[int, str]) -> str:
    return ", ".join(name for bit, name in names.items() if mask & bit)
