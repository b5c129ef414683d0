"""Does linear theory say what the whole simulator does?

    python benchmarks/closed_loop.py [px4|ardupilot] [--vision truth+noise] [--axis range]
    python benchmarks/closed_loop.py ardupilot --vision truth+noise --real --vehicle runs/identify

A car stands; the vehicle holds its direction and distance. What is wanted of one loop is shaken by
a sum of sines, and the true answer is compared with `axis_loop`: bandwidth (-3 dB). Then the loop's
gains are multiplied until it keeps swinging after a kick: the onset of oscillation, looked for by
halving. With pixels (the default: rendered frames, tracker and all) the onset is only asked at 25 %
below and above the prediction.

The vehicle's model is that of `configs/vehicles`, or of --vehicle, which `follower excite` and
`follower identify` made; nothing is fitted to what is measured here. With --real the program that
ARDUCOPTER_SITL or PX4_SITL names is flown, as `follower sitl` does, three times as fast as time.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import command_line
import cv2
import numpy as np
import numpy.typing as npt
import yaml

from follower.apps.sitl.run import programs
from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import Settings, load_settings
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import EXTERNAL, VisionSource
from follower.simulation.runners import fly_lockstep, fly_realtime
from follower.simulation.sitl.process import BOOTS_WITHIN_S, AutopilotProcess
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower.tuning.identify.result import VehicleFile
from follower.tuning.tune.run import find_vehicle
from follower_control.common.transport import MemoryTransport, Transport
from follower_control.servo.pid import PidSettings
from follower_control.servo.pursuit_state import Reference
from follower_control.tuning.axes import Axis, LoopSettings, axis_loop
from follower_control.tuning.axis_loop import AxisLoop, Conditions
from follower_control.tuning.rational import Array
from follower_control.tuning.response_model import VehicleModel
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings
from follower_sim.world.world import World
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock

SPEEDUP = 3.0
SETTLE_S = 8.0
MEASURE_S = {"azimuth": 45.0, "elevation": 55.0, "range": 75.0}
ONSET_S = 26.0
SHARES = (0.55, 0.8, 1.0, 1.25, 1.6)
AMPLITUDES = {Axis.AZIMUTH: math.radians(1.0), Axis.ELEVATION: math.radians(0.7), Axis.RANGE: 0.025}
KICKS = {Axis.AZIMUTH: math.radians(5), Axis.ELEVATION: math.radians(3), Axis.RANGE: 0.08}
QUIET = {Axis.AZIMUTH: math.radians(0.4), Axis.ELEVATION: math.radians(0.3), Axis.RANGE: 0.012}
"""A swing that is smaller is noise."""
STANDING = """
{name: standing, title: A car stands., duration_s: 1000, seed: 5,
 ground: {kind: meadow}, sky: {},
 targets: [{kind: car, colour: "#e0401c", path: {points: [[0, 0], [0, 5]]}}],
 camera: {pitch_deg: -22, fov_deg: 75},
 start: {at: [-13, 0], heading_deg: 0}, takeoff_height_m: 6.3,
 select: {colour: "#e0401c"},
 stand_in: {centre_noise: 0, size_noise: 0},
 follow: {servo: {distance_m: 14, elevation_deg: -24}}}
