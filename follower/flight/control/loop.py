"""The link and the control stage together: what the control thread does fifty times a second."""

import math
from collections.abc import Callable

from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower.flight.supervision.autonomy import Autonomy
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.release import Release
from follower.flight.supervision.setpoint_stream import NEEDS_STREAM
from follower.flight.supervision.supervisor import SupervisorState
from follower.links.link import Link
from follower.links.operator_commands import CONSENT_COMMAND, OperatorCommand
from follower_control.vehicle.setpoint import HOLD
from follower_vision.clock import Clock

_ORDERS = {1.0: ConsentRequest.GIVE, 0.0: ConsentRequest.WITHDRAW}
OnStep = Callable[[ControlRecord], None]


class ControlLoop:
    """Polls the link, steps the control stage, sends what may be sent.

    Args:
        link: to the autopilot.
        stage: decides.
        newest: returns vision's newest answer, None before the first.
        log: where the autopilot's words go.
        autonomy: plays the pilot in the simulator; None leaves that to the pilot.
        on_step: is shown every step, for displays and the score.
        clock: measures how long a step took; None takes it that none takes long.

    Attributes:
        rests: the last step let the vehicle stand, or left it to somebody else.
    """

    def __init__(
        self,
        link: Link,
        stage: ControlStage,
        newest: Callable[[], TrackRecord | None],
        log: FlightLog,
        autonomy: Autonomy | None = None,
        on_step: OnStep | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._link = link
        self._stage = stage
        self._newest = newest
        self._log = log
        self._autonomy = autonomy
        self._on_step = on_step
        self._clock = clock
        self._release = Release(stage.settings.release)
        self._before = SupervisorState.IDLE
        self._stepped_s = math.inf
        self._streams = False
        self.rests = True
        link.watch_health()
        if stage.settings.gimbal.enabled:
            link.use_gimbal(stage.settings.gimbal.device)

    def step(self, now_s: float, late_s: float = 0.0) -> None:
        """Do one step of control at `now_s`, begun `late_s` late, both in seconds."""
        self._link.poll(now_s)
        for note in self._link.take_notes():
            self._log.note(now_s, "autopilot", note)
        for command in self._link.take_commands():
            self._obey(command, now_s)
        record = self._stage.step(
            now_s,
            self._newest(),
            self._link.state,
            self._link.attitudes,
            late_s,
            self._link.health,
        )
        self._send(record)
        if record.gimbal is not None:
            self._link.turn_gimbal(record.gimbal)
        self._ask_for_release_mode(record)
        if self._autonomy is not None and not self._release.acts:
            self._fly(self._autonomy, now_s, record.state)
        if self._on_step is not None:
            self._on_step(record)

    def release(self) -> None:
        """Brake and release the vehicle, in the coming steps; from any thread."""
        self._stage.request_stop()

    def hold(self) -> bool:
        """Send one hold: the last word of a program that ends while the vehicle is in its hands.

        It is not once it was handed back, although the autopilot may still be in the same mode, nor
        once control has stood still for so long that PX4 may be in its failsafe.

        Returns:
            Whether it was sent.
        """
        vehicle = self._link.state
        held = self._before.engaged or (self._streams and vehicle.obeys_setpoints)
        held = held and not (
            vehicle.mode == NEEDS_STREAM and self._stood_still_since(self._stepped_s)
        )
        if held:
            self._link.send(HOLD)
        return held

    def _send(self, record: ControlRecord) -> None:
        before, self._before, self._streams = self._before, record.state, record.sent
        self._stepped_s = record.time_s
        self.rests = not record.state.engaged and (not record.sent or record.allowed == HOLD)
        released = record.state is SupervisorState.RELEASED
        if self._stood_still_since(record.time_s):
            self._log.note(record.time_s, "control", "the step took too long: nothing was sent")
        elif record.sent:
            self._link.send(record.allowed)
        elif released and before.streams and not self._may_call_back:
            # The autopilot may keep our last velocity and fly it when the pilot comes back.
            self._link.send(HOLD)

    def _stood_still_since(self, time_s: float) -> bool:
        """Whether so much time has passed that the autopilot may fly by itself meanwhile."""
        alone_s = self._stage.settings.supervisor.alone_s
        return self._clock is not None and self._clock.now() - time_s >= alone_s

    @property
    def _may_call_back(self) -> bool:
        """Whether the autopilot flies by itself, or may: a stream calls PX4 back into OFFBOARD."""
        return self._link.state.failsafe or self._stage.may_call_back(self._link.state)

    def _obey(self, command: OperatorCommand, now_s: float) -> None:
        """Take an operator's consent or its withdrawal, and answer."""
        order = _ORDERS.get(command.value) if command.command == CONSENT_COMMAND else None
        consent = self._stage.settings.consent
        welcome = consent.takes_orders_by("command") and command.system == consent.command_system
        accepted = order is ConsentRequest.WITHDRAW or (order is ConsentRequest.GIVE and welcome)
        self._link.answer(command, accepted)
        if order is not None and command.is_new:
            verdict = "" if accepted else ", refused"
            self._log.note(now_s, "operator", f"consent: {order} by {command.system}{verdict}")
        if order is not None and accepted and command.is_new:
            self._stage.order(order)

    def _ask_for_release_mode(self, record: ControlRecord) -> None:
        """Have the autopilot take its own mode after a release, if that is wanted."""
        vehicle, name = self._link.state, self._link.autopilot_name
        mode = self._release.step(record.time_s, record.state, record.reason, vehicle, name)
        for note in self._release.take_notes():
            self._log.note(record.time_s, "release", note)
        if mode is not None:
            self._link.enter_mode(mode)

    def _fly(self, autonomy: Autonomy, now_s: float, state: SupervisorState) -> None:
        before = autonomy.phase
        autonomy.step(now_s, state)
        if autonomy.phase is not before:
            self._log.note(now_s, "autonomy", str(autonomy.phase))
