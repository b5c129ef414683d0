"""Telemetry from log files: what a vehicle did while somebody else recorded it."""

from follower.telemetry.log import TelemetryError, TelemetryLog
from follower.telemetry.opening import read_telemetry
from follower.telemetry.playback import TelemetryPlayback

__all__ = ["TelemetryError", "TelemetryLog", "TelemetryPlayback", "read_telemetry"]
