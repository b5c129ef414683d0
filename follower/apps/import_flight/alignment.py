"""Finds the time offset between a video and a telemetry log."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from follower.recording.telemetry_logs import TelemetryLog
from follower.report import html, style
from follower.report.style import BLUE, INK, ORANGE
from follower.settings.settings import Settings
from follower_control.common.clock_offset import (
    AngularRates,
    TimeOffset,
    find_offset,
)
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import CameraMount, rotation
from follower_vision.images.camera_rotation import CornerFlow, CornerFollower
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import SourceError

_AGAIN = 2
_DOWN = np.array([0.0, 0.0, 1.0])


def corner_flows(frames: Iterable[Frame], camera: CameraModel) -> Iterator[CornerFlow]:
    """Return how the corners moved from each frame to the next, while they have one size."""
    follower = CornerFollower(camera)
    for frame in frames:
        if (frame.width, frame.height) != (camera.width, camera.height):
            return
        flow = follower.step(frame)
        if flow is not None:
            yield flow


def flows_of(frames: Iterable[Frame], name: str, settings: Settings) -> Iterator[CornerFlow]:
    """Return the same by the settings' lens, for the size that the first frame has.

    Raises:
        SourceError: there is no frame.
    """
    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise SourceError(f"{name}: no frame could be read")
    return corner_flows(remaining, settings.camera.model_of(name, first.width, first.height))


def align(
    flows: Sequence[CornerFlow],
    telemetry: TelemetryLog,
    mount: CameraMount,
    reach_s: float = math.inf,
) -> TimeOffset:
    """Return by how much the log's time is ahead of the video's, and how well that is known.

    At first the vehicle is taken to be level; with the offset found, the log's own attitude says
    where the ground is, and so the vehicle's way over it from a turn.

    Args:
        flows: of the video.
        telemetry: of the same flight.
        mount: of the camera.
        reach_s: see `find_offset`.

    Raises:
        NoOverlapError: too little is seen, or one of the two is too short.
    """
    found = find_offset(_rates(flows, mount, lambda _: (0.0, 0.0)), telemetry.rates, reach_s)
    for _ in range(_AGAIN):
        tilt = _tilt_of(telemetry, found.offset_s)
        found = find_offset(_rates(flows, mount, tilt), telemetry.rates, reach_s)
    return found


def _rates(
    flows: Sequence[CornerFlow], mount: CameraMount, tilt: Callable[[float], tuple[float, float]]
) -> AngularRates:
    """Return the body's angular velocities as the image shows them."""
    to_body = mount.camera_to_body
    rows = []
    for flow in flows:
        roll, pitch = tilt((flow.start_s + flow.end_s) / 2)
        down = to_body.T @ (rotation(roll, pitch, 0.0).T @ _DOWN)
        turn = flow.rates_rad_s(down)
        if turn is not None:
            rows.append((flow.start_s, flow.end_s, *(to_body @ turn)))
    table: Vector = np.array(rows, np.float64).reshape(-1, 5)
    return AngularRates(table[:, 0], table[:, 1], table[:, 2:])


def _tilt_of(telemetry: TelemetryLog, offset_s: float) -> Callable[[float], tuple[float, float]]:
    time_s = np.array([one.time_s for one in telemetry.attitudes])
    roll = np.unwrap([one.roll_rad for one in telemetry.attitudes])
    pitch = np.array([one.pitch_rad for one in telemetry.attitudes])

    def tilt(video_s: float) -> tuple[float, float]:
        at = video_s + offset_s
        return float(np.interp(at, time_s, roll)), float(np.interp(at, time_s, pitch))

    return tilt


_AXES = ("roll rate [°/s]", "pitch rate [°/s]", "yaw rate [°/s]")


def offset_facts(found: TimeOffset) -> dict[str, float]:
    """Return the offset and its quality, rounded to what they are worth."""
    return {
        "seconds": round(found.offset_s, 4),
        "plus_or_minus_s": round(found.unsure_s, 4),
        "correlation": round(found.peak, 3),
        "next_best_correlation": round(found.second, 3),
        "image_turns_per_gyro": round(found.scale, 3),
        "turning_deg_s": round(math.degrees(found.rate_rad_s), 2),
    }


def offset_figure(found: TimeOffset) -> Figure:
    """Draw both recordings' turns on top of each other, and the correlation over the offset."""
    figure = Figure(figsize=(style.WIDTH_IN, 6.6))
    curves = figure.add_gridspec(3, 1, left=0.085, right=0.985, top=0.95, bottom=0.38, hspace=0.25)
    below = figure.add_subplot(
        figure.add_gridspec(1, 1, left=0.085, right=0.985, top=0.25, bottom=0.075)[0]
    )
    axes = [figure.add_subplot(curves[row]) for row in range(len(_AXES))]
    camera, gyro = np.degrees(found.camera_rad_s), np.degrees(found.gyro_rad_s)
    for column, name in enumerate(_AXES):
        style.curve(axes[column], found.time_s, camera[:, column], ORANGE, "image", width=2.2)
        style.curve(axes[column], found.time_s, gyro[:, column], INK, "gyro", width=0.9)
        axes[column].set_ylabel(name)
        axes[column].set_xlim(found.time_s[0], found.time_s[-1])
        axes[column].tick_params(labelbottom=column == len(_AXES) - 1)
    axes[-1].set_xlabel("video's time [s]")
    style.legend(axes[0])
    style.curve(below, found.lags_s, found.correlation, BLUE)
    below.axvline(found.offset_s, color=ORANGE.light, linewidth=1.3, label="chosen")
    below.set_ylabel("correlation")
    below.set_xlabel("offset: log's time minus video's time [s]")
    style.legend(below)
    figure.align_ylabels([*axes, below])
    return figure


def write_offset_plot(path: Path, found: TimeOffset) -> None:
    """Write the drawing as a PNG.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(offset_figure(found), path)


def offset_section(found: TimeOffset) -> str:
    """Return the drawing and the figures for a report."""
    facts = [(name.replace("_", " "), f"{value:g}") for name, value in offset_facts(found).items()]
    with style.plot_style():
        svg = style.to_svg(offset_figure(found), "timeoffset", "Time offset")
    said = (
        "The quick turns that the image shows (slow ones are taken out of both) and the gyro's, "
        "moved by the offset; below, how well they agree at other offsets."
    )
    return html.section(
        "Time offset between video and telemetry",
        html.figure(svg, said),
        html.table(("Figure", "Value"), facts, numbers=(1,)),
    )
