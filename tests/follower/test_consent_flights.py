"""Consent, nudges and letting go, flown in lockstep against both simulated autopilots.

No camera and no tracker: the target stands in the image where the test puts it.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.autonomy import Autonomy
from follower.control_loop import ControlLoop
from follower.control_stage import ControlStage
from follower.flightlog import ControlRecord, FlightLog, TrackRecord
from follower.links.mavlink import MavlinkLink
from follower.recorder import FlightConfig, Recorder, open_flight
from follower.replay import Replay, compare, replay_settings
from follower.settings import load_settings
from follower.situation import Order
from follower.supervisor import Reason, State
from follower_control.setpoint import HOLD
from follower_control.transport import MemoryTransport
from follower_sim.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.vehicle import STEP_S
from follower_vision.box import Box
from follower_vision.clock import SimulatedClock
from follower_vision.track import Track, TrackState

WIDTH, HEIGHT, CONTROL_S = 640, 480, 0.02
DISTANCE_M, SIZE_M = 15.0, 2.0
OURS = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}
PILOTS = {"px4": "POSCTL", "ardupilot": "LOITER"}
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
F, C, S, H, R = State.FOLLOWING, State.COASTING, State.SEARCHING, State.HOLDING, State.RELEASED

flavours = pytest.mark.parametrize("flavour", ["px4", "ardupilot"])


class Wire:
    """Notes what we send."""

    def __init__(self, inner: MemoryTransport, clock: SimulatedClock) -> None:
        self._inner = inner
        self._clock = clock
        self.sent: list[tuple[float, Any]] = []
        self.cut = False
        self.most_bytes: int | None = None
        self._waiting = b""

    def send(self, data: bytes) -> None:
        if not self.cut:
            self.sent.append((self._clock.now(), mavlink.MAVLink(None).decode(bytearray(data))))
            self._inner.send(data)

    def receive(self) -> bytes:
        """Return what has come, as much of it as a line hands over at once."""
        waiting = b"" if self.cut else self._waiting + self._inner.receive()
        most = len(waiting) if self.most_bytes is None else self.most_bytes
        data, self._waiting = waiting[:most], waiting[most:]
        return data

    def close(self) -> None:
        self._inner.close()

    def setpoints(self, since_s: float) -> list[float]:
        """Return when setpoints left, later than a time."""
        return [at for at, m in self.sent if m.get_msgId() == SETPOINT and at > since_s]


class Rig:
    """A vehicle in the air, its pilot, and our link and control without vision."""

    def __init__(self, flavour: str, *overrides: str) -> None:
        wanted = {"distance_m": DISTANCE_M, "target_size_m": SIZE_M}
        base = {"camera": {"pitch_deg": -20}, "servo": wanted}
        self.settings = settings = load_settings(base=base, overrides=overrides)
        self.flavour = flavour
        self.clock = SimulatedClock()
        ours, self.theirs = MemoryTransport.pair()
        self.wire = Wire(ours, self.clock)
        self.autopilot = SimAutopilot(flavour, self.theirs, BodyState(0.0, (0.0, 0.0, -15.0)))
        self.camera = settings.camera.model(WIDTH, HEIGHT)
        self.begin(FlightLog())
        self.seen = True
        self.right_px = 0.0
        self.frames_come = True
        self._newest_track: TrackRecord | None = None
        self._ground_station = mavlink.MAVLink(None, 255, 190)
        self._steps = 0

    def begin(self, log: FlightLog) -> None:
        """Start our program."""
        link = MavlinkLink(self.wire, replace(self.settings.link, vehicle_id=1))
        self.log = log
        self.stage = ControlStage(self.settings, self.camera, log)
        autonomy = Autonomy(link, -self.autopilot.state.position_m[2])
        autonomy.resumes = True
        pilot = autonomy if self.settings.autonomy == "full" else None
        self.loop = ControlLoop(link, self.stage, self._newest, log, pilot)

    def fly(self, seconds: float, stalled: bool = False) -> ControlRecord:
        """Let time pass, control after physics, or no control at all."""
        end = round((self.now_s + seconds) / STEP_S)
        every = round(CONTROL_S / STEP_S)
        while self._steps < end:
            self._steps += 1
            self.clock.sleep_until(self._steps * STEP_S)
            self.autopilot.step(self.clock.now())
            if self._steps % every == 0 and not stalled:
                self.loop.step(self.clock.now())
        return self.log.controls[-1]

    def until(self, state: State, within_s: float = 5.0) -> ControlRecord:
        end_s = self.now_s + within_s
        while self.now_s < end_s:
            record = self.fly(CONTROL_S)
            if record.state is state:
                return record
        raise AssertionError(f"not {state} but {record.state}: {record.reason}")

    def hand_over(self) -> None:
        """Have the pilot take our mode, and us hear of it."""
        self.until(State.READY)
        self.fly(0.3)
        assert self.autopilot.switch_mode(OURS[self.flavour])
        self.fly(1.2)

    def follow(self) -> None:
        """Have the pilot hand over what follows at once."""
        self.until(State.READY)
        self.fly(0.3)
        assert self.autopilot.switch_mode(OURS[self.flavour])
        self.until(State.FOLLOWING)

    def reach(self, state: State) -> None:
        self.follow()
        if state is H:
            self.frames_come = False
        elif state is not F:
            self.seen = False
        self.until(state)

    def command(self, value: float, system: int = 255, confirmation: int = 0) -> None:
        """Send a ground station's command, which the autopilot passes on."""
        codec = mavlink.MAVLink(None, system, 190)
        codec.seq = self._ground_station.seq
        self._ground_station.seq = (self._ground_station.seq + 1) % 256
        message = mavlink.MAVLink_command_long_message(
            1, 191, mavlink.MAV_CMD_USER_1, confirmation, value, *(0.0,) * 6
        )
        self.theirs.send(message.pack(codec))

    def answers(self) -> list[int]:
        return [m.result for _, m in self.wire.sent if m.get_type() == "COMMAND_ACK"]

    def events(self, source: str) -> list[str]:
        return [event.text for event in self.log.events if event.source == source]

    @property
    def now_s(self) -> float:
        return self.clock.now()

    def _newest(self) -> TrackRecord | None:
        now = self.now_s
        if self.frames_come:
            side = self.camera.fx * SIZE_M / DISTANCE_M
            box = Box(WIDTH / 2 + self.right_px, HEIGHT / 2, side, side)
            state = TrackState.TRACKING if self.seen else TrackState.LOST
            track = Track(box, state, 0.9, "test", now - 0.04, round(now / CONTROL_S))
            self._newest_track = TrackRecord(track, track.sequence, now - 0.04, now, now, 0.001)
            self.log.add_track(self._newest_track)
        return self._newest_track


