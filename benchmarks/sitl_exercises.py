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

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import command_line
import yaml
from sitl_relay import AT_REST, Relay

from follower.apps.sitl.run import programs
from follower.settings.settings import load_settings
from follower.simulation.fault_tests.run_fault import SCENE
from follower.simulation.faults.setpoint_rules import envelope_failures, heartbeat_failures
from follower.simulation.sitl.process import AutopilotProcess
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower_control.common.transport import UdpTransport
from follower_sim.scenario.scenario_file import load_scenario

_PATIENCE_S, _AFTERWARDS_S, _STANDS_WITHIN_S = 150.0, 16.0, 9.0
_STEADY_S = 3.0
_CLIMBED_M = 5.0
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
        relay.sticks = AT_REST
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
        if relay.lifted:
            yield "it left the ground"
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
    parser = command_line.parser(__doc__)
    parser.add_argument("name", nargs="*", help=f"of {', '.join(EXERCISES)}; all by default")
    names = parser.parse_args().name or list(EXERCISES)
    unknown = [name for name in names if name not in EXERCISES]
    if unknown:
        parser.error(f"there is no {unknown[0]!r}: choose from {', '.join(EXERCISES)}")
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
    command_line.run(main)
