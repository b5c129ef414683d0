"""What comes of it on a real autopilot when the pilot, the link or the computer does something.

A relay stands between the autopilot's program and the follower's process. It acts once the follower
flies fast: it orders another mode as a ground station does, loses packets, stops or kills the
process, moves the sticks, or breaks something in the autopilot's simulator. In some exercises it is
the pilot who arms and takes off. It judges by the packets that it relays: no setpoint outside the
envelope, no velocity after the autopilot reported another mode, and in the end a vehicle that
stands, goes home or lands, or is followed with again where that is allowed.

Run from the repository's root, with the programs that ARDUCOPTER_SITL and PX4_SITL name:

    python benchmarks/sitl_exercises.py [NAME…]
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.apps.sitl.run import programs
from follower.links.vehicle_monitor import set_mode_params
from follower.settings.settings import load_settings
from follower.simulation.fault_tests.run_fault import SCENE
from follower.simulation.faults.setpoint_rules import envelope_failures, heartbeat_failures
from follower.simulation.faults.wire_tap import FIRMWARE, FlightEvidence, WireTap
from follower.simulation.sitl.gusts import Gusts
from follower.simulation.sitl.process import AutopilotProcess
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import UdpTransport
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.world.world import World
from follower_vision.clock import MonotonicClock

_PATIENCE_S, _AFTERWARDS_S, _STANDS_WITHIN_S = 150.0, 16.0, 9.0
_FAST_M_S, _STEADY_S, _STANDS_M_S = 2.0, 3.0, 0.6
_AGAIN_S, _STICKS_S, _STICK_STEP = 1.0, 0.05, 0.1
_CLIMBED_M, _ON_GROUND_M = 5.0, 0.5
_AT_REST = (0.0, 0.0, -1.0, 0.0)
"""Roll, pitch, throttle, yaw: the throttle down, as both want it for arming."""
_GROUND_STATION = 255
_AUTOPILOTS = {"px4": mavlink.MAV_AUTOPILOT_PX4, "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA}
HANDED_OVER, RELEASED, FOLLOWED = (3,), (4,), (0, 1)


@dataclass(frozen=True, slots=True)
class Exercise:
    """What is done, and what must come of it.

    Attributes:
        must: in words.
        codes: exit codes of the follower that are right; empty where it is killed.
        pilot: what the pilot does first, while the follower waits; else it takes off by itself.
        stays_down: whether nothing may lift off; what is done is the pilot's part alone.
        to_the_end: whether nothing is done: it flies the scenario to its end.
        mode: ordered by a ground station, by flavour.
        lose_s: how long packets are lost.
        ways: which ones, "down" to the follower, "up" to the autopilot.
        stop_s: how long the follower's process stands still.
        kill: whether it is killed.
        moves_stick: whether the pilot moves a stick.
        scene: keys of the scenario that differ.
        starts: parameters that the autopilot is started with, by flavour.
        sets: parameters that are changed in flight, by flavour; whole numbers are PX4's integers.
        flavours: which autopilots can do it.
    """

    must: str
    codes: tuple[int, ...] = ()
    pilot: Callable[[Relay], Iterator[None]] | None = None
    stays_down: bool = False
    to_the_end: bool = False
    mode: Mapping[str, str] = field(default_factory=dict)
    lose_s: float = 0.0
    ways: tuple[str, ...] = ("down", "up")
    stop_s: float = 0.0
    kill: bool = False
    moves_stick: bool = False
    scene: Mapping[str, Any] = field(default_factory=dict)
    starts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    sets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    flavours: tuple[str, ...] = ("ardupilot", "px4")

    @property
    def may_follow(self) -> bool:
        """Whether following on, or again, is right."""
        return set(FOLLOWED) <= set(self.codes)


def takes_off(relay: Relay) -> Iterator[None]:
    """Arm, climb, hover, and give consent by the mode."""
    px4 = relay.flavour == "px4"
    yield from relay.arm_in("TAKEOFF" if px4 else "LOITER")
    relay.sticks = (0.0, 0.0, 0.6, 0.0)
    yield from relay.until(lambda: relay.height_m > _CLIMBED_M)
    relay.sticks = (0.0, 0.0, 0.0, 0.0)
    yield from relay.pause(3.0)
    yield from relay.give_consent()


def disarms(relay: Relay) -> Iterator[None]:
    """Arm on the ground, give consent there, and disarm."""
    yield from relay.arm_in("POSCTL" if relay.flavour == "px4" else "LOITER")
    yield from relay.give_consent()
    yield from relay.pause(3.0)
    relay.arm(False)
    yield from relay.until(lambda: not relay.armed)


_JOYSTICK = {"COM_RC_IN_MODE": 1, "COM_RC_OVERRIDE": 3}
_ENDED = (*RELEASED, *HANDED_OVER)
_ANY = (*FOLLOWED, *_ENDED)
EXERCISES = {
    "pilot-mode": Exercise(
        "handed over at once", HANDED_OVER, mode={"px4": "LOITER", "ardupilot": "LOITER"}
    ),
    "pilot-stick": Exercise(
        "handed over at once", HANDED_OVER, moves_stick=True, starts={"px4": _JOYSTICK}
    ),
    "pilot-takes-off": Exercise(
        "waits for the mode, follows, is handed over",
        HANDED_OVER,
        pilot=takes_off,
        mode={"px4": "LOITER", "ardupilot": "LOITER"},
        starts={"px4": {"MIS_TAKEOFF_ALT": 6.0}},
    ),
    "disarmed-on-ground": Exercise(
        "nothing lifts off",
        _ANY,
        pilot=disarms,
        stays_down=True,
        starts={"px4": _JOYSTICK},
    ),
    "ground-station-rtl": Exercise(
        "handed over at once", HANDED_OVER, mode={"px4": "RTL", "ardupilot": "RTL"}
    ),
    "ground-station-land": Exercise(
        "handed over at once", HANDED_OVER, mode={"px4": "LAND", "ardupilot": "LAND"}
    ),
    "link-1s": Exercise("held, then released", _ENDED, lose_s=1.3),
    "link-3s": Exercise("held, then released", _ENDED, lose_s=3.0),
    "link-10s": Exercise("held, then released", _ENDED, lose_s=10.0),
    "telemetry-1s": Exercise(
        "held; may follow again", (*FOLLOWED, *RELEASED), lose_s=1.0, ways=("down",)
    ),
    "telemetry-3s": Exercise("held, then released", RELEASED, lose_s=3.0, ways=("down",)),
    "telemetry-10s": Exercise("held, then released", RELEASED, lose_s=10.0, ways=("down",)),
    "setpoints-1s": Exercise(
        "the autopilot holds by itself; released or followed on", _ANY, lose_s=1.0, ways=("up",)
    ),
    "setpoints-3s": Exercise("released", _ENDED, lose_s=3.0, ways=("up",)),
    "setpoints-10s": Exercise("released", _ENDED, lose_s=10.0, ways=("up",)),
    **{
        f"wind-{speed}": Exercise(
            "follows, or falls behind and holds", _ANY, to_the_end=True, scene={"wind": wind}
        )
        for speed in (4, 8, 12)
        for wind in [{"mean_m_s": float(speed), "from_deg": 60.0, "gust_m_s": 0.2 * speed}]
    },
    "vision-stalls": Exercise(
        "held, then released",
        RELEASED,
        scene={"faults": [{"kind": "silent", "from_s": 17.0}]},
    ),
    "stopped-0.5s": Exercise("follows on or again", (*FOLLOWED, *RELEASED), stop_s=0.5),
    "stopped-4s": Exercise("released", _ENDED, stop_s=4.0),
    "killed": Exercise("the autopilot holds or goes home by itself", kill=True),
    "killed-defaults": Exercise(
        "the same with the autopilot's own time-out",
        kill=True,
        starts={"ardupilot": {"GUID_TIMEOUT": 3}, "px4": {"COM_OF_LOSS_T": 1.0}},
    ),
    "gps-lost": Exercise(
        "held or handed over",
        _ENDED,
        sets={
            "ardupilot": {"SIM_GPS1_ENABLE": 0, "SIM_GPS_DISABLE": 1},
            "px4": {"SIM_GPS_USED": 0},
        },
    ),
    "gps-glitch": Exercise(
        "held, released or followed on",
        _ANY,
        sets={"ardupilot": {"SIM_GPS1_GLTCH_X": 0.0003, "SIM_GPS_GLITCH_X": 0.0003}},
        flavours=("ardupilot",),
    ),
    "compass-error": Exercise(
        "held, released or followed on",
        _ANY,
        sets={
            "ardupilot": {"SIM_MAG1_OFS_X": 300.0, "SIM_MAG1_OFS_Y": 300.0},
            "px4": {"SIM_MAG_OFFSET_X": 0.3, "SIM_MAG_OFFSET_Y": 0.3},
        },
    ),
    "battery-failsafe": Exercise(
        "handed over to the autopilot's failsafe",
        _ENDED,
        sets={
            "ardupilot": {"SIM_BATT_VOLTAGE": 10.5},
            "px4": {"SIM_BAT_MIN_PCT": 5.0, "SIM_BAT_DRAIN": 5.0},
        },
        starts={
            "ardupilot": {"BATT_LOW_VOLT": 11.5, "BATT_LOW_TIMER": 1, "BATT_FS_LOW_ACT": 2},
            "px4": {"SIM_BAT_ENABLE": 1, "SIM_BAT_MIN_PCT": 90.0, "COM_LOW_BAT_ACT": 2},
        },
    ),
    "fence": Exercise(
        "the autopilot's fence stops it",
        _ANY,
        sets={"ardupilot": {"FENCE_RADIUS": 31}, "px4": {"GF_MAX_HOR_DIST": 31.0}},
        starts={
            "ardupilot": {
                "FENCE_TYPE": 2,
                "FENCE_ACTION": 1,
                "FENCE_ENABLE": 1,
                "FENCE_RADIUS": 200,
            },
            "px4": {"GF_ACTION": 2, "GF_MAX_HOR_DIST": 200.0},
        },
    ),
}


class Relay:
    """Carries packets between an autopilot and the follower, and speaks as a ground station."""

    def __init__(
        self,
        program: SitlProgram,
        scenario: Scenario,
        autopilot: UdpTransport,
        follower_port: int,
    ) -> None:
        self.clock = MonotonicClock()
        self._gusts = Gusts(program, (), World(scenario), autopilot, self.clock)
        self.flavour = program.flavour
        self._autopilot = autopilot
        self._follower = WireTap(UdpTransport.connect("127.0.0.1", follower_port), self.clock)
        self._codec = mavlink.MAVLink(None, _GROUND_STATION, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self.lost_until_s = {"down": -math.inf, "up": -math.inf}
        self.sticks: tuple[float, float, float, float] | None = None
        """Where they go: roll, pitch, throttle, yaw, within ±1; None: the transmitter is off."""
        self._sticks = _AT_REST
        self.begun_s: float | None = None
        self.speed_m_s = self.height_m = self.highest_m = 0.0
        self.obeys = self.armed = False
        self.slow_since_s: float | None = None
        self._fast_since_s = math.inf
        self._sticks_due_s = 0.0
        firmware = FIRMWARE[program.flavour]
        self._consent = firmware.setpoint_mode
        self._mode = firmware.modes[firmware.setpoint_mode].custom_mode
        self._system = 1

    @property
    def fast_for_s(self) -> float:
        """How long it has flown fast by setpoints, s."""
        return self.clock.now() - self._fast_since_s

    def step(self) -> float:
        """Carry what has come, and return the time, s."""
        now_s = self.clock.now()
        self._gusts.step(self._system)
        data = self._autopilot.receive()
        for message in self._parser.parse_buffer(data) or []:
            self._look(message, now_s)
        if data and now_s > self.lost_until_s["down"]:
            self._follower.send(data)
        data = self._follower.receive()
        if data and now_s > self.lost_until_s["up"]:
            self._autopilot.send(data)
        moves = self.obeys and self.speed_m_s > _FAST_M_S
        self._fast_since_s = min(self._fast_since_s, now_s) if moves else math.inf
        if self.sticks is not None and now_s > self._sticks_due_s:
            self._sticks_due_s = now_s + _STICKS_S
            # By and by: PX4 takes a jump for noise, and three steps the same way for a pilot.
            steps = ((to - at, at) for to, at in zip(self.sticks, self._sticks, strict=True))
            moved = [at + min(max(off, -_STICK_STEP), _STICK_STEP) for off, at in steps]
            self._sticks = moved[0], moved[1], moved[2], moved[3]
            self._send_sticks(*self._sticks)
        return now_s

    def _look(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "LOCAL_POSITION_NED":
            self.speed_m_s = math.hypot(message.vx, message.vy, message.vz)
            self.height_m = -message.z
            self.highest_m = max(self.highest_m, self.height_m)
            slow = self.speed_m_s < _STANDS_M_S
            self.slow_since_s = (self.slow_since_s or now_s) if slow else None
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self._system = message.get_srcSystem()
            self.obeys = message.custom_mode == self._mode
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _send_sticks(self, roll: float, pitch: float, throttle: float, yaw: float) -> None:
        """Send them as a ground station's joystick, which both take for the pilot's."""
        if self.flavour == "px4":
            moved = [round(1000 * x) for x in (pitch, roll, (throttle + 1) / 2, yaw)]
            self._send(mavlink.MAVLink_manual_control_message(self._system, *moved, 0))
            return
        pulses = [round(1500 + 500 * x) for x in (roll, -pitch, throttle, yaw)]
        self._send(mavlink.MAVLink_rc_channels_override_message(self._system, 1, *pulses, *[0] * 4))

    def until(self, reached: Callable[[], bool]) -> Iterator[None]:
        """Wait, a step at a time."""
        while not reached():
            yield

    def pause(self, length_s: float) -> Iterator[None]:
        """Wait so many seconds."""
        end_s = self.clock.now() + length_s
        yield from self.until(lambda: self.clock.now() > end_s)

    def arm_in(self, mode: str) -> Iterator[None]:
        """Take a mode and arm, again and again until it is."""
        self.sticks = _AT_REST
        while not self.armed:
            self.order(mode)
            self.arm(True)
            yield from self.pause(_AGAIN_S)

    def give_consent(self) -> Iterator[None]:
        """Take the mode that flies setpoints, again and again until it is."""
        while not self.obeys:
            self.order(self._consent)
            yield from self.pause(_AGAIN_S)

    def order(self, mode: str) -> None:
        """Order a mode as a ground station."""
        params = set_mode_params(_AUTOPILOTS[self.flavour], mode)
        self._command(mavlink.MAV_CMD_DO_SET_MODE, *params)

    def arm(self, armed: bool) -> None:
        """Arm or disarm as a ground station."""
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, float(armed))

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter as a ground station; PX4 takes an integer's bits for a float."""
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int) and self.flavour == "px4":
            kind = mavlink.MAV_PARAM_TYPE_INT32
            (value,) = struct.unpack("<f", struct.pack("<i", value))
        self._send(mavlink.MAVLink_param_set_message(self._system, 1, name.encode(), value, kind))

    def _command(self, command: int, *params: float) -> None:
        padded = (*params, *(0.0,) * (7 - len(params)))
        self._send(mavlink.MAVLink_command_long_message(self._system, 1, command, 0, *padded))

    def _send(self, message: Any) -> None:
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
    with tempfile.TemporaryDirectory() as text, closing(program.listen()) as autopilot:
        folder = Path(text)
        path = folder / "fault.yaml"
        keys = {**yaml.safe_load(SCENE.read_text("utf-8")), **exercise.scene}
        path.write_text(yaml.safe_dump(keys), "utf-8")
        scenario = load_scenario(path)
        parameters = program.for_scenario(scenario, program.usual_parameters())
        parameters |= exercise.starts.get(program.flavour, {})
        with closing(UdpTransport.listen("127.0.0.1", 0)) as free:
            port = free.port
        relay = Relay(program, scenario, autopilot, port)
        with (
            closing(relay),
            AutopilotProcess(program, SitlSetup(1.0, parameters), folder),
            (folder / "follower.txt").open("w") as output,
        ):
            command = [sys.executable, "-c", "from follower.apps.main import main; main()"]
            command += ["sim", str(path), "--autopilot", "external"]
            command += ["--connect", f"udpin:127.0.0.1:{port}", "--vision", "truth+noise"]
            command += ["--out", str(folder / "runs"), "--no-video", "--no-record"]
            command += [] if exercise.pilot is None else ["--set", "autonomy=pilot"]
            process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
            try:
                _fly(relay, process, exercise)
            finally:
                process.kill()
                process.wait()
        said = (folder / "follower.txt").read_text()
    if relay.begun_s is None:
        return [f"it never came so far; the follower's output ends: {said[-200:]}"]
    return list(_wrong(relay, process.returncode, exercise, relay.begun_s, said))


