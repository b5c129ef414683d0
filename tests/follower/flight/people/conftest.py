"""A vehicle, its pilot and our link and control in lockstep, for tests of what people may do.

No camera and no tracker: the target stands in the image where the test puts it.
"""

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower.flight.supervision.autonomy import Autonomy
from follower.flight.supervision.supervisor import SupervisorState
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.settings import load_settings
from follower_control.common.transport import MemoryTransport, WrappedTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.vehicle.vehicle import STEP_S
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState

WIDTH, HEIGHT, CONTROL_S = 640, 480, 0.02
DISTANCE_M, SIZE_M = 15.0, 2.0
OURS = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


class Wire(WrappedTransport):
    """Notes what we send."""

    def __init__(self, inner: MemoryTransport, clock: SimulatedClock) -> None:
        super().__init__(inner)
        self._clock = clock
        self.sent: list[tuple[float, Any]] = []
        self.cut = False
        self.most_bytes: int | None = None
        self._waiting = b""

    def send(self, data: bytes) -> None:
        if not self.cut:
            self.sent.append((self._clock.now(), mavlink.MAVLink(None).decode(bytearray(data))))
            super().send(data)

    def receive(self) -> bytes:
        """Return what has come, as much of it as a line hands over at once."""
        waiting = b"" if self.cut else self._waiting + super().receive()
        most = len(waiting) if self.most_bytes is None else self.most_bytes
        data, self._waiting = waiting[:most], waiting[most:]
        return data

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
        self.stalls_within_a_step_s = 0.0
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
        self.loop = ControlLoop(link, self.stage, self._newest, log, pilot, clock=self.clock)

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

    def until(self, state: SupervisorState, within_s: float = 5.0) -> ControlRecord:
        end_s = self.now_s + within_s
        while self.now_s < end_s:
            record = self.fly(CONTROL_S)
            if record.state is state:
                return record
        raise AssertionError(f"not {state} but {record.state}: {record.reason}")

    def take_mode(self) -> None:
        """Have the pilot take our mode, once we are ready for it."""
        self.until(SupervisorState.READY)
        self.fly(0.3)
        assert self.autopilot.switch_mode(OURS[self.flavour])

    def hand_over(self) -> None:
        """Have the pilot take our mode, and us hear of it."""
        self.take_mode()
        self.fly(1.2)

    def follow(self) -> None:
        """Have the pilot hand over what follows at once."""
        self.take_mode()
        self.until(SupervisorState.FOLLOWING)

    def reach(self, state: SupervisorState) -> None:
        self.follow()
        if state is SupervisorState.HOLDING:
            self.frames_come = False
        elif state is not SupervisorState.FOLLOWING:
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
        now, stall_s, self.stalls_within_a_step_s = self.now_s, self.stalls_within_a_step_s, 0.0
        if stall_s > 0:
            self.fly(stall_s, stalled=True)
        if self.frames_come:
            side = self.camera.fx * SIZE_M / DISTANCE_M
            box = Box(WIDTH / 2 + self.right_px, HEIGHT / 2, side, side)
            state = TrackState.TRACKING if self.seen else TrackState.LOST
            track = Track(box, state, 0.9, "test", now - 0.04, round(now / CONTROL_S))
            self._newest_track = TrackRecord(track, track.sequence, now - 0.04, now, now, 0.001)
            self.log.add_track(self._newest_track)
        return self._newest_track


@pytest.fixture(scope="session")
def rig_of() -> type[Rig]:
    """Make a rig: of a flavour, with settings as `--set` takes them."""
    return Rig
