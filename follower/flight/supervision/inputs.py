"""What the supervisor decides by."""

from dataclasses import dataclass
from enum import StrEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.vehicle_health import EstimatorHealth, VehicleHealth
from follower.settings.supervisor import HealthSettings


class ConsentRequest(StrEnum):
    """What an operator asked for since the last step."""

    NONE = "none"
    RENEW = "renew"
    """Begin again after a release: a target was chosen anew."""
    GIVE = "give"
    """Consent, and begin again after a release."""
    WITHDRAW = "withdraw"
    """Consent no longer."""


@dataclass(frozen=True, slots=True)
class SupervisorInputs:
    """All that a decision depends on. Ages and durations in seconds; never-seen is infinite.

    Attributes:
        target_chosen: somebody selected a target and has not dropped it.
        unseen_s: 0 while the newest frame shows the target, else the time since one did.
        estimate_good: the estimator stands by its estimate.
        heartbeat_age_s: since the autopilot's last heartbeat.
        telemetry_age_s: age of the older one of attitude and position; an attitude that only
            repeats itself grows old, and so does a position that stays the same while the vehicle
            is sent away.
        frame_age_s: since the capture of the newest frame that vision answered for.
        control_gap_s: since the previous control step.
        mode_allows: the autopilot is in the mode that flies setpoints, because somebody chose it
            and nobody left it since following began.
        flying: armed and not landed.
        stop_requested: the operator pressed stop.
        consent_renewed: after a release, the operator chose a target or consented anew.
        in_state_s: since the present state was entered.
        consent_given: the second consent stands; always so where none is asked for.
        failsafe: the autopilot says that it is in a failsafe.
        sticks_moved: a stick is so far out that the pilot wants the vehicle back.
        mode_left: the autopilot has just left the mode that somebody chose, and flew by our stream
            in it.
        stream_held: it flew by our stream in that mode in the last step.
        answer_age_s: how long the autopilot has not answered us, though it may talk.
        battery_low: less is left of the battery than is asked, now or to begin.
        navigation_poor: the autopilot does not know well where it is.
        stop_at_once: the operator pressed it as a button: zero is sent with the next step, without
            the envelope's gentler way there.
        cockpit_lost: the page that has to be there while following is not.
        order: what the operator asked for; the consents above follow from it and from telemetry.
    """

    target_chosen: bool
    unseen_s: float
    estimate_good: bool
    heartbeat_age_s: float
    telemetry_age_s: float
    frame_age_s: float
    control_gap_s: float
    mode_allows: bool
    flying: bool
    stop_requested: bool
    consent_renewed: bool
    in_state_s: float
    consent_given: bool = True
    failsafe: bool = False
    sticks_moved: bool = False
    mode_left: bool = False
    answer_age_s: float = 0.0
    order: ConsentRequest = ConsentRequest.NONE
    battery_low: bool = False
    navigation_poor: bool = False
    stop_at_once: bool = False
    cockpit_lost: bool = False
    stream_held: bool = False


_NEEDED = mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_VELOCITY_HORIZ
_PLACED = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
"""These bits are the same in ESTIMATOR_STATUS and EKF_STATUS_REPORT."""


@dataclass(frozen=True, slots=True)
class HealthVerdict:
    """What the vehicle's health allows.

    Attributes:
        battery_low: too little is left.
        navigation_poor: the autopilot does not know well where it is, or how it moves.
    """

    battery_low: bool = False
    navigation_poor: bool = False


def judge(
    health: VehicleHealth, settings: HealthSettings, engaged: bool, now_s: float
) -> HealthVerdict:
    """Return the verdict; what was never reported, or long ago, is no objection. Pure.

    Args:
        health: what the vehicle reported.
        settings: what is asked.
        engaged: whether following has begun; less battery is enough to go on.
        now_s: the present, in seconds.
    """
    sensors, gps, estimator = health.sensors, health.gps, health.estimator
    least = settings.battery_to_go_on if engaged else settings.battery_to_start
    low = False
    if sensors is not None and now_s - sensors.time_s <= settings.stale_s:
        low = sensors.battery_share is not None and sensors.battery_share < least
    poor = False
    if gps is not None and now_s - gps.time_s <= settings.stale_s:
        poor = settings.gps_fix is not None and gps.fix_type < settings.gps_fix
    if estimator is not None and now_s - estimator.time_s <= settings.stale_s:
        poor = poor or _is_poor(estimator, settings.largest_ratio)
    return HealthVerdict(low, poor)


def _is_poor(estimator: EstimatorHealth, largest_ratio: float) -> bool:
    flags = estimator.flags
    knows = flags & _NEEDED == _NEEDED and bool(flags & _PLACED)
    lost = bool(flags & mavlink.ESTIMATOR_CONST_POS_MODE) or estimator.gps_glitch
    ratio = max(estimator.velocity_ratio, estimator.horizontal_ratio)
    return not knows or lost or not ratio <= largest_ratio
