"""Opens the ground station's side of a flight, if the settings ask for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from follower.ground_station.flight_view import FlightView
from follower.ground_station.lens import Lens
from follower.ground_station.settings import GroundStationSettings
from follower.settings import Settings
from follower.target_finder import TargetFinder
from follower.tracking import make_settings_detector
from follower.video_out.settings import fitted_size
from follower_vision.clock import Clock


@contextmanager
def open_ground_station(
    settings: Settings,
    view: FlightView,
    rate_hz: float,
    clock: Clock,
    save: Callable[[], str] | None = None,
) -> Iterator[None]:
    """Answer ground stations while entered; nothing happens unless it is enabled.

    Args:
        settings: of the flight.
        view: of it.
        rate_hz: of its frames.
        clock: the system's, which runs by itself.
        save: writes the changed settings to their file; None without one.
    """
    if not settings.ground_station.enabled:
        yield
        return
    from follower.ground_station.ground_station import GroundStation

    lens = lens_of(settings, view.size, rate_hz)
    with GroundStation(_with_stream(settings), view, lens, clock, save) as station:
        station.start()
        yield


def lens_of(settings: Settings, size: tuple[int, int], rate_hz: float) -> Lens:
    """Return what is told of frames of this size; of the stream, what is known of our own."""
    camera, video = settings.camera.model(*size), settings.video
    fov_deg = math.degrees(2 * math.atan(camera.width / (2 * camera.fx)))
    if not video.on:
        return Lens(fov_deg, rate_hz)
    stream = fitted_size(*size, video.max_width_px)
    return Lens(fov_deg, rate_hz, stream, 1000 * video.bitrate_kbit_s)


def operators_finder(settings: Settings, cockpit: bool) -> TargetFinder | None:
    """Return a finder whose points snap to detections, None where nobody can point.

    Its detector is its own: the tracker's may be at work on another thread.

    Raises:
        ModelError: the detector's network is missing or broken.
    """
    if not (settings.ground_station.enabled or cockpit):
        return None
    return TargetFinder(make_settings_detector(settings))


def _with_stream(settings: Settings) -> GroundStationSettings:
    """Return the settings with the address of our own video where none is given."""
    ground, video = settings.ground_station, settings.video
    if ground.video_uri:
        return ground
    if video.rtsp is not None and not video.rtsp.startswith(("0.0.0.0", "[::]")):  # noqa: S104
        return replace(ground, video_uri=f"rtsp://{video.rtsp}/live")
    if video.udp is not None:
        return replace(ground, video_uri=f"udp://0.0.0.0:{video.udp.rpartition(':')[2]}")
    return ground
