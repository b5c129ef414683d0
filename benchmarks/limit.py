"""How close a pursuit is to the best possible, and which part costs how much.

    python benchmarks/limit.py [--runs 24] [--campaign standard] [--jobs 2] [--out runs/limit]

Flies the first runs of a campaign without pixels and without cover, as they are and with one part
after the other replaced by the truth: the camera (no delay), the box (no noise), both, and the
estimate of the target (the true place and velocity at the time of the setpoint). Then it plans the
same pursuits, from the same places and by the model of `configs/vehicles`, under the envelope's
limits:

- `present`: every 0.2 s for the next 3 s, with the target's true place, velocity and turn now;
- `future`: for the next 8 s, with its true way.

Both minimise the squares of the line-of-sight error and of the logarithm of the range. A flight is
scored by the true box's middle, which it holds, a plan and the true estimate by the body's. The
plans have no wind.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import command_line
import cv2
import numpy as np
import numpy.typing as npt
from rich.progress import track as progress
from scipy.linalg import toeplitz
from scipy.optimize import lsq_linear
from scipy.signal import step as step_response

from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.ground_truth import stopped_s
from follower.simulation.runners import fly_lockstep
from follower.tuning.tune.run import find_vehicle
from follower.workers import Engine, LocalEngine
from follower_control.common.transport import MemoryTransport
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.target.estimate import TargetEstimate, reproject
from follower_control.tuning.response_model import ResponseModel
from follower_control.vehicle.state import VehicleState
from follower_sim.scoring.score import line_of_sight_errors
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

Floats = npt.NDArray[np.float64]
JobT = TypeVar("JobT")
ResultT = TypeVar("ResultT")
NO_COVER = ("occlusions.hidden_s=0", "lookalikes.count=0")
NO_DELAY = ("camera.latency_s=0", "camera.latency_jitter_s=0")
NO_NOISE = ("stand_in.centre_noise=0", "stand_in.size_noise=0")
PARTS: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "camera without delay": NO_DELAY,
    "box without noise": NO_NOISE,
    "both": NO_DELAY + NO_NOISE,
    "true estimate": (),
}
STEP_S = 0.2
PLANS = {"present": (15, False), "future": (40, True)}
"""Steps ahead, and whether the target's way is known or foreseen."""
WEIGHTS = np.array([1.0, 1.0, 0.5])
"""A range that is wrong by a tenth counts as a line of sight that is off by 2.9 degrees."""
SMOOTH = 1e-3
GAUSS_NEWTON = 2


@dataclass(frozen=True, slots=True, eq=False)
class Pursuit:
    """The scored part of a flight, every `STEP_S`.

    Attributes:
        target: (N, 6) place and velocity, north, east, down.
        start: (8,) the vehicle's place, velocity, yaw and yaw rate at its beginning.
        errors: (N, 2) line of sight, rad, and the logarithm of range over wanted range.
        in_frame: (N,) whether half the target was in the image.
        wanted: distance, m, and elevation, rad.
        half_view: half the camera's field of view, across and down, rad.
        autopilot: whose model it is planned with.
    """

    target: Floats
    start: Floats
    errors: Floats
    in_frame: Floats
    wanted: tuple[float, float]
    half_view: tuple[float, float]
    autopilot: str


def know_all(flight: SimulatedFlight, world: World, clock: SimulatedClock) -> None:
    """Let control know where the target is, and how it moves, at each time."""
    pursuit, number = flight.stage.servo.pursuit, world.scenario.followed
    believed = pursuit.world_estimate

    def known(estimate: TargetEstimate, vehicle: VehicleState) -> TargetEstimate:
        estimate, now_s = believed(estimate, vehicle), clock.now()
        body, velocity = (
            flight.vehicle.state_at(now_s),
            world.target_pose(number, now_s).velocity_m_s,
        )
        away = np.subtract(world.target_centre(number, now_s), body.position_m)
        pursuit._velocity_m_s = np.array(velocity)
        size_m = pursuit._size_m or 1.0
        return reproject(estimate, away, np.subtract(velocity, body.velocity_m_s), size_m)

    pursuit.world_estimate = known  # type: ignore[method-assign]


