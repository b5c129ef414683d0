"""All that the checks look at, measured before they begin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from follower.links.link_status import LinkStatus
from follower.links.vehicle_health import VehicleHealth
from follower.settings import Settings
from follower_control.vehicle import VehicleState


@dataclass(frozen=True, slots=True)
class CameraReading:
    """What the camera gave while it was watched.

    Attributes:
        source: what it was asked for, without a password.
        problem: why frames do not come, "" if they do.
        size: width and height in pixels, None without a frame.
        frames: how many came.
        interval_s: median time between two captures.
        worst_interval_s: the longest.
        jitter_s: 95th percentile of an interval's distance from the median.
        age_s: 95th percentile of a frame's age when it was taken.
        contrast: standard deviation of the newest frame's grey values, 0 to 127.
        repeats: frames that were the same as the one before, to the last bit.
    """

    source: str = ""
    problem: str = ""
    size: tuple[int, int] | None = None
    frames: int = 0
    interval_s: float = math.nan
    worst_interval_s: float = math.nan
    jitter_s: float = math.nan
    age_s: float = math.nan
    contrast: float = math.nan
    repeats: int = 0


@dataclass(frozen=True, slots=True)
class ComputerReading:
    """The companion computer's state; None is what could not be read.

    Attributes:
        free_bytes: room on the recording's disk.
        folder: where it is.
        temperature_c: the hottest part's.
        throttled: the Raspberry Pi's flags, as `vcgencmd get_throttled` gives them.
        load: processes that want to run, over the cores.
    """

    free_bytes: int | None = None
    folder: str = "."
    temperature_c: float | None = None
    throttled: int | None = None
    load: float | None = None


@dataclass(frozen=True, slots=True)
class AttitudeReading:
    """How the attitude came while it was watched.

    Attributes:
        worst_age_s: the oldest that control would have used, on our clock.
        repeats_itself: the numbers did not change although they came with new times.
    """

    worst_age_s: float = math.inf
    repeats_itself: bool = False


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One moment before a flight.

    Attributes:
        now_s: on the system's clock.
        settings: that would be flown with.
        link: how it is.
        vehicle: what it tells.
        health: what it tells about itself.
        attitude: how its attitude came.
        parameters: of the autopilot, by name.
        missing_parameters: which it did not tell although it was asked.
        camera: see there.
        models: networks' files and whether each is "good", "missing" or "wrong".
        lens_given: the settings name a field of view or a focal length.
        computer: see there.
    """

    now_s: float
    settings: Settings
    link: LinkStatus
    vehicle: VehicleState = field(default_factory=VehicleState)
    health: VehicleHealth = field(default_factory=VehicleHealth)
    attitude: AttitudeReading = AttitudeReading()
    parameters: Mapping[str, float] = field(default_factory=dict)
    missing_parameters: frozenset[str] = frozenset()
    camera: CameraReading = CameraReading()
    models: Mapping[str, str] = field(default_factory=dict)
    lens_given: bool = True
    computer: ComputerReading = ComputerReading()