@flavours
@pytest.mark.parametrize("state", [State.READY, F, C, S, H])
def test_the_pilot_leaves_the_mode_and_setpoints_end_within_a_tenth_of_a_second(
    flavour: str, state: State
) -> None:
    rig = Rig(flavour, "consent.kind=terminal") if state is State.READY else Rig(flavour)
    if state is State.READY:
        rig.until(state)
        rig.fly(0.3)
        assert rig.autopilot.switch_mode(OURS[flavour])
        rig.fly(1.5)
        assert rig.log.controls[-1].reason is Reason.WAITING_FOR_CONSENT
    else:
        rig.reach(state)
    left_s = rig.now_s
    rig.autopilot.switch_mode(PILOTS[flavour])
    record = rig.fly(1.0)
    assert (record.state, record.reason) == (R, Reason.PILOT_TOOK_OVER)
    rig.seen = rig.frames_come = True
    assert rig.fly(5.0).state is R
    assert rig.wire.setpoints(left_s + 0.1) == []
    assert rig.autopilot.mode == PILOTS[flavour]


@flavours
def test_a_mode_that_stood_before_we_came_is_not_for_us(flavour: str) -> None:
    """A vehicle that flies in GUIDED does somebody's bidding; a program of ours may have died."""
    rig = Rig(flavour)
    rig.follow()
    rig.begin(FlightLog())
    assert rig.fly(2.5).reason is Reason.WAITING_FOR_PILOT
    assert any("take it again" in text for text in rig.events("autopilot"))
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.fly(1.2)
    assert rig.autopilot.switch_mode(OURS[flavour])
    rig.until(F)


@flavours
def test_following_begins_anew_by_the_operator_and_the_pilot_alone(flavour: str) -> None:
    rig = Rig(flavour)
    rig.follow()
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.until(R)
    rig.fly(3.0)
    rig.stage.order(Order.RENEW)
    assert rig.fly(3.0).state is State.READY
    assert rig.autopilot.switch_mode(OURS[flavour])
    rig.until(F)


