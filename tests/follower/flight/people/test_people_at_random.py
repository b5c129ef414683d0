"""Everybody does everything: it is replayed bit for bit, and nobody is followed without consent."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from people_flights import CONTROL_S, OURS, PILOTS, SHORT, C, F, H, R, S

from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import FlightConfig, Recorder, open_flight
from follower_control.vehicle.setpoint import HOLD

MIDDLE = (1500, 1500, 1500, 1500)


@pytest.mark.slow
def test_a_flight_with_switch_sticks_orders_and_a_search_is_replayed_bit_for_bit(
    rig_of: Any,
    tmp_path: Path,
) -> None:
    rig = rig_of("px4", "consent.kind=rc", "consent.rc_channel=5", "sticks.nudge=true", *SHORT)
    config = FlightConfig.of("simulated", rig.settings, camera=rig.camera)
    recorder = Recorder(tmp_path, config, rig.clock, rig.settings.recorder, threaded=False)
    with recorder:
        rig.begin(recorder.log)
        rig.autopilot.move_sticks(*MIDDLE, 1000)
        rig.take_mode()
        rig.autopilot.move_sticks(*MIDDLE, 2000)
        rig.until(F)
        rig.right_px = 40.0
        rig.fly(0.5)
        rig.autopilot.move_sticks(1650, 1400, 1600, 1400, 2000)
        rig.fly(0.5)
        rig.stage.order(ConsentRequest.WITHDRAW)
        rig.until(R)
        rig.autopilot.move_sticks(*MIDDLE, 1000)
        rig.fly(0.3)
        rig.autopilot.move_sticks(*MIDDLE, 2000)
        rig.until(F)
        rig.seen = False
        for state in (C, S, H, R):
            rig.until(state)
        rig.stage.request_stop()
        rig.fly(0.2)
    flight = open_flight(tmp_path)
    # There are no pictures: control has the recorded tracks.
    replay = Replay(flight, replay_settings(flight), tracks_recorded=True)
    replay.run()
    assert len(flight.log.controls) == len(rig.log.controls)
    assert compare(flight.log, replay.log).identical
    unsteered = Replay(
        flight, replay_settings(flight, ["sticks.nudge=false"]), tracks_recorded=True
    )
    assert not compare(flight.log, unsteered.run()).identical


class Chance:
    """A pilot, an operator, a target and a link that do anything at any time."""

    def __init__(self, rig: Any, seed: int) -> None:
        self._rig = rig
        self._lots = np.random.default_rng(seed)
        self.renewals: list[float] = []
        self.left: list[float] = []

    def act(self) -> None:
        rig, lots = self._rig, self._lots
        acts = [self._take_mode] * 4 + [self._leave_mode, self._order, self._order, self._sticks]
        acts += [self._see, self._see, self._frames, self._link, self._command]
        acts[lots.integers(len(acts))]()
        rig.fly(float(lots.exponential(0.7)) + CONTROL_S)

    def calm_down(self) -> None:
        self._rig.seen = self._rig.frames_come = True
        self._rig.wire.cut = False

    def _take_mode(self) -> None:
        self.calm_down()
        self._rig.fly(1.0)
        self._rig.autopilot.switch_mode(OURS[self._rig.flavour])
        self._rig.fly(1.5)

    def _leave_mode(self) -> None:
        if self._rig.autopilot.mode == OURS[self._rig.flavour] and not self._rig.wire.cut:
            self.left.append(self._rig.now_s)
        self._rig.autopilot.switch_mode(PILOTS[self._rig.flavour])
        self._rig.fly(0.5)

    def _order(self) -> None:
        order = (ConsentRequest.RENEW, ConsentRequest.GIVE, ConsentRequest.WITHDRAW)[
            self._lots.integers(3)
        ]
        if order is not ConsentRequest.WITHDRAW:
            self.renewals.append(self._rig.now_s)
        self._rig.stage.order(order)

    def _command(self) -> None:
        value = float(self._lots.integers(2))
        if value:
            self.renewals.append(self._rig.now_s)
        self._rig.command(value)

    def _sticks(self) -> None:
        self._rig.autopilot.move_sticks(*self._lots.integers(1000, 2001, 4).tolist())
        self._rig.fly(0.3)
        self._rig.autopilot.move_sticks(*MIDDLE)

    def _see(self) -> None:
        self._rig.seen = bool(self._lots.random() < 0.6)
        self._rig.right_px = float(self._lots.uniform(-150, 150))

    def _frames(self) -> None:
        self._rig.frames_come = bool(self._lots.random() < 0.7)

    def _link(self) -> None:
        self._rig.wire.cut = True
        self._rig.fly(float(self._lots.exponential(1.0)))
        self._rig.wire.cut = False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "kind", "seed"), [("px4", "mode", 7), ("ardupilot", "command", 7)]
)
def test_whatever_people_do_nobody_is_followed_without_consent_and_mode(
    rig_of: Any, flavour: str, kind: str, seed: int
) -> None:
    rig = rig_of(flavour, f"consent.kind={kind}", "sticks.nudge=true", *SHORT)
    rig.autopilot.move_sticks(*MIDDLE)
    chance = Chance(rig, seed)
    while rig.now_s < 60.0:
        chance.act()
    controls = rig.log.controls
    states = [record.state for record in controls]
    begun = [i for i in range(1, len(states)) if states[i].engaged and not states[i - 1].engaged]
    assert begun
    released_s = -1.0
    for before, record in pairwise(controls):
        if record.state is R and before.state is not R:
            released_s = record.time_s
        if before.state is R and record.state is not R:
            assert any(released_s - 0.1 <= at <= record.time_s for at in chance.renewals)
        if record.state.engaged:
            assert record.vehicle.obeys_setpoints
            assert record.vehicle.armed
        if record.sent and not record.vehicle.obeys_setpoints:
            assert record.state is SupervisorState.READY  # for PX4, which wants a stream first
            assert record.allowed == HOLD
    for left_s in chance.left:
        after = next(record for record in controls if record.time_s > left_s + 0.1)
        assert after.state in (
            R,
            SupervisorState.READY,
            SupervisorState.TRACKING,
            SupervisorState.IDLE,
        )
        if after.state is R:
            assert not after.sent