def _fly(relay: Relay, process: subprocess.Popen[bytes], exercise: Exercise) -> None:
    """Relay to the end."""
    script = _script(relay, process, exercise)
    lasts_s, asked = _AFTERWARDS_S + exercise.lose_s, False
    while True:
        now_s = relay.step()
        next(script, None)
        if relay.begun_s is None:
            if now_s > _PATIENCE_S or process.poll() is not None:
                return
        elif now_s > relay.begun_s + lasts_s:
            ended = process.poll() is not None or exercise.kill
            if not ended and not asked:
                asked = True
                process.send_signal(signal.SIGINT)  # one that follows again ends as asked
            if ended or now_s > relay.begun_s + lasts_s + 2 * _AFTERWARDS_S:
                return
        time.sleep(0.002)


def _script(relay: Relay, process: subprocess.Popen[bytes], exercise: Exercise) -> Iterator[None]:
    """Do it, a step at a time: the pilot's part, the wait for a fast flight, the act."""
    if exercise.moves_stick:
        relay.sticks = _AT_REST
    if exercise.pilot is not None:
        yield from exercise.pilot(relay)
    if exercise.to_the_end:
        yield from relay.until(lambda: process.poll() is not None)
    elif not exercise.stays_down:
        yield from relay.until(lambda: relay.fast_for_s > _STEADY_S)
    relay.begun_s = now_s = relay.clock.now()
    if exercise.mode:
        relay.order(exercise.mode[relay.flavour])
    if exercise.moves_stick:
        relay.sticks = (0.0, 0.9, -1.0, 0.0)
    for way in exercise.ways if exercise.lose_s else ():
        relay.lost_until_s[way] = now_s + exercise.lose_s
    for name, value in exercise.sets.get(relay.flavour, {}).items():
        relay.set_parameter(name, value)
    if exercise.kill:
        process.kill()
    if exercise.stop_s:
        os.kill(process.pid, signal.SIGSTOP)
        yield from relay.pause(exercise.stop_s)
        os.kill(process.pid, signal.SIGCONT)


