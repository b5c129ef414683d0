"""How right the estimate of the target in the world is, and whether it knows how right.

    python benchmarks/estimator.py [--first 0] [--runs 20] [--campaign standard] [--jobs 2]

Flies runs of a campaign without pixels. After each sighting the filter's belief is held against the
true target: squared errors over their covariance (NEES) of the horizontal place and velocity, those
of the innovation (NIS), and the error of the way that it foretells, also of one at the velocity
that it believes (constant velocity): while the target is seen, and from the last sight before it is
hidden. A place is the box's middle by what is believed of its size or of the ground, the true one
the body's: their difference is in the place's NEES. A flight is inside if its mean is within the
95 % bounds of one independent sample every `INDEPENDENT_S`.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass

import command_line
import cv2
import numpy as np
import numpy.typing as npt
from rich.progress import track as progress
from scipy.stats import chi2

from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.campaign.metrics import RunMetrics, figures_of
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.workers import LocalEngine
from follower_control.common.transport import MemoryTransport
from follower_control.target.world_filter import TargetWorldFilter
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

Floats = npt.NDArray[np.float64]
AHEAD_S = np.array([0.5, 1.0, 2.0, 4.0])
HIDDEN_S, SETTLED_S, INDEPENDENT_S = 0.5, 3.0, 2.0
Row = tuple[float, Floats, Floats, float, list[Floats], Floats]
"""Time, state, covariance, squared distance, ways foretold, where the filter's origin lies."""
CHECKED = {"place": 2, "velocity": 2, "innovation": 3}
"""Degrees of freedom."""


@dataclass(frozen=True, slots=True, eq=False)
class Beliefs:
    """One flight.

    Attributes:
        times_s: (N,) of the sightings.
        distances2: (N, 3) as in `CHECKED`.
        wrong_m: (N, 4, 2) by what the way foretold and the one at constant velocity is wrong.
        is_last: (N,) whether nothing was seen for a while after it.
        figures: of the pursuit.
    """

    times_s: Floats
    distances2: Floats
    wrong_m: Floats
    is_last: npt.NDArray[np.bool_]
    figures: RunMetrics


def fly(spec: RunSpec) -> Beliefs:
    """Fly a run, and compare."""
    cv2.setNumThreads(1)
    options = spec.options()
    scenario, settings = options.resolve()
    world, clock, ends = World(scenario, spec.seed), SimulatedClock(), MemoryTransport.pair()
    extras = FlightOptions(vision=options.vision)
    flight = SimulatedFlight(world, settings, spec.autopilot, clock, ends, extras)
    pursuit = flight.stage.servo.pursuit
    moving, rows = pursuit._moving, list[Row]()
    observe = moving.observe

    def watched(
        place_m: Floats, noise_m2: Floats, time_s: float, direction: Floats, slow_m: float
    ) -> None:
        distance2 = innovation2(moving, place_m, noise_m2, time_s, direction, slow_m)
        observe(place_m, noise_m2, time_s, direction, slow_m)
        state, there = moving._state, pursuit._own.at(time_s)
        ways = [moving.at(time_s + ahead_s)[0][:2] - state[:2] for ahead_s in AHEAD_S]
        if there is not None and math.isfinite(distance2):
            origin = there - flight.vehicle.state_at(time_s).position_m
            rows.append((time_s, state.copy(), moving._covariance, distance2, ways, origin[:2]))

    moving.observe = watched  # type: ignore[method-assign, assignment]
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    truth = [[s.time_s, *s.target_position_m, *s.target_velocity_m_s] for s in flight.truth]
    return compared(rows, np.array(truth), figures_of(flight))