"""

Gains = Mapping[Axis, PidSettings]
Wobble = Callable[[float], dict[Axis, float]]


@dataclass(frozen=True)
class Answer:
    """The truth over time since the shaking began: times (N,), values by axis (N,)."""

    time_s: Array
    values: dict[Axis, Array]
    range_m: float
    elevation_rad: float
    kept: bool


@dataclass(frozen=True)
class Subject:
    """What is flown, and the model that predicts it."""

    flavour: str
    sight: VisionSource
    vehicle: VehicleFile
    program: SitlProgram | None = None


def fly(subject: Subject, gains: Gains, wobble: Wobble, length_s: float) -> Answer:
    """Fly once; `wobble` says by how much what is wanted is off, so long after settling."""
    scenario = Scenario.model_validate(yaml.safe_load(STANDING))
    over: dict[str, Any] = base_settings(scenario)
    settings = load_settings(base=over)
    servo = replace(
        settings.servo,
        azimuth=gains[Axis.AZIMUTH],
        elevation=gains[Axis.ELEVATION],
        range=gains[Axis.RANGE],
    )
    settings = settings.model_copy(update={"servo": servo})
    program, began = subject.program, list[float]()

    def watch() -> None:
        following = flight.stage.supervisor.state is SupervisorState.FOLLOWING
        if following and not began:
            began.append(clock.now() + SETTLE_S)
        if began and clock.now() > began[0] + length_s:
            flight.stop()

    with ExitStack() as stack:
        clock: Clock
        ends: tuple[Transport, Transport] = MemoryTransport.pair()
        boots_within_s = None
        if program is None:
            clock = SimulatedClock()
        else:
            clock, boots_within_s = MonotonicClock(SPEEDUP), BOOTS_WITHIN_S * SPEEDUP
            ends = stack.enter_context(closing(program.listen())), ends[1]
            setup = SitlSetup(SPEEDUP, program.usual_parameters())
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            stack.enter_context(AutopilotProcess(program, setup, folder))
        extras = FlightOptions(vision=subject.sight, boots_within_s=boots_within_s)
        flavour = subject.flavour if program is None else EXTERNAL
        flight = SimulatedFlight(World(scenario, 5), settings, flavour, clock, ends, extras)
        stack.enter_context(closing(flight))
        shake(flight, clock, began, wobble)
        if isinstance(clock, SimulatedClock):
            fly_lockstep(flight, clock, watch)
        else:
            fly_realtime(flight, clock, watch)
    return answer_of(flight, began[0], length_s)


def shake(flight: SimulatedFlight, clock: Clock, began: list[float], wobble: Wobble) -> None:
    """Put what is wanted off, behind the servo's back: its own nudges are slow on purpose."""
    reference: Reference = flight.stage.servo._reference
    step = reference.step

    def shaken(interval_s: float) -> None:
        step(interval_s)
        if began and clock.now() >= began[0]:
            off = wobble(clock.now() - began[0])
            # The next step begins anew from what the settings say.
            reference.distance_m = reference._distance_m * math.exp(off.get(Axis.RANGE, 0.0))
            reference.elevation_rad = reference._elevation_rad + off.get(Axis.ELEVATION, 0.0)
            reference.azimuth_rad = off.get(Axis.AZIMUTH, 0.0)

    reference.step = shaken  # type: ignore[method-assign]


def answer_of(flight: SimulatedFlight, from_s: float, length_s: float) -> Answer:
    """Return the truth while it was shaken."""
    samples = [one for one in flight.truth if from_s <= one.time_s <= from_s + length_s]
    states = [r.state for r in flight.log.controls if from_s <= r.time_s <= from_s + length_s]
    log_range = np.log([one.range_m for one in samples])
    return Answer(
        np.array([one.time_s - from_s for one in samples]),
        {
            Axis.AZIMUTH: np.array([one.azimuth_rad for one in samples]),
            Axis.ELEVATION: np.array([one.elevation_rad for one in samples]),
            Axis.RANGE: log_range,
        },
        float(np.exp(log_range.mean())),
        float(np.mean([one.elevation_rad for one in samples])),
        all(state is SupervisorState.FOLLOWING for state in states),
    )


def loops(
    subject: Subject, settings: Settings, conditions: Conditions, gains: Gains
) -> dict[Axis, AxisLoop]:
    """Return the predictions."""
    model, follower = subject.vehicle.model(), _loop_settings(settings)
    return {axis: standing(axis, gains[axis], model, follower, conditions) for axis in Axis}


def standing(axis: Axis, *loop: Any) -> AxisLoop:
    """Return the loop after a car that stands: for no speed, no more is asked for."""
    return replace(axis_loop(axis, *loop), shortfall=None)


