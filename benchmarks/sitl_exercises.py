"""What comes of it on a real autopilot when the pilot, the link or the computer does something.

A relay stands between the autopilot's program and the follower's process. It acts once the follower
flies fast: it orders another mode as a ground station does, loses packets, stops or kills the
process, or breaks something in the autopilot's simulator. It judges by the packets that it relays:
no setpoint outside the envelope, no velocity after the autopilot reported another mode, and in the
end a vehicle that stands, goes home or lands, or is followed with again where that is allowed.

Run from the repository's root, with the programs that ARDUCOPTER_SITL and PX4_SITL name:

    python benchmarks/sitl_exercises.py [NAME…]
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.apps.sitl.run import programs
from follower.links.modes import set_mode_params
from follower.settings.settings import load_settings
from follower.simulation.fault_tests.run_fault import write_scene
from follower.simulation.faults.setpoint_rules import envelope_failures, heartbeat_failures
from follower.simulation.faults.wire_tap import FIRMWARE, FlightEvidence, WireTap
from follower.simulation.sitl.process import AutopilotProcess
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower_control.common.transport import UdpTransport
from follower_vision.clock import MonotonicClock

_PATIENCE_S, _AFTERWARDS_S, _STANDS_WITHIN_S = 150.0, 16.0, 9.0
_FAST_M_S, _STEADY_S, _STANDS_M_S = 2.0, 3.0, 0.6
_GROUND_STATION = 255
_AUTOPILOTS = {"px4": mavlink.MAV_AUTOPILOT_PX4, "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA}
HANDED_OVER, RELEASED, FOLLOWED = (3,), (4,), (0, 1)


@dataclass(frozen=True, slots=True)
class Exercise:
    """What is done, and what must come of it.

    Attributes:
        must: in words.
        codes: exit codes of the follower that are right; empty where it is killed.
        mode: ordered by a ground station, by flavour.
        lose_s: how long packets are lost.
        ways: which ones, "down" to the follower, "up" to the autopilot.
        stop_s: how long the follower's process stands still.
        kill: whether it is killed.
        sets: parameters that are changed in flight.
        starts: parameters that the autopilot is started with.
        flavours: which autopilots can do it.
    """

    must: str
    codes: tuple[int, ...] = ()
    mode: Mapping[str, str] = field(default_factory=dict)
    lose_s: float = 0.0
    ways: tuple[str, ...] = ("down", "up")
    stop_s: float = 0.0
    kill: bool = False
    sets: Mapping[str, float] = field(default_factory=dict)
    starts: Mapping[str, float] = field(default_factory=dict)
    flavours: tuple[str, ...] = ("ardupilot", "px4")

    @property
    def may_follow(self) -> bool:
        """Whether following on, or again, is right."""
        return set(FOLLOWED) <= set(self.codes)


_HOLD = {"px4": "LOITER", "ardupilot": "LOITER"}
_RTL = {"px4": "RTL", "ardupilot": "RTL"}
EXERCISES = {
    "pilot-mode": Exercise("handed over at once", HANDED_OVER, mode=_HOLD),
    "ground-station-rtl": Exercise("handed over at once", HANDED_OVER, mode=_RTL),
    "ground-station-land": Exercise(
        "handed over at once", HANDED_OVER, mode={"px4": "LAND", "ardupilot": "LAND"}
    ),
    "link-1s": Exercise("held, then released", (*RELEASED, *HANDED_OVER), lose_s=1.3),
    "link-3s": Exercise("held, then released", (*RELEASED, *HANDED_OVER), lose_s=3.0),
    "link-10s": Exercise("held, then released", (*RELEASED, *HANDED_OVER), lose_s=10.0),
    "telemetry-1s": Exercise(
        "held; may follow again", (*FOLLOWED, *RELEASED), lose_s=1.0, ways=("down",)
    ),
    "telemetry-3s": Exercise("held, then released", RELEASED, lose_s=3.0, ways=("down",)),
    "telemetry-10s": Exercise("held, then released", RELEASED, lose_s=10.0, ways=("down",)),
    "setpoints-1s": Exercise(
        "the autopilot holds by itself; released or followed on",
        (*FOLLOWED, *RELEASED, *HANDED_OVER),
        lose_s=1.0,
        ways=("up",),
    ),
    "setpoints-3s": Exercise("released", (*RELEASED, *HANDED_OVER), lose_s=3.0, ways=("up",)),
    "setpoints-10s": Exercise("released", (*RELEASED, *HANDED_OVER), lose_s=10.0, ways=("up",)),
    "stopped-0.5s": Exercise("follows on or again", (*FOLLOWED, *RELEASED), stop_s=0.5),
    "stopped-4s": Exercise("released", (*RELEASED, *HANDED_OVER), stop_s=4.0),
    "killed": Exercise("the autopilot holds or goes home by itself", kill=True),
    "gps-lost": Exercise(
        "held or handed over",
        (*RELEASED, *HANDED_OVER),
        sets={"SIM_GPS1_ENABLE": 0, "SIM_GPS_DISABLE": 1},
        flavours=("ardupilot",),
    ),
    "battery-failsafe": Exercise(
        "handed over to the autopilot's failsafe",
        (*RELEASED, *HANDED_OVER),
        sets={"SIM_BATT_VOLTAGE": 10.5},
        starts={"BATT_LOW_VOLT": 11.5, "BATT_LOW_TIMER": 1, "BATT_FS_LOW_ACT": 2},
        flavours=("ardupilot",),
    ),
    "fence": Exercise(
        "the autopilot's fence stops it",
        (*FOLLOWED, *RELEASED, *HANDED_OVER),
        sets={"FENCE_RADIUS": 31},
        starts={"FENCE_TYPE": 2, "FENCE_ACTION": 1, "FENCE_ENABLE": 1, "FENCE_RADIUS": 200},
        flavours=("ardupilot",),
    ),
}


class Relay:
    """Carries packets between an autopilot and the follower, and knows both."""

    def __init__(self, program: SitlProgram, autopilot: UdpTransport, follower_port: int) -> None:
        self.clock = MonotonicClock()
        self.flavour = program.flavour
        self._autopilot = autopilot
        self._follower = WireTap(UdpTransport.connect("127.0.0.1", follower_port), self.clock)
        self._codec = mavlink.MAVLink(None, _GROUND_STATION, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self.lost_until_s = {"down": -math.inf, "up": -math.inf}
        self.speed_m_s = 0.0
        self.obeys = False
        self.slow_since_s: float | None = None
        firmware = FIRMWARE[program.flavour]
        self._mode = firmware.modes[firmware.setpoint_mode].custom_mode
        self._system = 1

    def step(self) -> float:
        """Carry what has come, and return the time, s."""
        now_s = self.clock.now()
        data = self._autopilot.receive()
        for message in self._parser.parse_buffer(data) or []:
            self._look(message, now_s)
        if data and now_s > self.lost_until_s["down"]:
            self._follower.send(data)
        data = self._follower.receive()
        if data and now_s > self.lost_until_s["up"]:
            self._autopilot.send(data)
        return now_s

    def _look(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "LOCAL_POSITION_NED":
            self.speed_m_s = math.hypot(message.vx, message.vy, message.vz)
            slow = self.speed_m_s < _STANDS_M_S
            self.slow_since_s = (self.slow_since_s or now_s) if slow else None
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self._system = message.get_srcSystem()
            self.obeys = message.custom_mode == self._mode

    def order(self, mode: str) -> None:
        """Order a mode as a ground station."""
        params = set_mode_params(_AUTOPILOTS[self.flavour], mode)
        padded = (*params, *(0.0,) * (7 - len(params)))
        message = mavlink.MAVLink_command_long_message(
            self._system, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *padded
        )
        self._autopilot.send(message.pack(self._codec))

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter as a ground station."""
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        message = mavlink.MAVLink_param_set_message(self._system, 1, name.encode(), value, kind)
        self._autopilot.send(message.pack(self._codec))

    def evidence(self) -> FlightEvidence:
        """Return what went to and from the follower."""
        evidence = FlightEvidence(self.flavour)
        evidence.read(self._follower.received, self._follower.sent, self._system)
        return evidence

    def close(self) -> None:
        """Close the follower's side."""
        self._follower.close()