def fly(spec: RunSpec, part: str) -> Pursuit | None:
    """Fly a run with a part replaced; None if it never came to the wanted place."""
    cv2.setNumThreads(1)
    spec = replace(spec, scene=(*spec.scene, *NO_COVER, *PARTS[part]))
    options = spec.options()
    scenario, settings = options.resolve()
    world, clock, ends = World(scenario, spec.seed), SimulatedClock(), MemoryTransport.pair()
    extras = FlightOptions(vision=options.vision)
    flight = SimulatedFlight(world, settings, spec.autopilot, clock, ends, extras)
    if part == "true estimate":
        know_all(flight, world, clock)
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    score, end_s = flight.score(), stopped_s(flight.log.controls) or math.inf
    flown = [sample for sample in flight.truth if sample.time_s <= end_s]
    if score.approach_s is None or flight.goal.distance_m is None:
        return None
    from_s = flown[-1].time_s - score.scored_s - 1e-6
    every = max(1, round(STEP_S * settings.control_rate_hz))
    samples = [sample for sample in flown if sample.time_s >= from_s][::every]
    shown = samples
    if part != "true estimate":
        sights = [flight.ground_truth.box_direction(sample) for sample in samples]
        shown = [
            replace(sample, azimuth_rad=one.azimuth_rad, elevation_rad=one.elevation_rad)
            for sample, one in zip(samples, sights, strict=True)
        ]
    ranges = np.array([sample.range_m for sample in samples])
    body, camera = samples[0].vehicle, scenario.camera
    across = math.radians(camera.fov_deg) / 2
    return Pursuit(
        np.array([[*s.target_position_m, *s.target_velocity_m_s] for s in samples]),
        np.array([*body.position_m, *body.velocity_m_s, body.yaw_rad, 0.0]),
        np.column_stack(
            [line_of_sight_errors(shown, flight.goal), np.log(ranges / flight.goal.distance_m)]
        ),
        np.array([sample.in_frame_share >= 0.5 for sample in samples], float),
        (flight.goal.distance_m, flight.goal.elevation_rad or 0.0),
        (across, math.atan(math.tan(across) * camera.height / camera.width)),
        spec.autopilot,
    )


