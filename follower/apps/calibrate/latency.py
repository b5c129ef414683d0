"""From the turns of a vehicle, seen and felt, to how late its camera's frames are stamped."""

from __future__ import annotations

import math
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console

from follower.apps.calibrate.session import picture_beside
from follower.apps.import_flight.alignment import align, flows_of, write_offset_plot
from follower.apps.preflight.session import opened_link
from follower.apps.replay.replay import replay_settings
from follower.apps.video_input import VideoInput
from follower.recording import open_flight
from follower.recording.telemetry_logs.samples import TelemetryLog, TelemetrySamples
from follower.settings.settings import Settings, load_settings, settings_data
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import StopOnInterrupt
from follower_control.common.clock_offset import NoOverlapError
from follower_control.common.strict_config import merged
from follower_control.vehicle.state import Attitude
from follower_vision.clock import MonotonicClock
from follower_vision.disk import write_whole
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.camera_rotation import CornerFlow
from follower_vision.images.frame import Frame

_REACH_S = 2.0
_SCALE_OFF = 0.1
_STEP_S = 0.02
_FOUND, _NOT_FOUND = 0, 1


@dataclass(frozen=True, slots=True)
class Turns:
    """What the camera and the gyro have seen of the same time, on one clock.

    Attributes:
        name: of where it comes from.
        flows: from frame to frame, at the frames' stamps.
        telemetry: attitudes and rates.
        mount: of the camera.
    """

    name: str
    flows: list[CornerFlow]
    telemetry: TelemetryLog
    mount: CameraMount


def recorded_turns(folder: Path, config: Path | None = None) -> Turns:
    """Return the turns of a recorded flight.

    Args:
        folder: the flight's.
        config: settings file with the lens and the mount; None takes the flight's own.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    flight = open_flight(folder)
    settings = replay_settings(flight) if config is None else load_settings(config)
    attitudes = [one for record in flight.log.controls for one in record.attitudes]
    flows = _flows(flight.pictures(), str(folder), settings)
    return Turns(str(folder), flows, _telemetry(str(folder), attitudes), settings.camera.mount)


def live_turns(settings: Settings, source: VideoInput, connect: str, seconds: float) -> Turns:
    """Watch camera and autopilot for some seconds, or until Ctrl-C; nothing is steered.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    clock, attitudes = MonotonicClock(), list[Attitude]()
    with (
        opened_link(connect, settings, clock) as link,
        ThreadPoolExecutor(1) as pool,  # it ends once the source is closed
        source.open(clock) as frames,
        StopOnInterrupt() as stopped,
        Console().status("Turn the vehicle left and right") as status,
    ):
        flows = pool.submit(_flows, iter(frames.read, None), source.shown, settings)
        end_s = clock.now() + seconds
        while not (stopped.interrupted or flows.done()) and (now_s := clock.now()) < end_s:
            link.poll(now_s)
            attitudes += link.attitudes
            rate = math.degrees(attitudes[-1].yaw_rate_rad_s) if attitudes else math.nan
            status.update(
                f"Turn the vehicle left and right: {end_s - now_s:.0f} s to go, {rate:+.0f} °/s. "
                "Ctrl-C ends it."
            )
            clock.sleep_until(now_s + _STEP_S)
    telemetry = _telemetry(connect, attitudes)
    return Turns(source.shown, flows.result(), telemetry, settings.camera.mount)


def run(turns: Turns, out: Path, config: Path | None = None) -> int:
    """Find the delay, say it with its error, write it; return the exit code: 1 without one.

    Args:
        turns: to be compared.
        out: where the settings with the delay go; a picture goes beside them.
        config: settings file whose settings go there, too.

    Raises:
        SettingsError, OSError: what the user can mend, in one line.
    """
    drawing, console = picture_beside(out), Console()
    try:
        found = align(turns.flows, turns.telemetry, turns.mount, _REACH_S)
    except NoOverlapError as error:
        print_line(console, f"No calibration: {error}.")
        return _NOT_FOUND
    latency_s = -found.offset_s
    said = f"{latency_s:.3f} s ± {1e3 * found.unsure_s:.1f} ms"
    print_line(
        console,
        f"delay {said} over {len(turns.flows)} frames, correlation {found.peak:.3f}; the image "
        f"turns {found.scale:.2f} times as much as the gyro",
    )
    if not 1 - _SCALE_OFF < found.scale < 1 + _SCALE_OFF:
        print_line(console, "That is far from 1: is the field of view right?", "yellow")
    if found.problems:
        print_line(
            console,
            f"No calibration: {'; '.join(found.problems)}. Turn left and right by 30 degrees for "
            "20 s, where the camera sees much that stands still.",
        )
        return _NOT_FOUND
    known, _ = settings_data(config)
    settings = merged(known, {"camera": {"latency_s": round(latency_s, 4)}})
    head = f"# The delay that `follower calibrate latency` found in {turns.name}: {said}.\n"
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, head + yaml.safe_dump(settings, sort_keys=False, default_flow_style=None))
    write_offset_plot(drawing, found)
    print_line(console, f"{out} has the delay: give it with -c, or copy camera.latency_s")
    print_line(console, f"{drawing} shows it: both curves must lie on each other")
    return _FOUND


def _flows(frames: Iterable[Frame], name: str, settings: Settings) -> list[CornerFlow]:
    return list(flows_of(frames, name, settings))


def _telemetry(name: str, attitudes: Iterable[Attitude]) -> TelemetryLog:
    rows = [(one.time_s, *one.numbers) for one in attitudes]
    samples = TelemetrySamples([row[:4] for row in rows], [row[4:] for row in rows])
    return samples.log(name)
