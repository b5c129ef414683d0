"""Seven-minute flights of real autopilots beside the simulated ones: a plot and a table.

The setpoints of each recording are flown again, open loop, on our simulated autopilot, in the wind
that the recording had. The table gives the root mean square of what differs; what ends in 1 was
there to be fitted to, what ends in 2, and the second half of px_wind3, was not.

Run from the repository's root: python benchmarks/autopilot_steps/flights.py RECORDINGS [OUT]
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from step_metrics import tilt_rad
from step_replay import fly_again

from follower_sim.kinematics import Triple
from follower_sim.scoring.recorded_step import RecordedStep, Series

FROM_DEG = 250.0
WINDS_M_S = {"ap_wind1": 8.0, "ap_wind2": 8.0, "px_wind1": 8.0, "px_wind2": 8.0, "px_wind3": 3.0}
"""Nominal; all from the same side."""
_FULL_WIND_M = 60.0
_SETTLED_S = 5.0
"""The recordings begin in flight; by then the start at rest is forgotten."""
_SHOWN_S = 90.0


@dataclass(frozen=True, slots=True)
class FlightDifference:
    """How a simulated flight differs from the recorded one, as root mean squares.

    Attributes:
        forward_m_s, right_m_s, down_m_s: velocities in the heading frame.
        yaw_rate_deg_s: about the body's down axis; a recorded one has the gyro's noise in it.
        tilt_deg: the angle of the body's down axis to gravity.
        miss_real_m_s, miss_simulated_m_s: mean distance between the level velocity asked for and
            the one flown.
    """

    forward_m_s: float
    right_m_s: float
    down_m_s: float
    yaw_rate_deg_s: float
    tilt_deg: float
    miss_real_m_s: float
    miss_simulated_m_s: float

    @classmethod
    def between(
        cls, real: RecordedStep, flown: RecordedStep, from_s: float = _SETTLED_S
    ) -> FlightDifference:
        """Compare two flights from a time on."""
        late = real.time_s >= from_s

        def rms(a: Series, b: Series) -> float:
            off = np.interp(real.time_s, flown.time_s, b) - a
            return math.sqrt(float(np.mean(off[late] ** 2)))

        velocities = zip(real.heading_velocity_m_s, heading_velocity_m_s(flown, real), strict=True)
        forward_m_s, right_m_s, down_m_s = (rms(a, b) for a, b in velocities)
        return cls(
            forward_m_s,
            right_m_s,
            down_m_s,
            math.degrees(rms(real.yaw_rate_rad_s, flown.yaw_rate_rad_s)),
            math.degrees(rms(tilt_rad(real), tilt_rad(flown))),
            _miss(real, real, from_s),
            _miss(flown, real, from_s),
        )


def heading_velocity_m_s(flight: RecordedStep, real: RecordedStep) -> Series:
    """Return a flight's forward, right, down, by the recorded heading: shape (3, N)."""
    yaw = np.interp(flight.time_s, real.time_s, np.unwrap(real.attitude_rad[2]))
    roll, pitch, _ = flight.attitude_rad
    return replace(flight, attitude_rad=np.stack([roll, pitch, yaw])).heading_velocity_m_s


def _miss(flight: RecordedStep, real: RecordedStep, from_s: float) -> float:
    """Return the mean distance, m/s, between the level velocities asked for and flown."""
    asked = np.array([sent.velocity_m_s[:2] for sent in flight.sent])
    number = np.searchsorted([sent.time_s for sent in flight.sent], flight.time_s, "right") - 1
    off = heading_velocity_m_s(flight, real)[:2].T - asked[np.maximum(number, 0)]
    return float(np.mean(np.hypot(*off.T)[flight.time_s >= from_s]))


def wind_of(real: RecordedStep) -> Callable[[float], Triple]:
    """Return the wind in which a recording was flown.

    ArduPilot's simulator lets it grow with the square root of the height, up to 60 m
    (SIM_WIND_T 0); PX4's has the same at every height. Gusts are not known.
    """
    speed_m_s = WINDS_M_S.get(real.name, 0.0)
    towards = math.radians(FROM_DEG) + math.pi
    north, east = speed_m_s * math.cos(towards), speed_m_s * math.sin(towards)
    if not real.name.startswith("ap_"):
        return lambda _: (north, east, 0.0)
    share = np.sqrt(np.clip(real.height_m / _FULL_WIND_M, 0.0, 1.0))

    def wind(time_s: float) -> Triple:
        now = float(np.interp(time_s, real.time_s, share))
        return now * north, now * east, 0.0

    return wind