class Planner:
    """Plans one pursuit by the model of its vehicle: Gauss-Newton with bounded accelerations.

    Args:
        pursuit: from where, and after what.
        limits: of the setpoints, each axis by itself; those on jerk are left out. Both make a plan
            no worse.
    """

    def __init__(self, pursuit: Pursuit, limits: EnvelopeSettings) -> None:
        self._pursuit = pursuit
        self.steps = len(pursuit.target)
        model = find_vehicle(pursuit.autopilot).model()
        axes = (model.forward, model.forward, model.down, model.yaw_rate)
        zeros = np.zeros(self.steps)
        # From what is asked for to places and yaw: velocities and yaw rates, summed up.
        self._moves = [
            STEP_S * np.cumsum(toeplitz(impulses(one, self.steps), zeros), axis=0) for one in axes
        ]
        self._start = np.array([*pursuit.start[:3], pursuit.start[6]])
        self._before = np.array([*pursuit.start[3:6], pursuit.start[7]])
        self._fastest = np.array(
            [limits.max_speed_m_s] * 2
            + [max(limits.max_climb_m_s, limits.max_descent_m_s)]
            + [math.radians(limits.max_yaw_rate_deg_s)]
        )
        turn = math.radians(limits.max_yaw_acceleration_deg_s2)
        self._hardest = np.array([limits.max_acceleration_m_s2] * 3 + [turn])
        self.asked = np.tile(self._before, (self.steps, 1))

    def fly(self, horizon_steps: int, knows_future: bool) -> Floats:
        """Plan every `STEP_S` for so many steps; return azimuth, elevation, log range, (N, 3)."""
        known = self._pursuit.target
        for first in range(self.steps):
            last = min(first + horizon_steps, self.steps)
            self.asked[last - 1 :] = self.asked[max(last - 2, 0)]
            target = known[first:last, :3] if knows_future else foreseen(known, first, last)
            for _ in range(GAUSS_NEWTON):
                self._improve(target, first, last)
        return self._errors(self._places(0, self.steps), known[:, :3])

    def _places(self, first: int, last: int) -> Floats:
        """Return place and yaw, (last - first, 4), under what is asked for."""
        times = STEP_S * np.arange(first + 1, last + 1)
        changes = self.asked[:last] - self._before
        moved = [self._moves[k][first:last, :last] @ changes[:, k] for k in range(4)]
        places: Floats = self._start + np.outer(times, self._before) + np.column_stack(moved)
        return places

    def _errors(self, places: Floats, target: Floats) -> Floats:
        away = target - places[:, :3]
        azimuth = np.arctan2(away[:, 1], away[:, 0]) - places[:, 3]
        distance_m, wanted = self._pursuit.wanted
        return np.column_stack(
            [
                np.arctan2(np.sin(azimuth), np.cos(azimuth)),
                np.arctan2(-away[:, 2], np.hypot(away[:, 0], away[:, 1])) - wanted,
                np.log(np.linalg.norm(away, axis=1) / distance_m),
            ]
        )

    def _improve(self, target: Floats, first: int, last: int) -> None:
        """Solve for the accelerations with the errors made linear about the present plan."""
        count = last - first
        before = self.asked[first - 1] if first else self._before
        accelerations = np.diff(self.asked[first:last], axis=0, prepend=before[None]) / STEP_S
        summed = STEP_S * np.tri(count)
        places = self._places(first, last)
        residuals = (self._errors(places, target) * WEIGHTS).T.ravel()
        rows = [
            np.hstack(
                [weight * slope[:, None] * self._moves[k][first:last, first:last] @ summed
                 for k, slope in enumerate(row)]
            )
            for weight, row in zip(WEIGHTS, slopes(target - places[:, :3]), strict=True)
        ]  # fmt: skip
        over = np.clip(self.asked[first:last], -self._fastest, self._fastest)
        too_fast = (self.asked[first:last] - over).T.ravel()
        speed_rows = (too_fast != 0)[:, None] * np.kron(np.eye(4), summed)
        jacobian = np.vstack([*rows, speed_rows, SMOOTH * np.eye(4 * count)])
        wanted = np.concatenate([residuals, too_fast, SMOOTH * accelerations.T.ravel()])
        at, most = accelerations.T.ravel(), np.repeat(self._hardest, count)
        at = np.clip(at, -0.999 * most, 0.999 * most)
        solved = lsq_linear(jacobian, jacobian @ at - wanted, (-most, most), "trf", tol=1e-5)
        self.asked[first:last] = before + summed @ solved.x.reshape(4, -1).T


def slopes(away: Floats) -> tuple[tuple[Floats, ...], ...]:
    """Return how azimuth, elevation and log range change with our place and yaw, (N,) each.

    Args:
        away: (N, 3) from us to the target.
    """
    north, east, down = away.T
    level = np.hypot(north, east)
    range2, none = level**2 + down**2, np.zeros(len(away))
    steep = down / (level * range2)
    return (
        (east / level**2, -north / level**2, none, none - 1.0),
        (-north * steep, -east * steep, level / range2, none),
        (-north / range2, -east / range2, -down / range2, none),
    )


def impulses(model: ResponseModel, steps: int) -> Floats:
    """Return by how much the answer to a unit step grows in each `STEP_S`."""
    linear = model.linear
    times = np.arange(0.0, (steps + 1) * STEP_S, STEP_S / 10)
    _, values = step_response(
        (np.atleast_1d(linear.numerator), np.atleast_1d(linear.denominator)), T=times
    )
    edges = np.arange(steps + 1) * STEP_S - model.dead_time_s
    return np.diff(np.interp(edges, times, values, left=0.0))


