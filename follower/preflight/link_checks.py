"""Checks of the link: who is there, how fast, how late."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from follower.links.message_rates import MessageRate
from follower.preflight.finding import Finding, failed, passed, unknown, warned
from follower.preflight.snapshot import Snapshot

_HEARTBEAT_S = 3.0
_TESTED = {"px4": (1, 18), "ardupilot": (4, 6)}
_OLDEST = {"px4": (1, 14), "ardupilot": (4, 2)}
_COPTERS = {
    mavlink.MAV_TYPE_QUADROTOR: "quadrotor",
    mavlink.MAV_TYPE_HEXAROTOR: "hexarotor",
    mavlink.MAV_TYPE_OCTOROTOR: "octorotor",
    mavlink.MAV_TYPE_TRICOPTER: "tricopter",
    mavlink.MAV_TYPE_COAXIAL: "coaxial helicopter",
    mavlink.MAV_TYPE_HELICOPTER: "helicopter",
    mavlink.MAV_TYPE_DODECAROTOR: "dodecarotor",
    mavlink.MAV_TYPE_DECAROTOR: "decarotor",
}
_LATE_S, _TOO_LATE_S = 0.2, 0.5
_OFF_S, _TOO_OFF_S = 0.05, 0.15
_OLD_S = 0.15
_LOSS, _TOO_MUCH_LOSS = 0.02, 0.1
_LEAST_HZ = {"ATTITUDE": 10.0, "LOCAL_POSITION_NED": 5.0}


def vehicle(s: Snapshot) -> Finding:
    """One vehicle is found and alive."""
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


def vehicle_type(s: Snapshot) -> Finding:
    """It is a multicopter or a helicopter."""
    kind = s.health.vehicle_type
    if kind is None:
        return unknown("the vehicle has not said what it is")
    if kind in _COPTERS:
        return passed(_COPTERS[kind])
    entry = mavlink.enums["MAV_TYPE"].get(kind)
    return failed(
        f"{entry.name if entry else kind} cannot fly body velocities as a multicopter does",
        "fly a multicopter; a VTOL is not supported",
    )


def firmware(s: Snapshot) -> Finding:
    """The firmware is one whose behaviour is known."""
    version, kind = s.health.firmware, s.link.autopilot
    if version is None or kind not in _TESTED:
        return unknown("the autopilot has not told its version")
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


def attitude_rate(s: Snapshot) -> Finding:
    """ATTITUDE comes often enough."""
    return _rate(s, "ATTITUDE", "link.attitude_rate_hz")


def position_rate(s: Snapshot) -> Finding:
    """LOCAL_POSITION_NED comes often enough."""
    return _rate(s, "LOCAL_POSITION_NED", "link.position_rate_hz")


def _rate(s: Snapshot, name: str, setting: str) -> Finding:
    rate = next((rate for rate in s.link.rates if rate.name == name), None)
    if rate is None:
        return unknown(f"{name} was not counted")
    text = f"{rate.measured_hz:.0f} Hz, asked for {rate.wanted_hz:.0f}"
    if rate.is_enough:
        return passed(text)
    todo = f"a faster link, or fewer streams to other programs, or a lower {setting}"
    if rate.measured_hz >= _LEAST_HZ[name]:
        return warned(text, todo)
    return failed(_silence(rate) or text, todo)


def _silence(rate: MessageRate) -> str:
    return "" if rate.measured_hz else f"{rate.name} does not come at all"


def round_trip(s: Snapshot) -> Finding:
    """An answer of the autopilot comes soon."""
    seconds = s.link.round_trip_s
    if seconds is None:
        return unknown("TIMESYNC is not answered", "allow MAVLink 2 in both directions")
    text = f"{1e3 * seconds:.0f} ms there and back"
    if seconds <= _LATE_S:
        return passed(text)
    todo = "use a cable between companion and autopilot, or a faster baud rate"
    return warned(text, todo) if seconds <= _TOO_LATE_S else failed(text, todo)


def clocks(s: Snapshot) -> Finding:
    """The autopilot's times can be told on our clock."""
    error_s = s.link.clock_error_s
    if error_s is None:
        return unknown("the clocks were not compared", "TIMESYNC has to be answered")
    text = f"known to {1e3 * error_s:.0f} ms"
    if s.link.clock_restarts > 1:
        return warned(f"{text}; the autopilot's clock jumped", "wait until it has started")
    if error_s <= _OFF_S:
        return passed(text)
    todo = "a link with shorter and steadier delays"
    return warned(text, todo) if error_s <= _TOO_OFF_S else failed(text, todo)


def attitude_age(s: Snapshot) -> Finding:
    """The attitude that control uses is fresh and alive."""
    if s.attitude.repeats_itself:
        return failed(
            "the attitude repeats itself to the last bit",
            "the autopilot's estimator stands still: restart the autopilot",
        )
    age_s, limit_s = s.attitude.worst_age_s, s.settings.supervisor.telemetry_timeout_s
    if age_s == float("inf"):
        return failed("no attitude came", "look at the rates above")
    text = f"at most {1e3 * age_s:.0f} ms old, after TIMESYNC"
    if age_s <= _OLD_S:
        return passed(text)
    todo = "ask for a higher link.attitude_rate_hz, or use a faster link"
    return warned(text, todo) if age_s < limit_s else failed(text, todo)


def packet_loss(s: Snapshot) -> Finding:
    """Few packets are lost."""
    if not s.link.received:
        return unknown("no packets came")
    share = s.link.lost_share
    text = f"{share:.1%} of {s.link.received + s.link.lost} packets lost"
    if share <= _LOSS:
        return passed(text)
    todo = "a better antenna or a cable, a slower stream, or flow control on the serial port"
    return warned(text, todo) if share <= _TOO_MUCH_LOSS else failed(text, todo)
