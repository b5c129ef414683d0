"""A drone target follower: the application, and its Python API.

Uses: `follower_vision`, `follower_control`, `follower_sim`.
Start at: `flight.control.stage.ControlStage`; `apps.main` has the commands, `apps.api` the API.

Examples:
    >>> import follower
    >>> print("version", follower.__version__)
    version ...
"""

from importlib import import_module
from typing import TYPE_CHECKING

import numpy  # noqa: F401  (loads the BLAS that is limited below)
from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from follower.apps.api.flights import evaluate, replay, simulate, write_report
    from follower.apps.api.pursuit import Pursuit
    from follower.apps.api.tracking import Fusion, frames
    from follower.apps.evaluate.scores import Evaluation
    from follower.apps.preflight.check import PreflightError
    from follower.apps.replay.run import ReplayResult
    from follower.links.connections import ConnectionFailedError
    from follower.recording.mcap_writer import FlightFileError
    from follower.recording.recorded_flight import RecordedFlight, open_flight
    from follower.settings.settings import load_settings
    from follower.simulation.run import SimulationResult
    from follower_control.common.strict_config import SettingsError
    from follower_vision.drawing.overlay import draw_tracks
    from follower_vision.geometry.box import Box
    from follower_vision.images.frame import Frame
    from follower_vision.onnx_network import ModelError
    from follower_vision.sources.frame_source import SourceError
    from follower_vision.trackers.track import Track, TrackState

    __version__: str

__all__ = [
    "Box",
    "ConnectionFailedError",
    "Evaluation",
    "FlightFileError",
    "Frame",
    "Fusion",
    "ModelError",
    "PreflightError",
    "Pursuit",
    "RecordedFlight",
    "ReplayResult",
    "SettingsError",
    "SimulationResult",
    "SourceError",
    "Track",
    "TrackState",
    "__version__",
    "draw_tracks",
    "evaluate",
    "frames",
    "load_settings",
    "open_flight",
    "replay",
    "simulate",
    "write_report",
]

_HOMES = {
    "follower.apps.api.flights": ("evaluate", "replay", "simulate", "write_report"),
    "follower.apps.api.pursuit": ("Pursuit",),
    "follower.apps.api.tracking": ("Fusion", "frames"),
    "follower.apps.evaluate.scores": ("Evaluation",),
    "follower.apps.preflight.check": ("PreflightError",),
    "follower.apps.replay.run": ("ReplayResult",),
    "follower.links.connections": ("ConnectionFailedError",),
    "follower.recording.mcap_writer": ("FlightFileError",),
    "follower.recording.recorded_flight": ("RecordedFlight", "open_flight"),
    "follower.settings.settings": ("load_settings",),
    "follower.simulation.run": ("SimulationResult",),
    "follower_control.common.strict_config": ("SettingsError",),
    "follower_vision.drawing.overlay": ("draw_tracks",),
    "follower_vision.geometry.box": ("Box",),
    "follower_vision.images.frame": ("Frame",),
    "follower_vision.onnx_network": ("ModelError",),
    "follower_vision.sources.frame_source": ("SourceError",),
    "follower_vision.trackers.track": ("Track", "TrackState"),
}
"""Where the names above live: a module is imported when a name of it is first asked for."""

# How a matrix product is split among threads decides its last bits: one thread, so that the same
# recording gives the same setpoints whatever the machine's cores. The matrices of trackers and
# filters are small: threads would gain nothing and take cores from camera, vision and control.
threadpool_limits(1, user_api="blas")


if not TYPE_CHECKING:  # a type checker would take it for a promise of every name

    def __getattr__(name: str) -> object:
        """Import what is asked for; PEP 562."""
        if name == "__version__":
            from importlib.metadata import version

            value = version("drone-target-follower")
        else:
            home = next((home for home, names in _HOMES.items() if name in names), None)
            if home is None:
                raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
            value = getattr(import_module(home), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        """Return what is there, and what can be imported."""
        return sorted({*globals(), *__all__})