def test_guided_taken_again_is_somebody_elses() -> None:
    rig = Rig("ardupilot")
    rig.follow()
    rig.autopilot.switch_mode("LOITER")
    rig.until(R)
    back_s = rig.now_s
    rig.autopilot.switch_mode("GUIDED")
    assert rig.fly(3.0).state is R
    assert rig.wire.setpoints(back_s) == []


def test_offboard_taken_again_at_once_gets_its_stream_and_stands_still() -> None:
    rig = Rig("px4")
    rig.follow()
    rig.right_px = 60.0
    rig.fly(0.5)
    rig.autopilot.switch_mode("POSCTL")
    rig.until(R)
    assert rig.autopilot.switch_mode("OFFBOARD")
    record = rig.fly(3.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (R, True, "OFFBOARD")
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)


@pytest.mark.parametrize("phase_s", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.5, 0.9])
def test_offboard_entered_as_our_stream_ends_gets_it_back_and_stands_still(
    late_s: float, phase_s: float
) -> None:
    """PX4 lets a pilot enter for a second after the last setpoint, and flies home without more."""
    rig = Rig("px4")
    rig.until(State.READY)
    rig.fly(1.0 + phase_s)
    rig.seen = False
    rig.fly(late_s)
    assert rig.autopilot.switch_mode("OFFBOARD")
    record = rig.fly(4.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (State.TRACKING, True, "OFFBOARD")
    assert record.allowed == HOLD
    rig.autopilot.switch_mode("POSCTL")
    left_s = rig.now_s
    assert rig.fly(2.0).reason is Reason.PILOT_TOOK_OVER
    assert rig.wire.setpoints(left_s + 0.1) == []


@flavours
@pytest.mark.parametrize("after_s", [0.1, 0.5, 3.0])
def test_consent_after_a_stop_follows_again_where_nobody_else_takes_the_mode(
    flavour: str, after_s: float
) -> None:
    rig = Rig(flavour, "autonomy=full")
    rig.until(F, 8.0)
    rig.fly(1.0)
    rig.stage.request_stop()
    assert rig.fly(after_s).state is R
    rig.stage.order(Order.GIVE)
    rig.until(F, 3.0)
    assert {rig.fly(CONTROL_S).state for _ in range(150)} == {F}


def test_a_switch_there_and_back_between_two_steps_ends_the_following() -> None:
    rig = Rig("px4")
    rig.follow()
    rig.autopilot.switch_mode("POSCTL")
    # Both heartbeats come with the same poll.
    for _ in range(2):
        rig.theirs.send(_heartbeat("POSCTL"))
        rig.theirs.send(_heartbeat("OFFBOARD"))
    rig.autopilot.switch_mode("OFFBOARD")
    record = rig.fly(CONTROL_S)
    assert (record.state, record.reason) == (R, Reason.PILOT_TOOK_OVER)


def _heartbeat(mode: str) -> bytes:
    modes = {"POSCTL": 3 << 16, "OFFBOARD": 6 << 16}
    message = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_PX4,
        mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED,
        modes[mode],
        mavlink.MAV_STATE_ACTIVE,
        3,
    )
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))


@pytest.mark.parametrize("gone_s", [0.3, 1.3, 2.0, 4.0])
def test_px4_that_comes_back_into_offboard_by_itself_is_not_followed_with(gone_s: float) -> None:
    rig = Rig("px4")
    rig.follow()
    rig.wire.cut = True
    rig.fly(gone_s)
    assert rig.autopilot.mode == ("OFFBOARD" if gone_s < 1 else "RTL")
    rig.wire.cut = False
    record = rig.fly(3.0)
    if gone_s < 1:
        assert record.state is F
    else:
        assert record.state is R
        assert record.reason in (Reason.LINK_LOST, Reason.NOT_HEARD)
        assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)