def compared(rows: list[Row], samples: Floats, figures: RunMetrics) -> Beliefs:
    """Hold what was believed against the truth, (N, 7): time, place, velocity."""

    def true(times_s: Floats, columns: tuple[int, int]) -> Floats:
        return np.column_stack([np.interp(times_s, samples[:, 0], samples[:, k]) for k in columns])

    times_s, states, covariances, innovations, ways, origins = map(
        np.array, zip(*rows, strict=True)
    )
    place, velocity = true(times_s, (1, 2)), true(times_s, (4, 5))
    errors = states[:, :2] - origins - place, states[:, 3:5] - velocity
    nees = [
        np.einsum(
            "ni,ni->n", off, np.linalg.solve(covariances[:, at, at], off[:, :, None])[:, :, 0]
        )
        for off, at in zip(errors, (slice(0, 2), slice(3, 5)), strict=True)
    ]
    went = np.stack([true(times_s + ahead_s, (1, 2)) - place for ahead_s in AHEAD_S], axis=1)
    steady = AHEAD_S[:, None] * states[:, None, 3:5]
    wrong_m = np.stack([np.linalg.norm(way - went, axis=2) for way in (ways, steady)], axis=2)
    wrong_m[times_s[:, None] + AHEAD_S > samples[-1, 0]] = np.nan
    gaps_s = np.diff(times_s, append=times_s[-1])
    kept = times_s > times_s[0] + SETTLED_S
    checked = np.column_stack([*nees, innovations])
    return Beliefs(times_s[kept], checked[kept], wrong_m[kept], (gaps_s > HIDDEN_S)[kept], figures)


def innovation2(
    moving: TargetWorldFilter,
    place_m: Floats,
    noise_m2: Floats,
    time_s: float,
    direction: Floats,
    slow_m: float,
) -> float:
    """Return the squared Mahalanobis distance of a place from what is predicted; NaN at first."""
    if moving.time_s is None or time_s <= moving.time_s:
        return math.nan
    state, covariance = moving._moved(time_s - moving.time_s, direction)
    shows = np.hstack([np.eye(3), np.zeros((3, 3)), slow_m * direction[:, None]])
    off = place_m - shows @ state
    return float(off @ np.linalg.solve(shows @ covariance @ shows.T + noise_m2, off))


def main() -> None:
    """Measure, and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("--campaign", default="standard", help="name or file")
    parser.add_argument("--first", type=int, default=0, help="number of the first run")
    parser.add_argument("--runs", type=command_line.count, default=20, help="how many")
    parser.add_argument("--jobs", type=command_line.count, default=2, help="processes")
    options = parser.parse_args()
    campaign = load_campaign(options.campaign).model_copy(update={"vision": "truth+noise"})
    specs = list(planned(campaign))[options.first : options.first + options.runs]
    if not specs:
        parser.error(f"{options.campaign} has no run {options.first}")
    with closing(LocalEngine(options.jobs)) as engine:
        flights = [
            one.result for one in progress(engine.run(fly, specs), "flights", total=len(specs))
        ]
    show(flights)


def show(flights: list[Beliefs]) -> None:
    """Print consistency, errors of prediction and what became of the pursuits."""
    print(f"{len(flights)} flights")
    for number, (name, freedom) in enumerate(CHECKED.items()):
        values = [one.distances2[:, number] for one in flights]
        below = np.mean(np.concatenate(values) < chi2.ppf(0.95, freedom))
        inside = np.mean([is_inside(one, number, freedom) for one in flights])
        mean = np.median([one.mean() for one in values])
        print(
            f"{name:10} mean {mean:5.2f} of {freedom}, {100 * below:3.0f} % below the 95 % point, "
            f"{100 * inside:3.0f} % of the flights inside their bounds"
        )
    print(f"way foretold wrong by, m, after {AHEAD_S} s: RMS, median")
    for name, last in (("seen", False), ("hidden", True)):
        wrong = np.concatenate([one.wrong_m[one.is_last == last] for one in flights])
        for number, how in enumerate(("filter", "constant velocity")):
            rms = np.sqrt(np.nanmean(wrong[:, :, number] ** 2, axis=0))
            median = np.nanmedian(wrong[:, :, number], axis=0)
            print(f"{name:6} {how:17} {rms.round(2)} {median.round(2)}")
    for key in ("line_of_sight_box_rms_seen_deg", "range_error_median", "in_frame_share"):
        found = np.array([getattr(one.figures, key) for one in flights], float)
        rms = math.sqrt(np.nanmean(found**2))
        print(f"{key}: median {np.nanmedian(found):.3f}, root mean square {rms:.3f}")


def is_inside(flight: Beliefs, number: int, freedom: int) -> bool:
    """Whether a flight's mean lies between the 2.5 % and the 97.5 % point."""
    count = max(float(np.ptp(flight.times_s)) / INDEPENDENT_S, 1.0) * freedom
    mean = flight.distances2[:, number].mean() / freedom
    return bool(chi2.ppf(0.025, count) <= mean * count <= chi2.ppf(0.975, count))


if __name__ == "__main__":
    command_line.run(main)