def fly_recording(path: Path) -> tuple[RecordedStep, RecordedStep]:
    """Return a recording and what the simulated autopilot does with its setpoints in its wind."""
    real = RecordedStep.load(path)
    flavour = "px4" if real.name.startswith("px_") else "ardupilot"
    return real, fly_again(flavour, real, wind_of(real), by_recorded_heading=True)


def main() -> None:
    """Print the table and write a plot of each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path, help="folder of CSV files")
    parser.add_argument("out", type=Path, nargs="?", default=Path("runs/autopilot_flights"))
    options = parser.parse_args()
    out, paths = options.out, sorted(options.recordings.glob("*.csv"))
    if not paths:
        sys.exit(f"no recordings *.csv in {options.recordings}; give their folder")
    out.mkdir(parents=True, exist_ok=True)
    print(
        "root mean square of real - simulated; mean miss of the velocity asked for, real/simulated"
    )
    print(f"{'recording':12} forward   right    down  yaw rate   tilt         miss")
    for path in paths:
        real, flown = fly_recording(path)
        halves = (_SETTLED_S, float(real.time_s[-1]) / 2)[: 1 + (real.name == "px_wind3")]
        for from_s in halves:
            print(_row(real.name, from_s, FlightDifference.between(real, flown, from_s)))
        _plot(real, flown, out / f"{real.name}.png")
    print(f"plots: {out}")


def _row(name: str, from_s: float, off: FlightDifference) -> str:
    title = f"{name} 2/2" if from_s > _SETTLED_S else name
    return (
        f"{title:12} {off.forward_m_s:5.2f} m/s {off.right_m_s:4.2f} m/s {off.down_m_s:4.2f} m/s "
        f"{off.yaw_rate_deg_s:4.1f} deg/s {off.tilt_deg:3.1f} deg "
        f"{off.miss_real_m_s:5.2f}/{off.miss_simulated_m_s:4.2f} m/s"
    )


def _plot(real: RecordedStep, flown: RecordedStep, path: Path) -> None:
    off = FlightDifference.between(real, flown)
    true, ours = real.heading_velocity_m_s, heading_velocity_m_s(flown, real)
    rows = (
        ("forward (m/s)", true[0], ours[0], 0),
        ("right (m/s)", true[1], ours[1], 1),
        ("down (m/s)", true[2], ours[2], 2),
        ("yaw rate (deg/s)", np.degrees(real.yaw_rate_rad_s), np.degrees(flown.yaw_rate_rad_s), 3),
        ("tilt (deg)", np.degrees(tilt_rad(real)), np.degrees(tilt_rad(flown)), None),
    )
    figures = (off.forward_m_s, off.right_m_s, off.down_m_s, off.yaw_rate_deg_s, off.tilt_deg)
    figure, grid = plt.subplots(len(rows), 1, figsize=(13, 10), sharex=True, layout="constrained")
    figure.suptitle(f"{real.name}: recorded (blue), simulated (orange), asked (dotted)")
    times = [sent.time_s for sent in real.sent]
    asked = np.array(
        [(*sent.velocity_m_s, math.degrees(sent.yaw_rate_rad_s)) for sent in real.sent]
    )
    for axes, (title, a, b, column), rms in zip(grid, rows, figures, strict=True):
        axes.plot(real.time_s, a, "C0", lw=1.2)
        axes.plot(flown.time_s, b, "C1", lw=0.9)
        if column is not None:
            axes.step(times, asked[:, column], "k:", where="post", lw=0.7)
        axes.set_title(f"{title}: RMS of the difference {rms:.2f}", loc="left", fontsize=9)
        axes.grid(alpha=0.3)
    middle = float(real.time_s[-1]) / 2
    grid[-1].set_xlim(middle, middle + _SHOWN_S)
    grid[-1].set_xlabel("time (s)")
    figure.savefig(path, dpi=55)
    plt.close(figure)


if __name__ == "__main__":
    main()