@pytest.mark.parametrize("phase_s", [0.0, 0.2, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("most_bytes", [None, 1024], ids=["at once", "bit by bit"])
def test_after_a_stall_px4_is_not_called_out_of_a_failsafe_that_no_heartbeat_told_of(
    phase_s: float, most_bytes: int | None
) -> None:
    rig, setpoints_s = after_a_stall(phase_s, 1.6, most_bytes)
    assert rig.autopilot.mode == "RTL"
    assert setpoints_s == []


@pytest.mark.parametrize("phase_s", [0.0, 0.5])
def test_after_a_stall_that_px4_bore_it_is_held_soon(phase_s: float) -> None:
    rig, setpoints_s = after_a_stall(phase_s, 1.04)
    assert rig.autopilot.mode == "OFFBOARD"
    assert setpoints_s[0] < 0.1


def after_a_stall(
    phase_s: float, length_s: float, most_bytes: int | None = None
) -> tuple[Rig, list[float]]:
    """Return a rig two seconds after a stall, and how long after it setpoints left.

    Args:
        phase_s: from PX4's heartbeats to the stall's beginning.
        length_s: of the stall.
        most_bytes: that the line hands over at once.
    """
    rig = Rig("px4")
    rig.wire.most_bytes = most_bytes
    rig.follow()
    rig.fly(1.0 + phase_s)
    rig.fly(length_s, stalled=True)
    stalled_s = rig.now_s
    assert rig.fly(2.0).state is R
    return rig, [at - stalled_s for at in rig.wire.setpoints(stalled_s)]


@flavours
def test_an_autopilot_that_talks_but_does_not_hear_us_is_let_go(flavour: str) -> None:
    rig = Rig(flavour)
    rig.follow()
    rig.fly(0.3)
    rig.autopilot.faults.deaf = True
    rig.fly(0.9)
    assert rig.log.controls[-1].state is F
    assert rig.until(R, 0.3).reason is Reason.NOT_HEARD
    # PX4 may have gone into its failsafe and come back between two of its own heartbeats.
    rig.autopilot.faults.deaf = False
    assert rig.fly(2.0).state is R


def test_who_asks_seldom_does_not_take_silence_for_deafness() -> None:
    rig = Rig("ardupilot", "link.mode_rate_hz=0", "link.timesync_rate_hz=0.2")
    rig.follow()
    assert rig.fly(4.0).state is F


def test_a_restart_of_ours_neither_ends_px4s_failsafe_nor_follows() -> None:
    rig = Rig("px4")
    rig.follow()
    rig.fly(0.5)
    rig.wire.cut = True
    rig.fly(2.5)
    assert rig.autopilot.mode == "RTL"
    rig.begin(FlightLog())
    rig.wire.cut = False
    record = rig.fly(3.0)
    assert (record.state, record.reason) == (State.TRACKING, Reason.AUTOPILOT_FAILSAFE)
    assert rig.autopilot.mode == "RTL"
    # The pilot takes the vehicle, and with it ends the failsafe.
    rig.autopilot.switch_mode("POSCTL")
    rig.until(State.READY)
    rig.fly(0.3)
    assert rig.autopilot.switch_mode("OFFBOARD")
    rig.until(F)


@flavours
def test_by_setting_the_pilots_own_mode_counts_but_a_failsafe_does_not(flavour: str) -> None:
    rig = Rig(flavour, "consent.again=mode")
    rig.follow()
    left_s = rig.now_s
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.until(R)
    rig.fly(1.9)
    assert rig.wire.setpoints(left_s + 0.1) == []
    rig.until(State.READY, 1.5)
    rig.fly(0.3)
    assert rig.autopilot.switch_mode(OURS[flavour])
    rig.until(F)


def test_by_setting_a_failsafe_is_not_the_pilots_own_mode() -> None:
    rig = Rig("px4", "consent.again=mode")
    rig.follow()
    rig.wire.cut = True
    rig.fly(2.0)
    # What we send is heard again only after PX4's next heartbeat has told of its failsafe.
    rig.wire.cut = False
    sends = rig.loop._link.send
    rig.loop._link.send = lambda _: None  # type: ignore[method-assign]
    rig.fly(2.0)
    rig.loop._link.send = sends  # type: ignore[method-assign]
    assert rig.autopilot.mode == "RTL"
    record = rig.fly(4.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (R, False, "RTL")


@flavours
def test_a_command_gives_consent_and_takes_it_back(flavour: str) -> None:
    rig = Rig(flavour, "consent.kind=command")
    rig.until(State.READY)
    rig.fly(0.3)
    assert rig.autopilot.switch_mode(OURS[flavour])
    assert rig.fly(2.0).reason is Reason.WAITING_FOR_CONSENT
    assert rig.autopilot.mode == OURS[flavour]
    rig.command(1.0)
    rig.until(F, 0.1)
    assert rig.answers() == [mavlink.MAV_RESULT_ACCEPTED]
    rig.command(0.0)
    record = rig.until(R, 0.1)
    assert record.reason is Reason.CONSENT_WITHDRAWN
    record = rig.fly(3.0)
    assert (record.sent, rig.autopilot.mode) == (True, OURS[flavour])
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)
    rig.command(1.0)
    rig.until(F, 0.1)
    assert set(rig.answers()) == {mavlink.MAV_RESULT_ACCEPTED}


def test_a_command_from_anybody_else_or_for_another_consent_is_denied() -> None:
    rig = Rig("ardupilot", "consent.kind=command")
    rig.hand_over()
    rig.command(1.0, system=42)
    rig.command(7.0)
    rig.command(float("nan"))
    assert rig.fly(2.0).reason is Reason.WAITING_FOR_CONSENT
    other = Rig("ardupilot", "consent.kind=rc")
    other.hand_over()
    other.command(1.0)
    assert other.fly(1.0).reason is Reason.WAITING_FOR_CONSENT
    assert set(rig.answers() + other.answers()) == {mavlink.MAV_RESULT_DENIED}


def test_a_command_repeated_after_the_pilot_took_over_is_no_new_consent() -> None:
    rig = Rig("ardupilot", "consent.kind=command")
    rig.hand_over()
    rig.command(1.0)
    rig.until(F)
    rig.autopilot.switch_mode("LOITER")
    rig.until(R)
    rig.command(1.0, confirmation=1)
    assert rig.fly(1.5).state is R
    assert rig.answers() == [mavlink.MAV_RESULT_ACCEPTED] * 2
    rig.command(1.0)
    rig.until(State.READY)


@flavours
def test_a_switch_gives_consent_when_it_is_turned_on(flavour: str) -> None:
    rig = Rig(flavour, "consent.kind=rc", "consent.rc_channel=6")
    on, off = ((1500, 1500, 1500, 1500, 1000, pulse) for pulse in (1900, 1100))
    rig.autopilot.move_sticks(*on)
    rig.until(State.READY)
    rig.fly(0.3)
    assert rig.autopilot.switch_mode(OURS[flavour])
    # It is on from the start: nobody turned it.
    assert rig.fly(2.0).reason is Reason.WAITING_FOR_CONSENT
    rig.autopilot.move_sticks(*off)
    rig.fly(0.5)
    rig.autopilot.move_sticks(*on)
    rig.until(F, 0.3)
    off_s = rig.now_s
    rig.autopilot.move_sticks(*off)
    assert rig.until(R, 0.3).reason is Reason.CONSENT_WITHDRAWN
    assert rig.now_s - off_s < 0.2
    record = rig.fly(2.0)
    assert (record.sent, rig.autopilot.mode) == (True, OURS[flavour])
    rig.autopilot.move_sticks(*on)
    rig.until(F, 0.3)
    # The pilot takes over with the switch on: it has to be turned again.
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.until(R)
    assert rig.fly(2.0).state is R
    rig.autopilot.move_sticks(*off)
    rig.fly(0.3)
    rig.autopilot.move_sticks(*on)
    rig.until(State.READY, 0.3)


@flavours
def test_after_a_stop_the_switch_gives_consent_anew(flavour: str) -> None:
    rig = Rig(flavour, "consent.kind=rc", "consent.rc_channel=5")
    rig.autopilot.move_sticks(*MIDDLE, 1000)
    rig.hand_over()
    rig.fly(0.3)
    rig.autopilot.move_sticks(*MIDDLE, 2000)
    rig.until(F, 0.3)
    rig.stage.request_stop()
    rig.until(R, 0.1)
    rig.autopilot.move_sticks(*MIDDLE, 1000)
    assert rig.fly(0.5).state is R
    rig.autopilot.move_sticks(*MIDDLE, 2000)
    rig.until(F, 0.3)


def test_a_transmitter_that_falls_silent_withdraws_consent() -> None:
    rig = Rig("ardupilot", "consent.kind=rc", "consent.rc_channel=5")
    rig.autopilot.move_sticks(1500, 1500, 1500, 1500, 1000)
    rig.hand_over()
    rig.fly(0.5)
    rig.autopilot.move_sticks(1500, 1500, 1500, 1500, 2000)
    rig.until(F, 0.3)
    rig.autopilot.move_sticks()
    assert rig.until(R, 1.3).reason is Reason.CONSENT_WITHDRAWN


@flavours
def test_the_terminal_gives_consent(flavour: str) -> None:
    rig = Rig(flavour, "consent.kind=terminal")
    rig.until(State.READY)
    rig.fly(0.3)
    rig.autopilot.switch_mode(OURS[flavour])
    assert rig.fly(2.0).state is State.READY
    rig.stage.order(Order.GIVE)
    rig.until(F, 0.1)
    rig.stage.order(Order.WITHDRAW)
    assert rig.until(R, 0.1).reason is Reason.CONSENT_WITHDRAWN


Right = Callable[[ControlRecord], float]
MIDDLE = (1500, 1500, 1500, 1500)
NUDGES: list[tuple[int, int, Right]] = [
    (0, 1700, lambda record: record.asked.right_m_s),
    (0, 1300, lambda record: -record.asked.right_m_s),
    (1, 1300, lambda record: record.asked.forward_m_s),
    (1, 1700, lambda record: -record.asked.forward_m_s),
    (2, 1700, lambda record: -record.asked.down_m_s),
    (2, 1300, lambda record: record.asked.down_m_s),
    (3, 1700, lambda record: record.asked.yaw_rate_rad_s),
    (3, 1300, lambda record: -record.asked.yaw_rate_rad_s),
]


@pytest.mark.parametrize(("channel", "pulse", "way"), NUDGES)
def test_sticks_shift_what_is_wanted_the_way_they_are_moved(
    channel: int, pulse: int, way: Right
) -> None:
    moved, asked = list(MIDDLE), []
    moved[channel] = pulse
    for sticks in (MIDDLE, moved):
        rig = Rig("ardupilot", "sticks.nudge=true")
        rig.autopilot.move_sticks(*MIDDLE)
        rig.follow()
        rig.fly(1.0)
        rig.autopilot.move_sticks(*sticks)
        record = rig.fly(0.5)
        assert record.state is F
        asked.append(way(record))
    assert asked[1] > asked[0] + 0.02


def test_sticks_do_nothing_unless_asked_for() -> None:
    rig, calm = Rig("ardupilot"), Rig("ardupilot")
    for one in (rig, calm):
        one.autopilot.move_sticks(*MIDDLE)
        one.follow()
    rig.autopilot.move_sticks(1700, 1300, 1700, 1300)
    assert rig.fly(1.0).asked == calm.fly(1.0).asked


@flavours
def test_a_stick_moved_far_takes_over(flavour: str) -> None:
    rig = Rig(flavour)
    rig.autopilot.move_sticks(*MIDDLE)
    rig.follow()
    rig.fly(0.5)
    moved_s = rig.now_s
    rig.autopilot.move_sticks(1500, 1150, 1500, 1500)
    record = rig.until(R, 0.3)
    assert record.reason is Reason.STICKS_MOVED
    assert rig.now_s - moved_s < 0.2
    record = rig.fly(3.0)
    assert (record.sent, rig.autopilot.mode) == (True, OURS[flavour])
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)


RELEASES = [
    ("px4", "loiter", "LOITER"),
    ("px4", "rtl", "RTL"),
    ("px4", "land", "LAND"),
    ("ardupilot", "loiter", "BRAKE"),
    ("ardupilot", "rtl", "RTL"),
    ("ardupilot", "land", "LAND"),
]
SHORT = ("supervisor.search_s=1.0", "supervisor.hold_s=1.0")


@pytest.mark.parametrize(("flavour", "action", "mode"), RELEASES)
def test_the_ladder_ends_in_the_autopilots_own_mode(flavour: str, action: str, mode: str) -> None:
    rig = Rig(flavour, f"release.action={action}", *SHORT)
    rig.follow()
    rig.right_px = 80.0
    rig.fly(1.0)
    rig.seen = False
    for state in (C, S, H, R):
        rig.until(state)
    assert rig.log.controls[-1].reason is Reason.HOLD_TIMED_OUT
    rig.fly(5.0)
    assert rig.autopilot.mode == mode
    assert not rig.log.controls[-1].sent
    assert rig.events("release") == [f"asking for {mode}", f"the autopilot is in {mode}"]
    rungs = [text for text in rig.events("supervisor") if not text.startswith(("idle", "tracking"))]
    assert rungs[-5:] == [
        "following: target seen",
        "coasting: target unseen",
        "searching: target lost",
        "holding: search failed",
        "released: hold timed out",
    ]


@flavours
def test_a_mode_that_is_refused_keeps_the_hold(flavour: str) -> None:
    rig = Rig(flavour, "release.action=land", *SHORT)
    rig.autopilot.faults.refused_modes = ("LAND",)
    rig.follow()
    rig.stage.request_stop()
    record = rig.fly(8.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (R, True, OURS[flavour])
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)
    assert "LAND is not entered: holding, and asking again" in rig.events("release")
    rig.autopilot.faults.refused_modes = ()
    rig.fly(2.5)
    assert rig.autopilot.mode == "LAND"


@flavours
def test_the_pilots_mode_is_not_taken_from_him(flavour: str) -> None:
    rig = Rig(flavour, "release.action=rtl")
    rig.follow()
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.fly(6.0)
    assert rig.autopilot.mode == PILOTS[flavour]
    assert rig.events("release") == []


def test_handed_back_ardupilot_stays_where_it_is() -> None:
    rig = Rig("ardupilot", "release.action=hand_back")
    rig.follow()
    rig.stage.request_stop()
    rig.fly(3.0)
    quiet_s = rig.now_s
    record = rig.fly(6.0)
    assert (record.sent, rig.autopilot.mode) == (False, "GUIDED")
    rig.loop.hold()  # the program ends
    assert rig.wire.setpoints(quiet_s) == []
    assert max(map(abs, rig.autopilot.state.velocity_m_s)) < 0.1


def test_a_program_that_ends_while_it_holds_says_so_once_more() -> None:
    rig = Rig("ardupilot")
    rig.follow()
    rig.stage.request_stop()
    rig.fly(3.0)
    before = len(rig.wire.setpoints(0.0))
    rig.loop.hold()
    assert len(rig.wire.setpoints(0.0)) == before + 1


def test_handed_back_px4_does_what_its_parameter_says() -> None:
    rig = Rig("px4", "release.action=hand_back")
    rig.follow()
    rig.stage.request_stop()
    rig.fly(6.0)
    assert (rig.log.controls[-1].sent, rig.autopilot.mode) == (False, "RTL")


@flavours
def test_nothing_changes_the_mode_unless_the_release_is_set_to(flavour: str) -> None:
    rig = Rig(flavour, *SHORT)
    rig.follow()
    rig.seen = False
    rig.until(R)
    rig.fly(5.0)
    modes = [m for _, m in rig.wire.sent if m.get_type() == "COMMAND_LONG"]
    assert mavlink.MAV_CMD_DO_SET_MODE not in {m.command for m in modes}
    assert rig.autopilot.mode == OURS[flavour]


def test_a_flight_with_switch_sticks_orders_and_a_search_is_replayed_bit_for_bit(
    tmp_path: Path,
) -> None:
    rig = Rig("px4", "consent.kind=rc", "consent.rc_channel=5", "sticks.nudge=true", *SHORT)
    config = FlightConfig.of("simulated", rig.settings, camera=rig.camera)
    recorder = Recorder(tmp_path, config, rig.clock, rig.settings.recorder, threaded=False)
    with recorder:
        rig.begin(recorder.log)
        rig.autopilot.move_sticks(*MIDDLE, 1000)
        rig.until(State.READY)
        rig.fly(0.3)
        rig.autopilot.switch_mode("OFFBOARD")
        rig.autopilot.move_sticks(*MIDDLE, 2000)
        rig.until(F)
        rig.right_px = 40.0
        rig.fly(0.5)
        rig.autopilot.move_sticks(1650, 1400, 1600, 1400, 2000)
        rig.fly(0.5)
        rig.stage.order(Order.WITHDRAW)
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

    def __init__(self, rig: Rig, seed: int) -> None:
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
        order = (Order.RENEW, Order.GIVE, Order.WITHDRAW)[self._lots.integers(3)]
        if order is not Order.WITHDRAW:
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


@pytest.mark.parametrize(
    ("flavour", "kind", "seed"), [("px4", "mode", 7), ("ardupilot", "command", 7)]
)
def test_whatever_people_do_nobody_is_followed_without_consent_and_mode(
    flavour: str, kind: str, seed: int
) -> None:
    rig = Rig(flavour, f"consent.kind={kind}", "sticks.nudge=true", *SHORT)
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
            assert record.state is State.READY  # for PX4, which wants a stream first
            assert record.allowed == HOLD
    for left_s in chance.left:
        after = next(record for record in controls if record.time_s > left_s + 0.1)
        assert after.state in (R, State.READY, State.TRACKING, State.IDLE)
        if after.state is R:
            assert not after.sent
