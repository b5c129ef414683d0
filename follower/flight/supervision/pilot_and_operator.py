"""What the operator and the pilot want, from step to step: consent, sticks, stop, mode.

See docs/reference/supervisor.md for what renews consent after a release.
"""

import math
from collections import deque

from follower.flight.supervision.inputs import ConsentRequest, SupervisorInputs
from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.supervisor import ConsentSettings, Stick, StickSettings
from follower.settings.ui import CockpitSettings
from follower_control.servo.output_blend import NO_OFFSET, StickOffset
from follower_control.vehicle.state import RcChannels, VehicleState

_HYSTERESIS_US = 50
_FRESH_S = 0.5
_STRONGEST_FIRST = (ConsentRequest.WITHDRAW, ConsentRequest.GIVE, ConsentRequest.RENEW)
"""Of several orders in one step: a withdrawal is not overruled by what came with it, and who
chooses a target in the same step does not make consent unsaid."""


class Consent:
    """Follows orders, the switch and the pilot's mode from step to step.

    A release takes consent back: an order has to be given again, a switch has to be turned off
    and on again. A switch that is on from the start does not count either.

    Attributes:
        given: the second consent stands; always so for "mode" unless it was withdrawn.
        withdrawn: an operator took it back; then it has to be given, and nothing else renews it.
        renewed: it was given anew with this step.
        turned_on: that was by the switch.
    """

    def __init__(self, settings: ConsentSettings) -> None:
        self._settings = settings
        self._switch = _Switch(settings)
        self._own_mode_since_s: float | None = None
        self._released = False
        self.given = self._needs_nothing
        self.renewed = self.turned_on = self.withdrawn = False

    def step(
        self, order: ConsentRequest, vehicle: VehicleState, state: SupervisorState, now_s: float
    ) -> None:
        """Take what came since the last step.

        Args:
            order: the operator's.
            vehicle: newest telemetry.
            state: the supervisor's, before it decides.
            now_s: time of this step.
        """
        if state is SupervisorState.RELEASED and not self._released:
            self._revoke()
        self._released = state is SupervisorState.RELEASED
        if order in (ConsentRequest.GIVE, ConsentRequest.WITHDRAW):
            self.withdrawn = order is ConsentRequest.WITHDRAW
        self.renewed = order is ConsentRequest.GIVE or (
            order is ConsentRequest.RENEW and not self.withdrawn
        )
        if self._settings.kind == "rc":
            self._take_switch(vehicle, now_s)
        elif order is ConsentRequest.GIVE:
            self.given = True
        if order is ConsentRequest.WITHDRAW:
            self._revoke()
        if self._is_pilots_own(vehicle, now_s) and self._released:
            self.renewed = self.renewed or not self.withdrawn
        self.given = self.given or (self.renewed and self._needs_nothing)

    @property
    def _needs_nothing(self) -> bool:
        return self._settings.kind == "mode"

    def _revoke(self) -> None:
        self.given = self._needs_nothing and not self.withdrawn
        self._switch.must_be_turned()
        self._own_mode_since_s = None

    def _take_switch(self, vehicle: VehicleState, now_s: float) -> None:
        before, self.given = self.given, self._switch.is_on(vehicle, now_s)
        self.turned_on = self.given and not before
        self.withdrawn = self.withdrawn and not self.turned_on
        self.renewed = self.renewed or self.turned_on

    def _is_pilots_own(self, vehicle: VehicleState, now_s: float) -> bool:
        """Whether the pilot's own mode has stood long enough.

        Without a failsafe PX4's mode is the one that somebody chose: while that is another one
        than OFFBOARD, it cannot come back into OFFBOARD by itself.
        """
        if vehicle.obeys_setpoints or vehicle.failsafe or self._settings.again != "mode":
            self._own_mode_since_s = None
            return False
        if self._own_mode_since_s is None:
            self._own_mode_since_s = now_s
        stood_s = now_s - self._own_mode_since_s
        return self._needs_nothing and stood_s >= self._settings.own_mode_s


