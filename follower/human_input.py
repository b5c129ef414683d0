"""What the operator and the pilot want, from step to step."""

from __future__ import annotations

from collections import deque

from follower.cockpit.settings import CockpitSettings
from follower.cockpit_watch import CockpitWatch
from follower.consent import Consent, ConsentSettings
from follower.situation import Order, Situation
from follower.sticks import Sticks, StickSettings
from follower.supervisor import State
from follower_control.nudge import Nudge
from follower_control.vehicle import VehicleState

_STRONGEST_FIRST = (Order.WITHDRAW, Order.GIVE, Order.RENEW)
"""Of several orders in one step: a withdrawal is not overruled by what came with it, and who
chooses a target in the same moment does not make consent unsaid."""


class HumanInput:
    """Orders, stop, consent, sticks and the pilot's mode, for the supervisor to decide by.

    Args:
        consent: what counts as the second consent.
        sticks: what the pilot's sticks do.
        cockpit: how long a page in control may be missed.
        autonomous: the program chooses the mode itself.

    Attributes:
        stop_requested: somebody wants us to let go; until consent is given or renewed.
        stop_at_once: they pressed a button for it.
        order: what was ordered for the last step.
        cockpit: hears the page in control.
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
        self._consent = Consent(consent)
        self._sticks = Sticks(sticks)
        self._orders: deque[Order] = deque()
        self._entry = 0
        self.stop_requested = self.stop_at_once = False
        self.order = Order.NONE
        self._just_stopped = self._stop_asked = False
        self.cockpit = CockpitWatch(cockpit or CockpitSettings())
        self.cockpit_lost = False
        self._cockpit_was_lost: bool | None = None

    @property
    def consent_given(self) -> bool:
        """Whether the second consent stands."""
        return self._consent.given

    @property
    def consent_renewed(self) -> bool:
        """Whether it was given anew with this step."""
        return self._consent.renewed

    @property
    def sticks_moved(self) -> bool:
        """Whether the pilot wants the vehicle back."""
        return self._sticks.taken_over

    @property
    def nudge(self) -> Nudge:
        """By how much the pilot shifts what is wanted."""
        return self._sticks.nudge

    def give(self, order: Order) -> None:
        """Take an order for the next step; may be called from any thread."""
        self._orders.append(order)

    def ask_to_stop(self) -> None:
        """Let go with the next step; may be called from any thread."""
        self._stop_asked = True

    def press_stop(self) -> None:
        """Take the stop button."""
        self.stop_requested = self.stop_at_once = self._just_stopped = True

    def choose(self) -> None:
        """Note that the operator chose a target.

        That renews consent, unless stop was pressed or consent withdrawn: then it has to be given.
        """
        if not (self.stop_requested or self._consent.withdrawn):
            self.give(Order.RENEW)

    def repeat(self, recorded: Situation) -> None:
        """Take what was ordered in a recorded situation."""
        self.stop_requested = self._just_stopped = recorded.stop_requested
        self.stop_at_once = recorded.stop_at_once
        self._orders.append(recorded.order)
        self._cockpit_was_lost = recorded.cockpit_lost

    def step(self, vehicle: VehicleState, state: State, now_s: float) -> None:
        """Take what came since the last step; `state` is the supervisor's before it decides."""
        if self._stop_asked:
            self._stop_asked = False
            self.stop_requested = self._just_stopped = True
        orders = [self._orders.popleft() for _ in range(len(self._orders))]
        self.order = next((one for one in _STRONGEST_FIRST if one in orders), Order.NONE)
        self._consent.step(self.order, vehicle, state, now_s)
        begins_anew = self.order in (Order.RENEW, Order.GIVE) or self._consent.turned_on
        if begins_anew and not self._just_stopped:  # a stop outdoes what came in the same moment
            self.stop_requested = self.stop_at_once = False
        self._just_stopped = False
        self._sticks.step(vehicle, state.engaged, now_s)
        heard_none, recorded = self.cockpit.is_lost(now_s), self._cockpit_was_lost
        self.cockpit_lost = heard_none if recorded is None else recorded

    def begin(self, vehicle: VehicleState) -> None:
        """Note that following begins, by this entry into the mode."""
        self._entry = vehicle.entries

    def mode_allows(self, vehicle: VehicleState, state: State) -> bool:
        """Whether somebody chose our mode and it was not left since following began.

        It may have been left and entered again between two steps. With `autonomy: full` the mode
        is ours to choose.
        """
        left = state.engaged and vehicle.entries != self._entry
        chosen = self._autonomous or not vehicle.entered_by_itself
        return vehicle.obeys_setpoints and chosen and not left