def scaled(gains: PidSettings, factor: float) -> PidSettings:
    """Return all gains times a factor."""
    return replace(gains, kp=factor * gains.kp, ki=factor * gains.ki, kd=factor * gains.kd)


def bandwidth(
    subject: Subject, gains: Gains, conditions: Conditions, settings: Settings, axis: Axis
) -> tuple[float, float]:
    """Shake one loop, print predicted and measured responses, and return both bandwidths."""
    tones = loops(subject, settings, conditions, gains)[axis].bandwidth_rad_s() * np.array(SHARES)
    phases = 2.4 * np.arange(len(SHARES), dtype=np.float64) ** 2

    def wobble(t: float) -> dict[Axis, float]:
        return {axis: min(1.0, t / 3) * AMPLITUDES[axis] * float(np.sin(tones * t + phases).sum())}

    answer = fly(subject, gains, wobble, MEASURE_S[axis])
    seen = replace(conditions, range_m=answer.range_m, elevation_rad=answer.elevation_rad)
    loop = loops(subject, settings, seen, gains)[axis]
    said = np.abs(loop.following(tones))
    got = np.abs(response(answer, axis, tones, phases))
    a, b = crossing(tones, said), crossing(tones, got)
    pairs = "  ".join(f"{w:.2f}: {p:.2f}/{g:.2f}" for w, p, g in zip(tones, said, got, strict=True))
    print(f"  {axis}: bandwidth {a:.2f} predicted, {b:.2f} measured: {100 * (b / a - 1):+.0f} %")
    print(f"    |T| at rad/s, predicted/measured: {pairs}; kept {answer.kept}", flush=True)
    return a, b


def response(answer: Answer, axis: Axis, tones: Array, phases: Array) -> npt.NDArray[np.complex128]:
    """Return the complex answer at each tone, by least squares among all of them."""
    late = answer.time_s > 6.0
    t = answer.time_s[late]
    columns = [np.ones_like(t), t, *np.sin(np.outer(tones, t)), *np.cos(np.outer(tones, t))]
    found = np.linalg.lstsq(np.stack(columns, 1), answer.values[axis][late], rcond=None)[0]
    sines, cosines = np.split(found[2:], 2)
    return np.asarray((sines + 1j * cosines) * np.exp(-1j * phases) / AMPLITUDES[axis])


def crossing(frequency: Array, level: Array) -> float:
    """Return the first -3 dB, between the tones or just beyond them."""
    below = np.flatnonzero(level < math.sqrt(0.5))
    i = min(max(int(below[0]) - 1, 0), len(level) - 2) if len(below) else len(level) - 2
    x, y = np.log(frequency[i : i + 2]), level[i : i + 2]
    return float(np.exp(x[0] + (math.sqrt(0.5) - y[0]) / (y[1] - y[0]) * (x[1] - x[0])))


def raised_loop(
    axis: Axis,
    gains: PidSettings,
    model: VehicleModel,
    follower: LoopSettings,
    conditions: Conditions,
    factor: float,
) -> AxisLoop:
    """Return the linear loop with its gains multiplied."""
    return standing(axis, scaled(gains, factor), model, follower, conditions)


def onset(loop_of: Callable[[float], AxisLoop]) -> float:
    """Return the factor on the gains at which the linear loop becomes unstable."""
    low, high = 0.2, 30.0
    while high / low > 1.005:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if loop_of(middle).is_stable() else (low, middle)
    return low