def fly(exercise: Exercise, program: SitlProgram) -> list[str]:
    """Fly one exercise; return what was wrong."""
    parameters = {**program.usual_parameters(), **exercise.starts}
    with tempfile.TemporaryDirectory() as text, closing(program.listen()) as autopilot:
        folder = Path(text)
        with closing(UdpTransport.listen("127.0.0.1", 0)) as free:
            port = free.port
        relay = Relay(program, autopilot, port)
        with (
            closing(relay),
            AutopilotProcess(program, SitlSetup(1.0, parameters), folder),
            (folder / "follower.txt").open("w") as output,
        ):
            command = [sys.executable, "-c", "from follower.apps.main import main; main()"]
            command += ["sim", str(write_scene(folder)), "--autopilot", "external"]
            command += ["--connect", f"udpin:127.0.0.1:{port}", "--vision", "truth+noise"]
            command += ["--out", str(folder / "runs"), "--no-video", "--no-record"]
            process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
            try:
                begun_s = _fly(relay, process, exercise)
            finally:
                process.kill()
                process.wait()
        said = (folder / "follower.txt").read_text()
    if begun_s is None:
        return [f"it never flew fast enough; the follower's output ends: {said[-200:]}"]
    return list(_wrong(relay, process.returncode, exercise, begun_s, said))


