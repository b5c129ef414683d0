"""Simulated, measured, replayed and reported: the commands' work, without their words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from follower.apps.evaluate.run import EvaluationPlan, measure
from follower.apps.evaluate.scores import Evaluation
from follower.apps.inspect import inspect_recorded
from follower.apps.replay.run import ReplayResult, replayed
from follower.flight.supervision.flight_end import INTERRUPTED
from follower.flight.threads import one_opencv_thread
from follower.recording import RecordedFlight, open_flight
from follower.simulation.options import SimulationOptions, VisionSource
from follower.simulation.run import SimulationResult
from follower.simulation.run import simulate as simulate_options
from follower.ui.terminal.console import quiet_console


def simulate(
    scenario: str | Path = "demo",
    *,
    autopilot: str = "px4",
    seed: int | None = None,
    lockstep: bool = True,
    config: str | Path | None = None,
    overrides: Iterable[str] = (),
    scene: Iterable[str] = (),
    vision: str = "pixels",
    video: bool = False,
    out: str | Path = "runs",
) -> SimulationResult:
    """Fly a scenario in the simulator, and return its score; see `follower sim --help`.

    Args:
        scenario: a file, or a name from `follower scenarios`.
        autopilot: "px4" or "ardupilot".
        seed: of everything random; None takes the scenario's own.
        lockstep: on a simulated clock, the same each time; else in real time over UDP.
        config: settings file; it lies over the scenario's own settings.
        overrides: `key=value` each, as `--set` takes them.
        scene: keys of the scenario, as `--scene` takes them: "wind.mean_m_s=6".
        vision: "pixels", or "truth+noise" without pictures, which is not recorded.
        video: also write a video with the track drawn into it.
        out: folder in which the flight gets its own.

    Raises:
        SettingsError: the scenario or a setting cannot be used.
        ModelError: a network is missing.
        KeyboardInterrupt: Ctrl-C; the vehicle was released and the files are complete.

    Examples:
        >>> import follower
        >>> result = follower.simulate("winding", vision="truth+noise", scene=["duration_s=30"])
        >>> print(result.end.sentence, result.score.in_frame_share > 0.9)
        The pursuit succeeded True
    """
    options = SimulationOptions(
        str(scenario),
        autopilot,
        seed,
        lockstep,
        None if config is None else Path(config),
        tuple(overrides),
        Path(out),
        video,
        vision=VisionSource.of(vision),
        scene=tuple(scene),
    )
    with one_opencv_thread():
        result = simulate_options(options, quiet_console())
    if result.exit_code == INTERRUPTED:
        raise KeyboardInterrupt
    return result


def evaluate(
    folder: str | Path | Iterable[str | Path],
    trackers: Iterable[str],
    *,
    detector: str = "yolox-nano",
    tre: int = 0,
    sre: bool = False,
    rate_hz: float = 30.0,
    out: str | Path = "runs",
    resume: str | Path | None = None,
) -> Evaluation:
    """Measure trackers on sequences with known boxes; see `follower evaluate --help`.

    Args:
        folder: a sequence, a folder of them or a data set as it is unpacked, or several of these.
        trackers: names from `follower trackers`, "fusion", "fusion-paper", or KIND:NAME+DETECTOR
            as "fusion:re3+embedded"; "fusion:re3+none" has no detector.
        detector: Fusion's where the name gives none.
        tre: also start from so many frames.
        sre: also start from twelve moved boxes.
        rate_hz: frames a second where the data set does not say.
        out: folder in which the run gets its own.
        resume: the folder of a run to go on with; what is done is kept.

    Raises:
        SettingsError: a tracker or folder is not there.
        ModelError: a network is missing.
        KeyboardInterrupt: Ctrl-C; the message names the folder to resume from.

    Examples:
        >>> import follower
        >>> found = follower.evaluate("otb", ["fusion:re3+embedded"])
        >>> print(found.means[0].score.auc > 0.5, (found.folder / "report.html").is_file())
        True True
    """
    folders = (folder,) if isinstance(folder, str | Path) else folder
    plan = EvaluationPlan(
        tuple(map(Path, folders)),
        tuple(trackers),
        detector,
        tre=tre,
        sre=sre,
        out=Path(out),
        resume=None if resume is None else Path(resume),
        fps=rate_hz,
    )
    with one_opencv_thread():
        return measure(plan)


def replay(
    flight: str | Path | RecordedFlight, *, overrides: Iterable[str] = (), vision: bool = True
) -> ReplayResult:
    """Run a recording through the code that flies, and compare; see `follower replay --help`.

    Args:
        flight: its folder, or what `open_flight` returned.
        overrides: other settings, `key=value` each: then it shows what they would have asked for,
            open loop.
        vision: from the recorded frames on; else control alone, from the recorded tracks.

    Raises:
        FlightFileError: the flight or its video cannot be read.
        SettingsError: an override cannot be used.
        ModelError: a network is missing.

    Examples:
        >>> import follower
        >>> slower = follower.replay("runs/demo", overrides=["servo.range.kp=0.2"], vision=False)
        >>> slower.comparison.identical
        False
    """
    recorded = flight if isinstance(flight, RecordedFlight) else open_flight(flight)
    with one_opencv_thread():
        return replayed(recorded, tuple(overrides), vision=vision)


def write_report(flight: str | Path | RecordedFlight, out: str | Path | None = None) -> Path:
    """Write the report of a recorded flight, one HTML file with its figures; return its path.

    Args:
        flight: its folder, or what `open_flight` returned.
        out: where to; None writes inspection.html into the flight's folder.

    Raises:
        FlightFileError: the flight cannot be read.
        OSError: the report cannot be written.

    Examples:
        >>> import follower
        >>> print(follower.write_report("runs/demo"))
        runs/demo/inspection.html
    """
    recorded = flight if isinstance(flight, RecordedFlight) else open_flight(flight)
    return inspect_recorded(recorded, None if out is None else Path(out), quiet_console())