def swings(subject: Subject, gains: Gains, axis: Axis, factor: float) -> bool:
    """Whether the loop goes on swinging long after a kick."""
    used = {**gains, axis: scaled(gains[axis], factor)}

    def kick(t: float) -> dict[Axis, float]:
        return {axis: KICKS[axis] if 0.5 < t < 1.5 else 0.0}

    answer = fly(subject, used, kick, ONSET_S)
    values, t = answer.values[axis], answer.time_s
    early, late = (values[(t > a) & (t < b)] for a, b in ((3.0, 9.0), (19.0, 26.0)))
    size, before = float(np.std(late)), float(np.std(early))
    print(f"    x{factor:.2f}: {before:.4f} early, {size:.4f} late, kept {answer.kept}", flush=True)
    return size > QUIET[axis] and size > 0.5 * before


def check_onset(subject: Subject, gains: Gains, axis: Axis, predicted: float) -> None:
    """Look for the onset, or with pixels ask beside the prediction alone."""
    print(f"  {axis}: predicted to begin at x{predicted:.2f}")
    if subject.sight is VisionSource.PIXELS:
        below, above = (swings(subject, gains, axis, x * predicted) for x in (0.75, 1.25))
        verdict = "within 25 %" if above and not below else "NOT within 25 %"
        print(f"  {axis}: swings 25 % below: {below}, above: {above}: {verdict}")
        return
    low, high = predicted / 2, predicted * 2
    for _ in range(6):
        middle = math.sqrt(low * high)
        swing = swings(subject, gains, axis, middle)
        low, high = (low, middle) if swing else (middle, high)
    found = math.sqrt(low * high)
    print(f"  {axis}: begins at x{found:.2f}: {100 * (found / predicted - 1):+.0f} %")


def usual(vehicle: VehicleFile) -> tuple[Settings, Conditions, dict[Axis, PidSettings]]:
    """Return the settings, where the loops are looked at, and the gains."""
    scenario = Scenario.model_validate(yaml.safe_load(STANDING))
    settings = load_settings(base=base_settings(scenario))
    delays, follower = vehicle.delays, _loop_settings(settings)
    here = Conditions(delays, 14.0, math.radians(-24), size_m=2.5, acceleration_m_s2=0.3)
    return settings, here, {axis: follower.gains(axis) for axis in Axis}


def predicted_onset(vehicle: VehicleFile, axis: Axis) -> float:
    """Return by what factor the gains may rise, by theory."""
    settings, here, gains = usual(vehicle)
    # The kick asks for all the acceleration that there is.
    harder = replace(here, acceleration_m_s2=settings.envelope.max_acceleration_m_s2)
    model, follower = vehicle.model(), _loop_settings(settings)
    return onset(partial(raised_loop, axis, gains[axis], model, follower, harder))


def _loop_settings(settings: Settings) -> LoopSettings:
    return LoopSettings(settings.servo, settings.estimator, settings.envelope)


def main() -> None:
    """Fly what the command line asks for, and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("flavour", nargs="?", default="px4", choices=("px4", "ardupilot"))
    parser.add_argument("--vision", default="pixels", choices=list(VisionSource))
    parser.add_argument("--axis", action="append", choices=list(Axis))
    parser.add_argument("--vehicle", help="what `follower identify` wrote")
    parser.add_argument("--real", action="store_true", help="fly the real program")
    parser.add_argument("--no-bandwidth", action="store_true")
    parser.add_argument("--no-onset", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    vehicle = find_vehicle(options.vehicle or options.flavour)
    settings, conditions, gains = usual(vehicle)
    subject = Subject(options.flavour, VisionSource(options.vision), vehicle)
    if options.real:
        named = {one.flavour: one for one in programs(None, None, None, None) if one is not None}
        if options.flavour not in named:
            parser.error("--real: name the program in ARDUCOPTER_SITL or PX4_SITL")
        subject = replace(subject, program=named[options.flavour])
    print(f"{options.flavour}, {options.vision}", flush=True)
    for axis in [Axis(one) for one in options.axis or list(Axis)]:
        if not options.no_bandwidth:
            bandwidth(subject, gains, conditions, settings, axis)
        if options.no_onset:
            continue
        check_onset(subject, gains, axis, predicted_onset(vehicle, axis))


if __name__ == "__main__":
    command_line.run(main)