def foreseen(known: Floats, first: int, last: int) -> Floats:
    """Return places (last - first, 3) of a target that keeps its present speed and turn."""
    place, velocity = known[first, :3], known[first, 3:]
    was = known[max(0, first - 1), 3:]
    course = complex(velocity[0], velocity[1])
    turn = np.angle(course * complex(was[0], -was[1])) / STEP_S if abs(course) > 0.5 else 0.0
    ahead = STEP_S * np.arange(last - first)
    level = np.cumsum(course * np.exp(1j * turn * ahead)) * STEP_S - STEP_S * course
    moved = np.column_stack([level.real, level.imag, velocity[2] * ahead])
    return np.asarray(place + moved)


def planned_figures(pursuit: Pursuit, which: str) -> Floats:
    """Return line of sight, rad, log range and "in frame" of a plan, (N, 3)."""
    planner = Planner(pursuit, EnvelopeSettings())
    errors = planner.fly(*PLANS[which])
    azimuth, elevation, log_range = errors.T
    across, down = pursuit.half_view
    seen = (np.abs(azimuth) < across) & (np.abs(elevation) < down)
    sight = np.hypot(azimuth * math.cos(pursuit.wanted[1]), elevation)
    return np.column_stack([sight, log_range, seen])


def flown_figures(pursuit: Pursuit) -> Floats:
    """Return the same of a flight."""
    return np.column_stack([pursuit.errors, pursuit.in_frame])


def main() -> None:
    """Measure, and print a table."""
    parser = command_line.parser(__doc__)
    parser.add_argument("--campaign", default="standard", help="name or file")
    parser.add_argument("--runs", type=command_line.count, default=24, help="how many of its runs")
    parser.add_argument("--jobs", type=command_line.count, default=2, help="processes")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/limit"), help="folder of the figures"
    )
    options = parser.parse_args()
    campaign = load_campaign(options.campaign).model_copy(update={"vision": "truth+noise"})
    specs = list(planned(campaign))[: options.runs]
    rows: dict[str, list[Floats]] = {}
    with closing(LocalEngine(options.jobs)) as engine:
        flights: dict[str, list[Pursuit]] = {}
        for part in PARTS:
            flown = in_order(engine, partial(fly, part=part), specs, part)
            flights[part] = [one for one in flown if one is not None]
            rows[part] = [flown_figures(one) for one in flights[part]]
        for which in PLANS:
            plan = partial(planned_figures, which=which)
            rows[which] = in_order(engine, plan, flights["as it is"], f"knows the {which}")
    table = {name: summary(figures) for name, figures in rows.items()}
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "limit.json").write_text(json.dumps(table, indent=1), "utf-8")
    show(table)


def in_order(
    engine: Engine, do: Callable[[JobT], ResultT], jobs: list[JobT], title: str
) -> list[ResultT]:
    """Do jobs, and return their results in their order."""
    done = list(progress(engine.run(do, jobs), title, total=len(jobs)))
    return [one.result for one in sorted(done, key=lambda one: jobs.index(one.job))]


def summary(figures: Sequence[Floats]) -> dict[str, float]:
    """Return root mean squares over all of the time, and the median run's."""
    sight, log_range, seen = np.concatenate(figures).T
    return {
        "runs": len(figures),
        "line_of_sight_deg": math.degrees(rms(sight)),
        "line_of_sight_median_deg": math.degrees(np.median([rms(one[:, 0]) for one in figures])),
        "range_share": rms(np.expm1(log_range)),
        "in_frame": float(seen.mean()),
    }


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def show(table: dict[str, dict[str, float]]) -> None:
    """Print it, with ratios of what is flown to both limits."""
    ours = table["as it is"]
    print(f"{'':22} line of sight   median run   range     in frame   as it is over this one")
    for name, row in table.items():
        ratio = ours["line_of_sight_deg"] / row["line_of_sight_deg"]
        ranges = ours["range_share"] / row["range_share"]
        print(
            f"{name:22} {row['line_of_sight_deg']:8.2f} deg {row['line_of_sight_median_deg']:10.2f}"
            f" {100 * row['range_share']:8.1f} % {100 * row['in_frame']:9.2f} %"
            f"     {ratio:.2f}, {ranges:.2f}"
        )


if __name__ == "__main__":
    command_line.run(main)