class _Switch:
    """A switch of the transmitter that counts from when it was last seen off."""

    def __init__(self, settings: ConsentSettings) -> None:
        self._settings = settings
        self._seen_off = False
        self._on = False

    def must_be_turned(self) -> None:
        """Count it as off until it was turned off and on again."""
        self._seen_off = False

    def is_on(self, vehicle: VehicleState, now_s: float) -> bool:
        """Return whether it stands on, and was turned on."""
        s = self._settings
        rc = vehicle.fresh_rc(now_s, s.rc_timeout_s)
        pulse = None if rc is None else rc.pulse_us(s.rc_channel)
        if pulse is None:
            self._seen_off = self._on = False
            return False
        above = pulse - s.rc_threshold_us
        beyond = -above if s.rc_reversed else above
        self._on = beyond >= (-_HYSTERESIS_US if self._on else 0)
        self._seen_off = self._seen_off or not self._on
        return self._on and self._seen_off


class CockpitWatch:
    """Watches whether the page in control is there, from step to step.

    Args:
        settings: whether its loss matters, and after how long.
    """

    def __init__(self, settings: CockpitSettings) -> None:
        self._matters = settings.when_lost == "hold"
        self._lost_s = settings.lost_s
        self._seen = False
        self._seen_s: float | None = None

    def note(self) -> None:
        """Note that it is there; may be called from any thread."""
        self._seen = True

    def is_lost(self, now_s: float) -> bool:
        """Return whether it is missed; a page that never came is."""
        if self._seen:
            self._seen = False
            self._seen_s = now_s
        silent = self._seen_s is None or now_s - self._seen_s > self._lost_s
        return self._matters and silent


class Sticks:
    """Reads the sticks from step to step.

    They count from when roll, pitch and yaw were first seen in their middle while we follow: a
    pilot who flies and then turns the mode switch may still hold one. The throttle's middle is
    where it stands then, because not every throttle springs back. While channels do not
    come nothing is shifted; who took over keeps it until roll, pitch and yaw are back in their
    middle, whoever wants to follow again.

    Attributes:
        nudge: by how much to shift what is wanted.
        taken_over: whether the pilot wants the vehicle back.
    """

    def __init__(self, settings: StickSettings) -> None:
        self._settings = settings
        self._middle: float | None = None
        self.nudge, self.taken_over = NO_OFFSET, False

    def step(self, vehicle: VehicleState, engaged: bool, now_s: float) -> None:
        """Take the newest channels; while we do not fly only a stick that took over counts."""
        self.nudge = NO_OFFSET
        if not engaged:
            self._middle = None
        rc = vehicle.fresh_rc(now_s, _FRESH_S)
        roll, pitch, yaw = (self._deflection(rc, stick) for stick in ("roll", "pitch", "yaw"))
        throttle = self._deflection(rc, "throttle")
        if roll is None or pitch is None or yaw is None or throttle is None:
            return
        most = max(map(abs, (roll, pitch, yaw)))
        if most <= self._settings.deadband:
            self.taken_over = False
            if engaged and self._middle is None:
                self._middle = throttle
        if self._middle is not None:
            self._take(roll, pitch, yaw, throttle - self._middle)

    def _take(self, roll: float, pitch: float, yaw: float, throttle: float) -> None:
        s = self._settings
        most = max(map(abs, (roll, pitch, yaw)))
        self.taken_over = self.taken_over or (s.takeover is not None and most >= s.takeover)
        if s.nudge:
            self.nudge = StickOffset(
                distance_m=-s.max_distance_m * self._beyond(pitch),
                elevation_rad=-math.radians(s.max_elevation_deg) * self._beyond(throttle),
                azimuth_rad=-math.radians(s.max_bearing_deg) * self._beyond(yaw),
                side_m_s=s.max_side_m_s * self._beyond(roll),
            )

    def _beyond(self, deflection: float) -> float:
        """Return what lies beyond the deadband, stretched to 1 again."""
        band = self._settings.deadband
        share = min(max(abs(deflection) - band, 0.0) / (1 - band), 1.0)
        return math.copysign(share, deflection)

    def _deflection(self, rc: RcChannels | None, stick: Stick) -> float | None:
        s = self._settings
        pulse = None if rc is None else rc.pulse_us(getattr(s, f"{stick}_channel"))
        if pulse is None:
            return None
        share = (pulse - s.centre_us) / s.throw_us
        return min(max(-share if stick in s.reversed else share, -1.0), 1.0)


