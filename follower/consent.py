"""Whether the operator consents to following, beside the pilot's flight mode.

See docs/supervisor.md for what renews consent after letting go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

from follower.situation import Order
from follower.supervisor import State
from follower_control.vehicle import VehicleState

Way: TypeAlias = Literal["command", "terminal", "cockpit"]
"""How an operator gives orders."""

_HYSTERESIS_US = 50


@dataclass(frozen=True, slots=True)
class ConsentSettings:
    """What else than the pilot's mode is needed, and what gives it anew after letting go.

    Attributes:
        kind: "mode" needs the pilot's OFFBOARD or GUIDED alone; "command" a MAVLink command to us,
            "rc" a switch of the transmitter, "terminal" the Enter key, "cockpit" the web page's
            button, on top.
        again: for "mode": what begins anew after letting go. "operator": a target chosen anew or
            the Enter key alone. "mode": also the pilot, by staying in another mode for
            `own_mode_s`; after that zero setpoints are sent again, and taking the mode counts.
        own_mode_s: how long another mode has to stand, with no failsafe, to be the pilot's own.
        command_system: MAVLink system id from which the command is taken.
        rc_channel: of the switch, counted from 1.
        rc_threshold_us: pulse from which on the switch is on.
        rc_reversed: it is on below.
        rc_timeout_s: a switch that is not heard for so long is off.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    kind: Literal["mode", "command", "rc", "terminal", "cockpit"] = "mode"
    again: Literal["operator", "mode"] = "operator"
    own_mode_s: float = 2.0
    command_system: int = 255
    rc_channel: int = 7
    rc_threshold_us: int = 1700
    rc_reversed: bool = False
    rc_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.own_mode_s < 3600:
            raise ValueError(f"own_mode_s is a time in seconds above 0, not {self.own_mode_s}")
        if not 1 <= self.command_system <= 255:
            raise ValueError(f"command_system lies between 1 and 255, not {self.command_system}")
        if not 1 <= self.rc_channel <= 18:
            raise ValueError(f"rc_channel lies between 1 and 18, not {self.rc_channel}")
        if not 900 <= self.rc_threshold_us <= 2100:
            raise ValueError(f"rc_threshold_us is a pulse in µs, not {self.rc_threshold_us}")
        if not 0 < self.rc_timeout_s <= 10:
            raise ValueError(f"rc_timeout_s lies between 0 and 10 s, not {self.rc_timeout_s}")

    def takes_orders_by(self, way: Way) -> bool:
        """Whether consent can be given in this way; it can be withdrawn in any."""
        return self.kind in ("mode", way)


class Consent:
    """Follows orders, the switch and the pilot's mode from step to step.

    Letting go takes consent back: an order has to be given again, a switch has to be turned off
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

    def step(self, order: Order, vehicle: VehicleState, state: State, now_s: float) -> None:
        """Take what came since the last step.

        Args:
            order: the operator's.
            vehicle: newest telemetry.
            state: the supervisor's, before it decides.
            now_s: time of this step.
        """
        if state is State.RELEASED and not self._released:
            self._let_go()
        self._released = state is State.RELEASED
        if order in (Order.GIVE, Order.WITHDRAW):
            self.withdrawn = order is Order.WITHDRAW
        self.renewed = order is Order.GIVE or (order is Order.RENEW and not self.withdrawn)
        if self._settings.kind == "rc":
            self._take_switch(vehicle, now_s)
        elif order is Order.GIVE:
            self.given = True
        if order is Order.WITHDRAW:
            self._let_go()
        if self._is_pilots_own(vehicle, now_s) and self._released:
            self.renewed = self.renewed or not self.withdrawn
        self.given = self.given or (self.renewed and self._needs_nothing)

    @property
    def _needs_nothing(self) -> bool:
        return self._settings.kind == "mode"

    def _let_go(self) -> None:
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
