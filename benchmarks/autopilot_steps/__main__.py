"""Recorded steps of real autopilots beside the simulated ones: two plots and a table.

"yes" means within 15 % of the recording; what is farther off, but within the recording's own noise
(see `StepMetrics`), is named.

Run from the repository's root: python benchmarks/autopilot_steps RECORDINGS [OUT]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from step_metrics import StepMetrics, asked_velocity_m_s, fall, rise, stepped_signals
from step_replay import fly_again

from follower_sim.scoring.recorded_step import RecordedStep

_PREFIXES = {"ardupilot": "ap_", "px4": "px_"}
_TITLES = {
    "ardupilot": "ArduCopter 4.6.3 (SITL) and ours",
    "px4": "PX4 release/1.18 (SITL) and ours",
}
_PANELS = ("velocity (m/s)", "tilt (deg)", "yaw rate (deg/s)")
_HEADER = (
    f"{'recording':22} {'signal':9} {'step':5} "
    f"{'t63 s':>13} {'t90 s':>13} {'overshoot %':>14} {'steady':>15}  agrees"
)


def main() -> None:
    """Write both plots and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path, help="folder of CSV files")
    parser.add_argument("out", type=Path, nargs="?", default=Path("runs/autopilot_steps"))
    options = parser.parse_args()
    data, out = options.recordings, options.out
    out.mkdir(parents=True, exist_ok=True)
    print("recorded / simulated; overshoot and steady state as shares of what was asked")
    print(_HEADER)
    for flavour, prefix in _PREFIXES.items():
        pairs = _pairs(flavour, data, prefix)
        if not pairs:
            sys.exit(f"no recordings {prefix}*.csv in {data}; give their folder")
        for real, flown in pairs:
            _print_rows(real, flown)
        print(f"plot: {_plot(flavour, pairs, out / f'{flavour}.png')}")


def _pairs(flavour: str, data: Path, prefix: str) -> list[tuple[RecordedStep, RecordedStep]]:
    paths = [p for p in sorted(data.glob(f"{prefix}*.csv")) if not _is_other(p.stem)]
    recordings = [RecordedStep.load(path) for path in paths]
    begun = time.process_time()
    pairs = [(recorded, fly_again(flavour, recorded)) for recorded in recordings]
    flown_s = sum(float(recorded.time_s[-1]) for recorded in recordings)
    if recordings:
        share = (time.process_time() - begun) / flown_s
        print(f"{flavour}: {flown_s:.0f} s flown at {1e3 * share:.1f} ms of CPU a second")
    return pairs


def _is_other(name: str) -> bool:
    return "loss" in name or "takeoff" in name


def _print_rows(real: RecordedStep, flown: RecordedStep) -> None:
    for true, ours in zip(stepped_signals(real), stepped_signals(flown), strict=True):
        for step, measure in (("up", rise), ("stop", fall)):
            a, b = measure(real, true), measure(flown, ours)
            print(f"{real.name:22} {true.name:9} {step:5} {_cells(a, b)}  {_verdict(a, b)}")


def _cells(a: StepMetrics, b: StepMetrics) -> str:
    return (
        f"{a.t63_s:6.2f}/{b.t63_s:6.2f} {a.t90_s:6.2f}/{b.t90_s:6.2f} "
        f"{100 * a.overshoot:7.1f}/{100 * b.overshoot:6.1f} {a.steady:7.3f}/{b.steady:7.3f}"
    )


def _verdict(a: StepMetrics, b: StepMetrics) -> str:
    beyond = a.disagreements(b)
    if beyond:
        return "; ".join(beyond)
    noisy = [text.split(":")[0] for text in a.disagreements(b, noise=False)]
    return f"yes, {' and '.join(noisy)} by the noise" if noisy else "yes"


def _plot(flavour: str, pairs: list[tuple[RecordedStep, RecordedStep]], path: Path) -> Path:
    figure, grid = plt.subplots(
        len(pairs), 3, figsize=(15, 2.4 * len(pairs)), squeeze=False, layout="constrained"
    )
    figure.suptitle(f"{_TITLES[flavour]}: recorded (thin), simulated (dashed), asked (dotted)")
    for row, (real, flown) in zip(grid, pairs, strict=True):
        _plot_velocity(row[0], real, flown)
        _plot_tilt(row[1], real, flown)
        _plot_yaw(row[2], real, flown)
        row[0].set_title(real.name, loc="left", fontsize=9)
        for axes in row:
            axes.grid(alpha=0.3)
    for axes, label in zip(grid[0], _PANELS, strict=True):
        axes.set_title(label, loc="right", fontsize=9)
        axes.legend(loc="upper right", fontsize=7)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    figure.savefig(path, dpi=70)
    plt.close(figure)
    return path


def _plot_velocity(axes: Axes, real: RecordedStep, flown: RecordedStep) -> None:
    names = ("forward (north)", "right (east)", "down")
    rows = zip(names, asked_velocity_m_s(real), asked_velocity_m_s(flown), strict=True)
    for number, (name, a, b) in enumerate(rows):
        axes.plot(real.time_s, a, f"C{number}", lw=0.9, label=name)
        axes.plot(flown.time_s, b, f"C{number}--")
    _plot_asked(axes, real, [sum(sent.velocity_m_s, 0.0) for sent in real.sent])


def _plot_tilt(axes: Axes, real: RecordedStep, flown: RecordedStep) -> None:
    for number, name in ((0, "roll"), (1, "pitch")):
        axes.plot(
            real.time_s, np.degrees(real.attitude_rad[number]), f"C{number}", lw=0.9, label=name
        )
        axes.plot(flown.time_s, np.degrees(flown.attitude_rad[number]), f"C{number}--")


def _plot_yaw(axes: Axes, real: RecordedStep, flown: RecordedStep) -> None:
    axes.plot(real.time_s, np.degrees(real.yaw_rate_rad_s), "C0", lw=0.9, label="yaw rate")
    axes.plot(flown.time_s, np.degrees(flown.yaw_rate_rad_s), "C1--")
    _plot_asked(axes, real, [np.degrees(sent.yaw_rate_rad_s) for sent in real.sent])


def _plot_asked(axes: Axes, real: RecordedStep, values: list[float]) -> None:
    times = [sent.time_s for sent in real.sent] + [float(real.time_s[-1])]
    axes.step(times, [*values, values[-1]], "k:", where="post", lw=1)


if __name__ == "__main__":
    main()