class PilotOperatorInput:
    """Orders, stop, consent, sticks and the pilot's mode, for the supervisor to decide by.

    Args:
        consent: what counts as the second consent.
        sticks: what the pilot's sticks do.
        cockpit: how long a page in control may be missed.
        autonomous: the program chooses the mode itself.

    Attributes:
        stop_requested: somebody wants the vehicle released; until consent is given or renewed.
        stop_at_once: they pressed a button for it.
        order: what was ordered for the last step.
        consent: whether the second consent stands, and was given anew with this step.
        sticks: whether the pilot takes over, and by how much he shifts what is wanted.
        cockpit: knows when the page in control was last there.
        cockpit_lost: it is missed.
    """

    def __init__(
        self,
        consent: ConsentSettings,
        sticks: StickSettings,
        cockpit: CockpitSettings | None = None,
        autonomous: bool = False,
    ) -> None:
        self._autonomous = autonomous
        self.consent = Consent(consent)
        self.sticks = Sticks(sticks)
        self._orders: deque[ConsentRequest] = deque()
        self._entry = 0
        self.stop_requested = self.stop_at_once = False
        self.order = ConsentRequest.NONE
        self._just_stopped = self._stop_asked = False
        self.cockpit = CockpitWatch(cockpit or CockpitSettings())
        self.cockpit_lost = False
        self._cockpit_was_lost: bool | None = None

    def give(self, order: ConsentRequest) -> None:
        """Take an order for the next step; may be called from any thread."""
        self._orders.append(order)

    def ask_to_stop(self) -> None:
        """Release the vehicle with the next step; may be called from any thread."""
        self._stop_asked = True

    def press_stop(self) -> None:
        """Take the stop button."""
        self.stop_requested = self.stop_at_once = self._just_stopped = True

    def choose(self) -> None:
        """Note that the operator chose a target.

        That renews consent, unless stop was pressed or consent withdrawn: then it has to be given.
        """
        if not (self.stop_requested or self.consent.withdrawn):
            self.give(ConsentRequest.RENEW)

    def repeat(self, recorded: SupervisorInputs) -> None:
        """Take what was ordered in a recorded situation."""
        self.stop_requested = self._just_stopped = recorded.stop_requested
        self.stop_at_once = recorded.stop_at_once
        self._orders.append(recorded.order)
        self._cockpit_was_lost = recorded.cockpit_lost

    def step(self, vehicle: VehicleState, state: SupervisorState, now_s: float) -> None:
        """Take what came since the last step; `state` is the supervisor's before it decides."""
        if self._stop_asked:
            self._stop_asked = False
            self.stop_requested = self._just_stopped = True
        orders = [self._orders.popleft() for _ in range(len(self._orders))]
        self.order = next((one for one in _STRONGEST_FIRST if one in orders), ConsentRequest.NONE)
        self.consent.step(self.order, vehicle, state, now_s)
        renews = self.order in (ConsentRequest.RENEW, ConsentRequest.GIVE)
        begins_anew = renews or self.consent.turned_on
        if begins_anew and not self._just_stopped:  # a stop outdoes what came in the same step
            self.stop_requested = self.stop_at_once = False
        self._just_stopped = False
        self.sticks.step(vehicle, state.engaged, now_s)
        is_missed, recorded = self.cockpit.is_lost(now_s), self._cockpit_was_lost
        self.cockpit_lost = is_missed if recorded is None else recorded

    def begin(self, vehicle: VehicleState) -> None:
        """Note that following begins, by this entry into the mode."""
        self._entry = vehicle.entries

    def mode_allows(self, vehicle: VehicleState, state: SupervisorState) -> bool:
        """Whether somebody chose our mode and it was not left since following began.

        It may have been left and entered again between two steps. With `autonomy: full` the mode
        is ours to choose.
        """
        left = state.engaged and vehicle.entries != self._entry
        chosen = self._autonomous or not vehicle.entered_by_itself
        return vehicle.obeys_setpoints and chosen and not left