def _wrong(relay: Relay, code: int, exercise: Exercise, begun_s: float, said: str) -> Iterator[str]:
    evidence, limits = relay.evidence(), load_settings().envelope
    yield from envelope_failures(evidence.setpoints, limits, limits.max_interval_s)
    yield from heartbeat_failures(evidence)
    if "Traceback" in said:
        yield f"an uncaught error: {said[-300:]}"
    follows_on = code == 130 and exercise.may_follow
    if exercise.codes and code not in exercise.codes and not follows_on:
        yield f"exit code {code}, wanted one of {exercise.codes}"
    if exercise.stays_down:
        if relay.highest_m > _ON_GROUND_M:
            yield f"it rose to {relay.highest_m:.1f} m"
        if any(not setpoint.is_zero for setpoint in evidence.setpoints):
            yield "a velocity was sent to a vehicle on the ground"
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
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("name", nargs="*", help=f"of {', '.join(EXERCISES)}; all by default")
    names = parser.parse_args().name or list(EXERCISES)
    unknown = [name for name in names if name not in EXERCISES]
    if unknown:
        parser.error(f"there is no {unknown[0]!r}: choose from {', '.join(EXERCISES)}")
    try:
        found = programs(None, None, None, None)
    except SettingsError as error:
        parser.error(str(error))
    failed = 0
    for program in found:
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