def _fly(relay: Relay, process: subprocess.Popen[bytes], exercise: Exercise) -> float | None:
    """Relay to the end; return when the exercise began, s, None if it never did."""
    fast_since_s = math.inf
    begun_s, asked = None, False
    resume_s = math.inf
    while True:
        now_s = relay.step()
        moves = relay.obeys and relay.speed_m_s > _FAST_M_S
        fast_since_s = min(fast_since_s, now_s) if moves else math.inf
        if begun_s is None and now_s - fast_since_s > _STEADY_S:
            begun_s = now_s
            resume_s = _act(relay, process, exercise, now_s)
        if now_s > resume_s:
            resume_s = math.inf
            os.kill(process.pid, signal.SIGCONT)
        if begun_s is None and (now_s > _PATIENCE_S or process.poll() is not None):
            return None
        if begun_s is not None and now_s > begun_s + _AFTERWARDS_S + exercise.lose_s:
            ended = process.poll() is not None or exercise.kill
            if not ended and not asked:
                asked = True
                process.send_signal(signal.SIGINT)  # one that follows again ends as asked
            if ended or now_s > begun_s + 3 * _AFTERWARDS_S + exercise.lose_s:
                return begun_s
        time.sleep(0.002)


def _act(relay: Relay, process: subprocess.Popen[bytes], exercise: Exercise, now_s: float) -> float:
    """Do it; return when a stopped process is to go on, s."""
    if exercise.mode:
        relay.order(exercise.mode[relay.flavour])
    for way in exercise.ways if exercise.lose_s else ():
        relay.lost_until_s[way] = now_s + exercise.lose_s
    for name, value in exercise.sets.items():
        relay.set_parameter(name, value)
    if exercise.kill:
        process.kill()
    if exercise.stop_s:
        os.kill(process.pid, signal.SIGSTOP)
        return now_s + exercise.stop_s
    return math.inf


def _wrong(relay: Relay, code: int, exercise: Exercise, begun_s: float, said: str) -> Iterator[str]:
    evidence, limits = relay.evidence(), load_settings().envelope
    yield from envelope_failures(evidence.setpoints, limits, limits.max_interval_s)
    yield from heartbeat_failures(evidence)
    if "Traceback" in said:
        yield f"an uncaught error: {said[-300:]}"
    follows_on = code == 130 and exercise.may_follow
    if exercise.codes and code not in exercise.codes and not follows_on:
        yield f"exit code {code}, wanted one of {exercise.codes}"
    since_s = relay.slow_since_s
    stands = since_s is not None
    if relay.obeys and not stands:
        yield f"in the end it flies on at {relay.speed_m_s:.1f} m/s"
    if exercise.kill:
        late = [s.time_s for s in evidence.setpoints if s.time_s > begun_s + 0.2]
        if late:
            yield f"a setpoint came {late[0] - begun_s:.1f} s after the process was killed"
        if relay.obeys and since_s is not None and since_s > begun_s + _STANDS_WITHIN_S:
            yield f"it stood only {since_s - begun_s:.1f} s after the process was killed"


def main() -> None:
    """Fly the exercises and print a line for each."""
    names = sys.argv[1:] or list(EXERCISES)
    unknown = [name for name in names if name not in EXERCISES]
    if unknown:
        sys.exit(f"there is no {unknown[0]!r}: choose from {', '.join(EXERCISES)}")
    failed = 0
    for program in programs(None, None, None, None):
        if program is None:
            continue
        for name in names:
            exercise = EXERCISES[name]
            if program.flavour not in exercise.flavours:
                continue
            wrong = fly(exercise, program)
            failed += bool(wrong)
            mark = "FAIL" if wrong else "ok  "
            print(f"{mark} {program.title:18} {name:20} {exercise.must}", flush=True)
            for line in wrong:
                print(f"       {line}", flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
